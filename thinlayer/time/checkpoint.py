"""The files from which a march is resumed, on any number of ranks."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from geometry.parallel import on_root
from thinlayer.discretisation.state import Audit, Report, State, cell_values
from thinlayer.errors import ModelError
from thinlayer.files.table import Table, replaced
from thinlayer.identity import Resume, differences, digest, in_words
from thinlayer.parallel.exchange import carry
from thinlayer.solving.equations import Equations
from thinlayer.time.history import History, dissipated_columns

Array = npt.NDArray[Any]
TABLE = "table.csv"
REQUIRED = {"t", "iterations", "residual", "supplied", "stored", "dissipated", "remainder"}  # columns to resume from
REACTIONS = "reactions"
MEMORY, FIELD, STORED, STRESS = "memory ", "field ", "stored ", "stress "  # prefixes of keys of parts in a state's file


@dataclass
class Pace:
    """The values from which the length of the next step follows.

    Attributes:
        step: largest length of the next step; None: no limit.
        largest: norms of displacements, jumps and forces to which errors of adaptive steps are relative: the largest ones
            so far or, after rest, those at the end of the first step that was tried.
        weight: weight 1/U^2 of displacements in the arc length of a path; 0 before its first step.
    """

    step: float | None
    largest: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    weight: float = 0.0


class Checkpoint:
    """The files of a march in a folder: march.json with the table so far and the pace, its states, and table.csv.

    Values are ordered by the original numbers of their cells or facets of S, which do not depend on the distribution. Files
    are replaced as a whole, states before the table that names them, so that a killed run leaves valid files. All methods
    are collective.

    Args:
        folder: folder of the files.
        equations: the equations of the model.
        mark: JSON of the model's identity and of the choices of the march; only a march with the same is resumed.
        needed: number of last states that are needed to resume the march.
    """

    def __init__(self, folder: Path, equations: Equations, mark: str, needed: int = 1) -> None:
        self.mark, self.folder, self.needed = mark, folder, needed
        self.model, self.comm = equations.model, equations.comm
        self.path = folder / "march.json"
        mesh = self.model.domain.mesh
        owned = mesh.topology.index_map(mesh.topology.dim).size_local
        self._owned, self._cells = np.arange(owned, dtype=np.int32), self.model.domain.original_cells
        rest = equations.memory_at_rest
        self._rest = {key: values for key, values in rest.items() if not isinstance(values, Mapping)}
        self._spaces = {"u": self.model.V}  # of functions that are kept cell by cell
        for key, functions in rest.items():
            if isinstance(functions, Mapping):
                self._spaces |= {f"{MEMORY}{key}/{name}": f.function_space for name, f in functions.items()}
        self._unstressed = equations.stresses_at_rest
        self._orders = {part.key: part.file_order for part in equations.parts if part.file_order is not None}
        if unknown := sorted(self._rest.keys() - self._orders.keys()):
            raise ModelError(
                f"the part {unknown[0]!r} remembers values that have no order in files: march without out=, or give "
                "its class file_order, a FileOrder of the rows of its memory, or a memory of functions"
            )
        self._fields = {part.key: (part.field.function_space, part.own_file_order) for part in equations.with_own}

    def _file(self, row: int) -> Path:
        return self.folder / "states" / f"{row:06d}.npz"

    def _files(self) -> list[Path]:
        return list((self.folder / "states").glob("[0-9]" * 6 + ".npz"))

    # ---------------------------------------------------------------- writing
    def write(self, history: History, pace: Pace, first: int, before: State | None = None) -> None:
        """Write the states of the rows from `first` on, and replace the table.

        Files of states that the history does not keep are removed, except that of the state `before` the last one. If
        `first` is 0, the files of an earlier march are removed.

        Raises:
            OSError: a file could not be written; on all ranks.
        """
        last = len(history) - 1
        states = history.states if before is None else {last - 1: before, **history.states}
        if first == 0:
            on_root(self.comm, self._forget)
        for row in range(first, len(history)):
            if row in states:
                self._write_state(row, states[row])
        on_root(self.comm, lambda: self._write_table(history, pace, states.keys()))

    def _forget(self) -> None:
        """Remove the files of an earlier march; the table first, as march.json says to which march it belongs."""
        for file in (self.folder / TABLE, self.path, *self._files()):
            file.unlink(missing_ok=True)

    def _write_table(self, history: History, pace: Pace, kept: Collection[int]) -> None:
        rows = [list(row.values()) for row in history.table.rows]
        content = {"mark": self.mark, "pace": asdict(pace), "columns": history.table.columns, "rows": rows}
        with replaced(self.path) as file:
            file.write(json.dumps(content).encode())
        for stale in self._files():
            if int(stale.stem) not in kept:
                stale.unlink()
        history.table.put(self.folder / TABLE)

    def _write_state(self, row: int, state: State) -> None:
        functions = {"u": state.u}
        for key, kept in state.memory.items():
            if isinstance(kept, Mapping):
                functions |= {f"{MEMORY}{key}/{name}": f for name, f in kept.items()}
        arrays = {
            name: self._gather(self._cells[self._owned], cell_values(f, self._owned)) for name, f in functions.items()
        }
        for key, f in state.fields.items():
            _, order = self._fields[key]
            arrays[FIELD + key] = self._gather(order.numbers, order.ordered(f.x.array[:, None]))
        for start, kept in ((MEMORY, state.memory), (STRESS, state.stresses)):
            for key in kept.keys() & self._orders.keys():
                order, values = self._orders[key], kept[key]
                arrays[start + key] = self._gather(order.numbers, order.ordered(values))
        arrays["t"] = np.array(state.t)
        if state.reactions is not None:
            arrays[REACTIONS] = state.reactions
        arrays |= {STORED + key: np.array(energy) for key, energy in state.stored.items()}
        arrays["march"] = np.array(digest(self.mark))

        def write() -> None:
            with replaced(self._file(row)) as file:
                np.savez(file, allow_pickle=False, **arrays)

        on_root(self.comm, write)

    # ---------------------------------------------------------------- reading
    def read(self, keep: str, resume: Resume) -> tuple[History, Pace] | None:
        """History and pace of the march in the folder; None: there is no march, or `resume` is False.

        With "anyway" it may be another march, and stays the one that it was begun as.

        Raises:
            ModelError: the files belong to another march, or it is to be resumed and they are damaged.
        """
        found = on_root(self.comm, lambda: self._content(resume))
        if found is None:
            return None
        table, pace, self.mark = found
        last = len(table) - 1
        needed = [row for row in range(last + 1 - self.needed, last + 1) if row >= 0]
        there = on_root(self.comm, lambda: sorted({*needed, *(r for r in range(last) if self._file(r).exists())}))
        states = {row: self._read_state(row, table) for row in (there if keep == "all" else needed)}
        on_root(self.comm, lambda: table.put(self.folder / TABLE))
        return History(self.model, table, states), pace

    def _content(self, resume: Resume) -> tuple[Table, Pace, str] | None:
        """Table, pace and fingerprint in march.json; on rank 0."""
        if not self.path.exists():
            if (self.folder / TABLE).exists():
                found = f"{self.folder} has a {TABLE} of something else"
                raise ModelError(f"{found}, as there is no {self.path.name}; give another folder, or remove it")
            return None
        try:
            content = json.loads(self.path.read_text(encoding="utf-8"))
            there, here = dict(json.loads(content["mark"])), json.loads(self.mark)
            pace = Pace(**content["pace"])
            step, numbers = pace.step, (*pace.largest, pace.weight)
            table = Table(dict(zip(content["columns"], row, strict=True)) for row in content["rows"])
            observed = {*there.get("observe", ())}
            if lacking := (REQUIRED | observed) - {*table.columns}:
                raise ValueError(f"its column {', '.join(sorted(lacking))} is missing")
            if any(isinstance(value, (str, bool)) for row in table.rows for value in row.values()):
                raise ValueError("its table has entries that are no numbers")
            for name in REQUIRED - {"iterations"}:
                if not np.isfinite(table[name][np.array([row[name] is not None for row in table.rows])]).all():
                    raise ValueError(f"its column {name} is damaged")
            [int(n) for n in table["iterations"]]
            if not len(table) or np.isnan(table["t"]).any() or not np.isfinite(numbers).all() or len(numbers) != 4:
                raise ValueError("its table is damaged")
            if not (step is None or (isinstance(step, float | int) and step > 0)):
                raise ValueError("its step is damaged")
        except (OSError, ValueError, LookupError, TypeError, AttributeError, OverflowError) as error:
            if not resume:
                return None
            raise ModelError(f"{self.path} cannot be read ({error}); remove it to start anew") from error
        if there != here and resume != "anyway":
            other = in_words([*differences(there, here)])
            raise ModelError(
                f"{self.path} is of another march ({other}); give another folder, remove it, or resume='anyway'"
            )
        if observed != here["observe"].keys():
            raise ModelError(f"{self.path}: the march observes {sorted(observed)}, not {sorted(here['observe'])}")
        return (table, pace, content["mark"]) if resume else None

    def _read_state(self, row: int, table: Table) -> State:
        arrays: dict[str, Array] = {}  # on rank 0 alone
        on_root(self.comm, lambda: arrays.update(self._arrays(row, table)))
        functions = {name: self._read_function(row, arrays.get(name), V) for name, V in self._spaces.items()}
        fields: dict[str, fem.Function] = {}
        for key, (space, order) in self._fields.items():
            if self.comm.bcast(FIELD + key in arrays):
                fields[key] = f = fem.Function(space)
                order.put(f.x.array[:, None], self._wanted(row, arrays.get(FIELD + key), order.numbers, order.width))
                f.x.scatter_forward()
        memory, stresses = (
            {key: self._read_values(row, arrays.get(start + key), key, rest) for key, rest in at_rest.items()}
            for start, at_rest in ((MEMORY, self._rest), (STRESS, self._unstressed))
        )
        of_parts: dict[str, Any] = dict(memory)
        for name, f in functions.items():
            if name != "u":
                key, own = name.removeprefix(MEMORY).rsplit("/", 1)
                of_parts.setdefault(key, {})[own] = f
        single = {name: float(array) for name, array in arrays.items() if _is_single(name)}
        single = self.comm.bcast(single)
        t = single.pop("t")
        stored = {name.removeprefix(STORED): value for name, value in single.items()}
        numbers = {name: value for name, value in table.rows[row].items() if not isinstance(value, str)}
        found = {name: np.nan if value is None else float(value) for name, value in numbers.items()}
        dissipated = dict.fromkeys(self.model.by_place({}), 0.0)
        dissipated |= {place: found.get(column, np.nan) for column, place in dissipated_columns(self.model).items()}
        audit = Audit(found["supplied"], found["stored"], found["dissipated"], found["remainder"])
        report = Report("resumed", int(found["iterations"]), found["residual"], 0.0)
        parts, reactions = (of_parts, fields, stored), self.comm.bcast(arrays.get(REACTIONS))
        return State(
            functions["u"], t, *parts, reactions=reactions, stresses=stresses,
            model=self.model, report=report, audit=audit, dissipated=dissipated,
        )  # fmt: skip

    def _read_function(self, row: int, rows: Array | None, V: fem.FunctionSpace) -> fem.Function:
        """A function on the model's mesh, from the rows of a state's file on rank 0."""
        f, bs, cells = fem.Function(V), V.dofmap.bs, np.asarray(V.dofmap.list)
        values = self._wanted(row, rows, self._cells[: len(cells)], cells.shape[1] * bs)
        f.x.array.reshape(-1, bs)[cells.ravel()] = values.reshape(-1, bs)
        f.x.scatter_forward()
        return f

    def _read_values(self, row: int, rows: Array | None, key: str, rest: Array) -> Array:
        """Values (n, m) at the points of a part, from the rows of a state's file on rank 0."""
        order, values = self._orders[key], np.zeros_like(rest)
        order.put(values, self._wanted(row, rows, order.numbers, order.width * rest.shape[1]))
        return values

    def _arrays(self, row: int, table: Table) -> dict[str, Array]:
        """The arrays of a state's file; on rank 0."""
        try:
            with np.load(self._file(row), allow_pickle=False) as file:
                arrays = dict(file)
            wanted = {*self._spaces, "t", *(MEMORY + key for key in self._rest)}
            wanted |= {STRESS + key for key in self._unstressed}
            if lacking := (wanted | {"march"}) - arrays.keys():
                raise ValueError(f"no {', '.join(sorted(lacking))} in it")
            for name in arrays.keys() - {"march"}:
                array, single = arrays[name], _is_single(name)
                if array.dtype.kind != "f" or array.ndim != (0 if single else 2):
                    raise ValueError(f"{name} in it is damaged")
                if not single and not np.isfinite(array[:, :1]).all():
                    raise ValueError(f"{name} in it is damaged")
            if str(arrays["march"]) != digest(self.mark):
                raise ModelError(self._damaged(row, f"is of another march than {self.path}"))
            if float(arrays["t"]) != table.rows[row]["t"]:
                raise ModelError(self._damaged(row, f"is of another time than row {row} of {self.path}"))
        except ModelError:
            raise
        except Exception as error:  # numpy raises many kinds of errors for damaged files
            raise ModelError(self._damaged(row, f"cannot be read ({error})")) from error
        return arrays

    def _damaged(self, row: int, what: str) -> str:
        return f"{self._file(row)} {what}; remove the folder to start anew"

    def _gather(self, numbers: Array, values: Array) -> Array:
        """The rows (number, values...) of all ranks on rank 0, sorted by number, each number once."""
        parts = self.comm.gather(np.column_stack([numbers.astype(float), values]))
        if parts is None:
            return np.empty((0, 0))
        rows = np.concatenate(parts)
        _, first = np.unique(rows[:, 0], return_index=True)
        return rows[first]

    def _wanted(self, row: int, rows: Array | None, numbers: Array, width: int) -> Array:
        """The values (len(numbers), width) of these numbers on each rank, from rows (number, values...) on rank 0."""
        there = self.comm.bcast(rows.shape[1] - 1 if rows is not None else None)
        if self.comm.allreduce(int(there != width)):
            raise ModelError(
                self._damaged(row, f"is damaged, or of another version ({there} values where {width} belong)")
            )
        rows = rows if rows is not None and self.comm.rank == 0 else np.empty((0, width + 1))
        found = carry(self.comm, rows[:, 0].astype(np.int64), rows[:, 1:], numbers)
        if self.comm.allreduce(int(not np.isfinite(found).all())):
            raise ModelError(self._damaged(row, "is damaged (values are missing)"))
        return found


def _is_single(name: str) -> bool:
    """Whether an array of a state's file is one number."""
    return name == "t" or name.startswith(STORED)
