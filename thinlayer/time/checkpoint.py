"""The files from which a march is resumed, on any number of ranks."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from dolfinx import fem

from forms.base import InputError
from geometry.parallel import on_root
from thinlayer.discretisation.state import Audit, Report, State
from thinlayer.parts.part import FileOrder
from thinlayer.solving.equations import Equations
from thinlayer.solving.history import History, dissipated_columns
from thinlayer.system.folder import hash_of, read_sealed, replaced, write_sealed
from thinlayer.system.identity import Resume, differences, in_words
from thinlayer.system.ranks import carry
from thinlayer.system.table import Table

TABLE = "table.csv"
REACTIONS = "reactions"
MEMORY, FIELD, STRESS = "memory ", "field ", "stress "  # prefixes of keys of parts in a state's file


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
    are replaced as a whole, states before march.json, which has their hashes, so that a killed run leaves valid files. All
    methods are collective.

    Args:
        folder: folder of the files.
        equations: the equations of the model.
        mark: JSON of the model's identity and of the choices of the march; only a march with the same is resumed.
        needed: number of last states that are needed to resume the march.
    """

    def __init__(self, folder: Path, equations: Equations, mark: dict[str, Any], needed: int = 1) -> None:
        self.mark, self.folder, self.needed = mark, folder, needed
        self.model, self.comm = equations.model, equations.comm
        self.path = folder / "march.json"
        self._states: dict[str, list[Any]] = {}  # row -> hash of the state's file, energies stored in parts; on rank 0
        self._rest, self._unstressed = equations.memory_at_rest, equations.stresses_at_rest
        self._spaces = {part.key: part.field.function_space for part in equations.with_own}
        self._orders = {FIELD + part.key: part.own_file_order for part in equations.with_own}
        of_parts = {part.key: order for part in equations.parts if (order := part.file_order) is not None}
        self._orders |= {start + key: order for key, order in of_parts.items() for start in (MEMORY, STRESS)}
        for key, values in self._rest.items():
            if not isinstance(values, Mapping) and key not in of_parts:
                raise InputError(
                    f"the part {key!r} remembers values that have no order in files: march without out=, or give "
                    "its class file_order, a FileOrder of the rows of its memory, or a memory of functions"
                )
        topology = self.model.domain.mesh.topology
        self._owned = {}  # name of a function -> number of this rank's own cells
        for name, f in _functions(fem.Function(self.model.V), self._rest).items():
            dofs = np.asarray(f.function_space.dofmap.list)
            self._orders[name] = FileOrder(self.model.domain.original_cells[: len(dofs)], dofs)
            self._owned[name] = topology.index_map(topology.dim).size_local

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
        self._states = {row: about for row, about in self._states.items() if int(row) in kept}
        columns, rows = history.table.columns, [[*row.values()] for row in history.table.rows]
        write_sealed(
            self.path,
            {"mark": self.mark, "pace": asdict(pace), "columns": columns, "rows": rows, "states": self._states},
        )
        for stale in self._files():
            if int(stale.stem) not in kept:
                stale.unlink()
        history.table.put(self.folder / TABLE)

    def _write_state(self, row: int, state: State) -> None:
        values = _values(state.u, state.memory, state.fields, state.stresses)
        arrays = {} if state.reactions is None else {REACTIONS: state.reactions}
        for name, order in self._orders.items():
            if name in values:
                n = self._owned.get(name)
                arrays[name] = self._gather(order.numbers[:n], order.ordered(values[name])[:n])

        def write() -> None:
            with replaced(self._file(row)) as file:
                np.savez(file, allow_pickle=False, **arrays)
            self._states[str(row)] = [hash_of(self._file(row)), dict(state.stored)]

        on_root(self.comm, write)

    # ---------------------------------------------------------------- reading
    def read(self, history: History, keep: str, resume: Resume) -> Pace | None:
        """Read the march in the folder into a history; returns its pace, None if there is none or `resume` is False.

        With "anyway" it may be another march, and stays the one that it was begun as.

        Raises:
            InputError: the files belong to another march, or it is to be resumed and they are damaged.
        """
        found = on_root(self.comm, lambda: self._content(resume))
        if found is None:
            return None
        self.mark, self._states = found["mark"], found["states"]
        table = Table(dict(zip(found["columns"], row, strict=True)) for row in found["rows"])
        on_root(self.comm, lambda: table.put(self.folder / TABLE))
        rows = [row for row in sorted(map(int, self._states)) if keep == "all" or row >= len(table) - self.needed]
        history.table, history.states = table, {row: self._read_state(row, table) for row in rows}
        return Pace(**found["pace"])

    def _content(self, resume: Resume) -> dict[str, Any] | None:
        """The content of march.json; on rank 0."""
        if not self.path.exists():
            if (self.folder / TABLE).exists():
                found = f"{self.folder} has a {TABLE} of something else"
                raise InputError(f"{found}, as there is no {self.path.name}; give another folder, or remove it")
            return None
        try:
            content = read_sealed(self.path)
        except InputError:
            if resume:
                raise
            return None
        there, here = content["mark"], self.mark
        if there != here and resume != "anyway":
            other = in_words([*differences(there, here)])
            remedy = "give another folder, remove it, or resume='anyway'"
            raise InputError(f"{self.path} is of another march ({other}); {remedy}")
        if there["observe"].keys() != here["observe"].keys():
            raise InputError(f"{self.path}: the march observes {[*there['observe']]}, not {[*here['observe']]}")
        return content if resume else None

    def _read_state(self, row: int, table: Table) -> State:
        arrays: dict[str, np.ndarray] = {}  # on rank 0 alone

        def load() -> tuple[list[str], dict[str, float], np.ndarray | None]:
            seal, stored = self._states[str(row)]
            if hash_of(self._file(row)) != seal:
                raise InputError(f"{self._file(row)} is lost or damaged; remove the folder to start anew")
            with np.load(self._file(row), allow_pickle=False) as file:
                arrays.update(file)
            return [*arrays], stored, arrays.get(REACTIONS)

        names, stored, reactions = on_root(self.comm, load)
        u, stresses = fem.Function(self.model.V), {key: values.copy() for key, values in self._unstressed.items()}
        fields = {key: fem.Function(V) for key, V in self._spaces.items() if FIELD + key in names}
        memory = {
            key: {name: f.copy() for name, f in kept.items()} if isinstance(kept, Mapping) else kept.copy()
            for key, kept in self._rest.items()
        }
        for name, values in _values(u, memory, fields, stresses).items():
            order = self._orders[name]
            order.put(values, self._wanted(row, arrays.get(name), order.numbers, order.width * values.shape[1]))
        for f in (*_functions(u, memory).values(), *fields.values()):
            f.x.scatter_forward()
        numbers = {name: value for name, value in table.rows[row].items() if not isinstance(value, str)}
        found = {name: np.nan if value is None else float(value) for name, value in numbers.items()}
        dissipated = dict.fromkeys(self.model.by_place({}), 0.0)
        dissipated |= {place: found.get(column, np.nan) for column, place in dissipated_columns(self.model).items()}
        audit = Audit(found["supplied"], found["stored"], found["dissipated"], found["remainder"])
        report = Report("resumed", int(found["iterations"]), found["residual"], 0.0)
        return State(
            u, found["t"], memory, fields, stored, reactions=reactions, stresses=stresses,
            model=self.model, report=report, audit=audit, dissipated=dissipated,
        )  # fmt: skip

    def _gather(self, numbers: np.ndarray, values: np.ndarray) -> np.ndarray:
        """The rows (number, values...) of all ranks on rank 0, sorted by number, each number once."""
        parts = self.comm.gather(np.column_stack([numbers.astype(float), values]))
        if parts is None:
            return np.empty((0, 0))
        rows = np.concatenate(parts)
        _, first = np.unique(rows[:, 0], return_index=True)
        return rows[first]

    def _wanted(self, row: int, rows: np.ndarray | None, numbers: np.ndarray, width: int) -> np.ndarray:
        """The values (len(numbers), width) of these numbers on each rank, from rows (number, values...) on rank 0."""
        rows = rows if rows is not None and rows.shape[1] == width + 1 else np.empty((0, width + 1))
        found = carry(self.comm, rows[:, 0].astype(np.int64), rows[:, 1:], numbers)
        if self.comm.allreduce(int(not np.isfinite(found).all())):
            raise InputError(f"{self._file(row)} is of a march with other unknowns; remove the folder to start anew")
        return found


def _functions(u: fem.Function, memory: Mapping[str, Any]) -> dict[str, fem.Function]:
    """The functions among what a state has, by their names in its file, except own unknowns of parts."""
    kept = [(key, one) for key, one in memory.items() if isinstance(one, Mapping)]
    return {"u": u, **{f"{MEMORY}{key}/{name}": f for key, one in kept for name, f in one.items()}}


def _values(
    u: fem.Function, memory: Mapping[str, Any], fields: Mapping[str, fem.Function], stresses: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Values (n, v) of what a state has, by their names in its file; no copies."""
    functions = _functions(u, memory).items()
    return (
        {name: f.x.array.reshape(-1, f.function_space.dofmap.bs) for name, f in functions}
        | {FIELD + key: f.x.array[:, None] for key, f in fields.items()}
        | {MEMORY + key: kept for key, kept in memory.items() if not isinstance(kept, Mapping)}
        | {STRESS + key: kept for key, kept in stresses.items()}
    )
