"""Files of a march, from which it is resumed on any number of ranks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from dolfinx import fem

from forms.base import Array, InputError
from geometry.parallel import on_root
from geometry.topology import IntArray
from thinlayer.discretisation.state import Audit, Report, State
from thinlayer.parts.part import FileOrder, Memory
from thinlayer.solving.equations import Equations
from thinlayer.system.fingerprint import Resume, differences, differences_text
from thinlayer.system.folder import append_sealed, file_hash, read_sealed_lines, replace_file
from thinlayer.system.ranks import carry_cell_values
from thinlayer.system.table import Table

CSV_FILE = "table.csv"
REACTIONS_KEY = "reactions"
# prefixes of keys of parts in a state's file
MEMORY_PREFIX, FIELD_PREFIX, STRESS_PREFIX = "memory ", "field ", "stress "
FORMAT_VERSION = 3  # format of the files: 3 since march.json has a line for each write
STATE_NUMBERS = ("t", "stored", "sudden", "prescribed_work", "dissipated")  # numbers of a state in march.json

JsonObject = dict[str, Any]  # a march, its mark or one of its states in march.json


@dataclass
class Pace:
    """Data of a march from which the length of its next step follows.

    Attributes:
        step: largest length of the next step, as a time or, on a path, relative to the first step; None: no limit.
        largest: norms of displacements, jumps and forces (in this order) to which errors of adaptive steps are
            relative. They are the largest norms so far. For a quantity that was zero before the first step, they start
            with the norm at the end of the first step that was tried.
        weight: factor 1/U^2 of squared displacements in the squared arc length of a path; 0 before the first step. U is
            the unit of displacements, a length.
    """

    step: float | None = None
    largest: Sequence[float] = (0.0, 0.0, 0.0)
    weight: float = 0.0


class Checkpoint:
    """Files of a march in a folder, with methods that write and read them. All methods are collective.

    Each line of march.json has new rows of the table and the `Pace`. Each state has a file of its own, and table.csv
    has the table once more. In the files, values of a state are sorted by the numbers of their cells or facets in the
    joint. So they do not depend on how the mesh is distributed over ranks.

    The files of states are written before the line of march.json that has their hashes, and removed after it. A run
    that is killed leaves valid files, perhaps with part of a line, which is skipped.

    Args:
        folder: folder of the files.
        equations: the equations of the model.
        march_id: JSON data that identify the march, from the model and the arguments of the march. Only a march with
            equal data is resumed.

    Raises:
        InputError: a part keeps an array as memory and does not define the order of its rows in files.
    """

    def __init__(self, folder: Path, equations: Equations, march_id: JsonObject) -> None:
        self.march_id, self.folder, self.path = march_id | {"format": FORMAT_VERSION}, folder, folder / "march.json"
        self.model, self.comm, self._equations = equations.model, equations.comm, equations
        self._state_records: dict[str, JsonObject] = {}  # row -> numbers of the state, hash of its file
        self._file_orders = {FIELD_PREFIX + part.key: part.own_file_order for part in equations.field_parts}
        for part in equations.parts:
            if (file_order := part.file_order) is not None:
                self._file_orders |= {MEMORY_PREFIX + part.key: file_order, STRESS_PREFIX + part.key: file_order}
        n_owned_cells = self.model.domain.mesh.topology.index_map(self.model.joint.dim).size_local
        rest = equations.rest_state(0.0)
        for name, f in _state_functions(rest).items():
            dofs = np.asarray(f.function_space.dofmap.list)
            self._file_orders[name] = FileOrder(self.model.domain.original_cells[: len(dofs)], dofs, n_owned_cells)
        array_keys = [*rest.stresses, *(key for key, memory in rest.memory.items() if not isinstance(memory, Mapping))]
        for key in (key for key in array_keys if MEMORY_PREFIX + key not in self._file_orders):
            text = f"the part {key!r} remembers values that have no order in files"
            raise InputError(f"{text}: march without out=, or give its class file_order, of the rows of its memory")

    def _path_of(self, row: int) -> Path:
        return self.folder / "states" / f"{row:06d}.npz"

    def _state_paths(self) -> list[Path]:
        return list((self.folder / "states").glob("[0-9]" * 6 + ".npz"))

    # ---------------------------------------------------------------- writing
    def write(self, table: Table, states: Mapping[int, State], pace: Pace, first: int) -> None:
        """Write the states and rows that are not in files yet, and replace table.csv.

        Files of states that are not in `states` are removed. If `first` is 0, all files of an earlier march are removed
        first.

        Args:
            table: table of the march so far.
            states: number of a row of the table -> its state, for all states that are to be in files.
            pace: data from which the length of the next step follows.
            first: number of the first row that has not been written yet.

        Raises:
            OSError: a file could not be written; on all ranks.
        """
        if first == 0:
            on_root(self.comm, self._remove_files)
        for row, state in states.items():
            if row >= first:
                self._write_state(row, state)
        on_root(self.comm, lambda: self._write_march(table, states, pace, first))

    def _remove_files(self) -> None:
        """Remove the files of an earlier march.

        The file table.csv goes first, because only march.json shows to which march it belongs.
        """
        for file in (self.folder / CSV_FILE, self.path, *self._state_paths()):
            file.unlink(missing_ok=True)

    def _write_march(self, table: Table, states: Mapping[int, State], pace: Pace, first: int) -> None:
        self._state_records = {row: record for row, record in self._state_records.items() if int(row) in states}
        new_states = {row: record for row, record in self._state_records.items() if int(row) >= first}
        step = {"rows": table.rows[first:], "states": new_states, "kept": [*self._state_records], "pace": asdict(pace)}
        append_sealed(self.path, step if first else {"mark": self.march_id, **step})
        for path in self._state_paths():
            if int(path.stem) not in states:
                path.unlink()
        table.write_on_this_rank(self.folder / CSV_FILE)

    def _write_state(self, row: int, state: State) -> None:
        arrays = {} if state.reactions is None else {REACTIONS_KEY: state.reactions}
        arrays |= {name: self._gather(self._file_orders[name], values) for name, values in _state_arrays(state).items()}
        state_data = {"report": asdict(state.report), "audit": asdict(state.audit)}
        state_data |= {name: getattr(state, name) for name in STATE_NUMBERS}

        def write() -> None:
            with replace_file(self._path_of(row)) as file:
                np.savez(file, allow_pickle=False, **arrays)
            self._state_records[str(row)] = state_data | {"hash": file_hash(self._path_of(row))}

        on_root(self.comm, write)

    def _gather(self, file_order: FileOrder, values: Array) -> Array:
        """Return, on rank 0, the values that all ranks have in their cells or facets, sorted for a file. Collective.

        Args:
            file_order: order of the values in files.
            values: (n, v) v values in each of n rows of this rank.

        Returns:
            On rank 0 one row for each cell or facet: its number in the joint, then its values. Other ranks get no
            useful rows.
        """
        rows = np.column_stack([file_order.file_rows.astype(float), file_order.to_rows(values)])
        rows = np.concatenate(self.comm.gather(rows[: file_order.n_owned]) or [rows[:0]])
        return rows[np.unique(rows[:, 0], return_index=True)[1]]

    # ---------------------------------------------------------------- reading
    def read(self, resume: Resume, n_last: int) -> tuple[Table, dict[int, State], Pace] | None:
        """Read a march from the files in the folder.

        Args:
            resume: whether the march is to be resumed. "anyway": also if the files are of another march. They then keep
                the data that identify that march.
            n_last: number of states to read, the last ones of the march; 0: all.

        Returns:
            The table, number of a row -> its state, and the data from which the length of the next step follows. None:
            there is no march, or `resume` is False.

        Raises:
            InputError: the files belong to another march, or march.json is damaged. Or the march is to be resumed, and
                the file of a state is damaged.
        """
        steps = on_root(self.comm, lambda: self._read_steps(resume))
        if steps is None:
            return None
        records = {row: record for step in steps for row, record in step["states"].items()}
        self._state_records = {row: records[row] for row in steps[-1]["kept"]}
        table = Table(row for step in steps for row in step["rows"])
        on_root(self.comm, lambda: table.write_on_this_rank(self.folder / CSV_FILE))
        states = {row: self._read_state(row) for row in sorted(map(int, self._state_records))[-n_last:]}
        return table, states, Pace(**steps[-1]["pace"])

    def _read_steps(self, resume: Resume) -> list[JsonObject] | None:
        """Return the lines of march.json; None if there is no such file or `resume` is False.

        To be called on rank 0 only.

        Args:
            resume: whether the march is to be resumed; "anyway": also if the file is of another march.

        Raises:
            InputError: the file is damaged or has the format of another version; it is of another march; or its table
                has other columns from `observe`.
        """
        if not self.path.exists():
            if (self.folder / CSV_FILE).exists():
                raise InputError(f"{self.folder / CSV_FILE} is not of a march; give another folder, or remove it")
            return None
        steps = read_sealed_lines(self.path)
        if not steps or "mark" not in steps[0]:
            raise InputError(f"{str(self.path)!r} cannot be read (its first line is damaged); remove it to start anew")
        old = steps[0]["mark"]
        if old.get("format") != FORMAT_VERSION:
            text = f"it has the format {old.get('format')} of another version, this one reads {FORMAT_VERSION}"
            raise InputError(f"{str(self.path)!r} cannot be read ({text}); give another folder, or remove it")
        if old != self.march_id and resume != "anyway":
            text = f"{self.path} is of another march ({differences_text([*differences(old, self.march_id)])})"
            raise InputError(f"{text}; give another folder, remove it, or resume='anyway'")
        if old["observe"].keys() != self.march_id["observe"].keys():
            raise InputError(f"{self.path}: the march observes {[*old['observe']]}, not {[*self.march_id['observe']]}")
        return steps if resume else None

    def _read_state(self, row: int) -> State:
        arrays: dict[str, Array] = {}  # on rank 0 only

        def read_file() -> tuple[JsonObject, list[str], Array | None]:
            state_data = self._state_records[str(row)]
            if file_hash(self._path_of(row)) != state_data["hash"]:
                raise InputError(f"{self._path_of(row)} is lost or damaged; remove the folder to start anew")
            with np.load(self._path_of(row), allow_pickle=False) as file:
                arrays.update(file)
            return state_data, [*arrays], arrays.get(REACTIONS_KEY)

        state_data, array_names, reactions = on_root(self.comm, read_file)
        rest_state = self._equations.rest_state(state_data["t"])
        spaces = {part.key: part.field.function_space for part in self._equations.field_parts}
        memory = {key: _copy_memory(values) for key, values in rest_state.memory.items()}
        fields = {key: fem.Function(V) for key, V in spaces.items() if FIELD_PREFIX + key in array_names}
        report, audit = Report(**state_data["report"] | {"method": "resumed"}), Audit(**state_data["audit"])
        state = replace(rest_state, memory=memory, fields=fields, at_rest=False, report=report, audit=audit)
        state = replace(state, reactions=reactions, **{name: state_data[name] for name in STATE_NUMBERS})
        for name, values in _state_arrays(state).items():
            order = self._file_orders[name]
            n_values = order.width * values.shape[1]
            order.assign(values, self._receive_values(row, arrays.get(name), order.file_rows, n_values))
        for f in (*_state_functions(state).values(), *state.fields.values()):
            f.x.scatter_forward()
        return state

    def _receive_values(self, row: int, rows: Array | None, entity_numbers: IntArray, n_values: int) -> Array:
        """Return the values of this rank's cells or facets from the content of a state's file. Collective.

        Args:
            row: number of the state's row in the table, for errors.
            rows: on rank 0 the content of the file, one row for each cell or facet: its number, then its values; on
                other ranks None.
            entity_numbers: (cells,) numbers in the joint of the cells or facets of this rank.
            n_values: number of values of each cell or facet.

        Returns:
            (cells, width) values.

        Raises:
            InputError: the file lacks a value.
        """
        rows = rows if rows is not None and rows.shape[1] == n_values + 1 else np.empty((0, n_values + 1))
        values = carry_cell_values(self.comm, rows[:, 0].astype(np.int64), lambda at: rows[at, 1:], entity_numbers)
        if self.comm.allreduce(int(not np.isfinite(values).all())):
            raise InputError(f"{self._path_of(row)} is of a march with other unknowns; remove the folder to start anew")
        return values


def _copy_memory(memory: Memory) -> Memory:
    """Return a copy of the `memory` of a part: an array, or a dict of functions."""
    return {name: f.copy() for name, f in memory.items()} if isinstance(memory, Mapping) else memory.copy()


def _state_functions(state: State) -> dict[str, fem.Function]:
    """Return the functions of a state that are written to files: name in the file -> function.

    They are the displacements, called "u", and those memories of parts that are functions. Other unknowns of parts,
    such as pressures, are left out.
    """
    dicts = [(key, memory) for key, memory in state.memory.items() if isinstance(memory, Mapping)]
    return {"u": state.u, **{f"{MEMORY_PREFIX}{key}/{name}": f for key, memory in dicts for name, f in memory.items()}}


def _state_arrays(state: State) -> dict[str, Array]:
    """Return all values of a state that are written to files: name in the file -> array (n, v).

    The arrays have n rows of v values. They are views of the state's data, so that writing into them changes the state.
    """
    arrays = {name: f.x.array.reshape(-1, f.function_space.dofmap.bs) for name, f in _state_functions(state).items()}
    arrays |= {FIELD_PREFIX + key: f.x.array[:, None] for key, f in state.fields.items()}
    arrays |= {MEMORY_PREFIX + key: values for key, values in state.memory.items() if not isinstance(values, Mapping)}
    return arrays | {STRESS_PREFIX + key: values for key, values in state.stresses.items()}
