"""The files that a march resumes from, on any number of ranks."""

from __future__ import annotations

import hashlib
import inspect
import json
import zipfile
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from forms.law import Law
from forms.series import Stack
from forms.temperature import Tabulated
from thinlayer.equations import Equations
from thinlayer.exchange import carry
from thinlayer.loads import ModelError
from thinlayer.model import Model
from thinlayer.pointwise.points import LawPoints
from thinlayer.pointwise.quadrature import Region
from thinlayer.state import Audit, Report, State, cell_values
from thinlayer.table import Table, replaced
from thinlayer.time.history import History

Array = npt.NDArray[Any]
DIRECTION = (0.5403023058681398, 0.2926817141205163, 0.7890437903507289)  # tells the points of a facet apart


def fingerprint(model: Model, **choices: Any) -> str:
    """What must be the same for a march to be resumed. Loads and supports that are functions count as such."""
    points, layer = model.domain.joint.points, model.layer
    weights = np.cos(np.arange(points.size)).reshape(points.shape)
    content = {
        "model": repr(model),
        "cells": len(model.domain.joint.cells),
        "coordinates": [float(f"{(points * w).sum():.8g}") for w in (weights, weights**2)],
        "plane": model.plane,
        "law": described(layer.law) if layer else None,
        "eps": float(layer.eps) if layer else None,
        "order": layer.order if layer else None,
        "profile": bool(layer and layer.profile),
        "bodies": {name: described(law) for name, law in model.body_laws.items()},
        "supports": [[str(place), _numbers(given)] for place, given in model.supports.entries],
        "loads": {name: _numbers(load) for name, load in model.forces.given.items()},
        **choices,
    }
    return json.dumps(content, sort_keys=True)


def described(law: Law) -> Any:
    """A law as text and numbers, and what its class is written like."""
    if isinstance(law, Stack):
        return [[a, described(part)] for a, part in law.sublayers]
    try:
        source = hashlib.sha256(inspect.getsource(type(law)).encode()).hexdigest()[:8]
    except (OSError, TypeError):
        source = "unknown"
    choices = {f.name: getattr(law, f.name) for f in fields(law)}
    return f"{type(law).__name__}({', '.join(f'{k}={_numbers(v)}' for k, v in choices.items())}), code {source}"


def _numbers(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _numbers(v) for k, v in value.items()}
    if isinstance(value, Tabulated):
        return _numbers(value.values)
    if callable(value):
        return "function"
    array = np.asarray(value)
    return array.astype(float).tolist() if array.dtype.kind in "iuf" else str(value)


@dataclass
class Pace:
    """What the length of the next steps depends on.

    Attributes:
        step: longest that the next step may be; None if nothing limits it.
        largest: what the error of adaptive steps is measured against: the largest displacements, jumps and forces so far.
        weight: of displacements in the arc length of a path; 0 before its first step.
    """

    step: float | None
    largest: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    weight: float = 0.0


class Checkpoint:
    """The files of a march in a folder: march.json with the table so far and the pace, and its states.

    Values are kept by the original number of the cell, or of the facet of S, that they belong to, in an order that the
    distribution has no part in. Files are replaced as a whole, states before the table that names them: a killed run
    leaves what it had. Collective, as all methods are.

    Args:
        folder: where the files are.
        equations: of the model.
        needed: number of states, the last ones, that a march resumes from.
    """

    def __init__(self, folder: Path, equations: Equations, needed: int = 1) -> None:
        self.folder, self.model, self.comm, self.needed = folder, equations.model, equations.comm, needed
        self.path = folder / "march.json"
        mesh = self.model.domain.mesh
        owned = mesh.topology.index_map(mesh.topology.dim).size_local
        self._owned, self._cells = np.arange(owned, dtype=np.int32), self.model.domain.original_cells
        self._points = [_Places.of_points(p) for p in equations.laws.points]
        if equations.contact:
            numbers = equations.contact.nodes.numbers
            self._points.append(_Places(numbers, np.arange(len(numbers))[:, None], None))
        self._pressures = equations.constraint

    def _file(self, row: int) -> Path:
        return self.folder / "states" / f"{row:06d}.npz"

    def forget(self) -> None:
        """Remove the files of an earlier march."""
        if self.comm.rank == 0 and self.path.exists():
            self.path.unlink()
            for file in self._files():
                file.unlink()

    def _files(self) -> list[Path]:
        return list((self.folder / "states").glob("[0-9]" * 6 + ".npz"))

    # ---------------------------------------------------------------- writing
    def write(self, mark: str, history: History, pace: Pace, first: int, before: State | None = None) -> None:
        """Add the states of the rows from `first` on, and replace the table; states that the history does not keep go.

        But for the one `before` the last, if it is given.
        """
        last = len(history) - 1
        states = history.states if before is None else {last - 1: before, **history.states}
        for row in range(first, len(history)):
            if row in states:
                self._write_state(row, states[row])
        if self.comm.rank:
            return
        rows = [list(row.values()) for row in history.table.rows]
        content = {"mark": mark, "pace": asdict(pace), "columns": history.table.columns, "rows": rows}
        with replaced(self.path) as file:
            file.write(json.dumps(content).encode())
        for stale in self._files():
            if int(stale.stem) not in states:
                stale.unlink()

    def _write_state(self, row: int, state: State) -> None:
        arrays = {"u": self._gather(self._cells[self._owned], cell_values(state.u, self._owned))}
        if state.p is not None and self._pressures is not None:
            places = _Places.of_dofs(state.p.function_space, self._pressures.region)
            arrays["p"] = self._gather(places.numbers, places.ordered(state.p.x.array[:, None]))
        for k, (places, values) in enumerate(zip(self._points, state.memory, strict=True)):
            arrays[f"memory{k}"] = self._gather(places.numbers, places.ordered(values))
        if self.comm.rank:
            return
        arrays["t"], arrays["layer"] = np.array(state.t), np.array(state.audit.layer)
        with replaced(self._file(row)) as file:
            np.savez(file, allow_pickle=False, **arrays)

    # ---------------------------------------------------------------- reading
    def read(self, mark: str, keep: str, resume: bool) -> tuple[History, Pace] | None:
        """History and pace of the march; None if there is none, or it is not to be resumed.

        Raises:
            ModelError: the files are of another march, or, to be resumed, damaged.
        """
        content, problem, other = self.comm.bcast(self._content(mark) if self.comm.rank == 0 else None)
        if other or (problem and resume):
            raise ModelError(problem)
        if content is None or not resume:
            return None
        table = Table(dict(zip(content["columns"], row, strict=True)) for row in content["rows"])
        last = len(table) - 1
        needed = [row for row in range(last + 1 - self.needed, last + 1) if row >= 0]
        rows = self.comm.bcast(sorted({*needed, *(row for row in range(last) if self._file(row).exists())}))
        states = {row: self._read_state(row, table) for row in (rows if keep == "all" else needed)}
        return History(self.model, table, states), Pace(**content["pace"])

    def _content(self, mark: str) -> tuple[dict[str, Any] | None, str | None, bool]:
        """What march.json says, or what is wrong with it, and whether it is of another march; on rank 0."""
        if not self.path.exists():
            return None, None, False
        try:
            content = json.loads(self.path.read_text())
            there, here = dict(json.loads(content["mark"])), json.loads(mark)
            step = content["pace"]["step"]
            columns = {"t", "iterations", "residual", "supplied", "stored", "dissipated", "remainder"}
            widths = {len(row) for row in content["rows"]}
            if widths != {len(content["columns"])} or columns - {*content["columns"]} or not (step is None or step > 0):
                raise ValueError("its table or its step is damaged")
        except (OSError, ValueError, LookupError, TypeError) as error:
            return None, f"{self.path} cannot be read ({error}); remove it to start anew", False
        if there != here:
            names = [k for k in {**here, **there} if here.get(k) != there.get(k)]
            other = [f"{k}: {there.get(k)} there, {here.get(k)} here" for k in names]
            what = f"{self.path} is of another march ({'; '.join(other)}); give another folder, or remove it"
            return None, what, True
        return content, None, False

    def _read_state(self, row: int, table: Table) -> State:
        arrays, problem = self._arrays(row, table) if self.comm.rank == 0 else ({}, None)
        if problem := self.comm.bcast(problem):
            raise ModelError(f"{self._file(row)} {problem}; remove the folder to start anew")
        u, p = fem.Function(self.model.V), None
        dofmap = u.function_space.dofmap
        cells = np.asarray(dofmap.list)
        values = self._wanted(arrays.get("u"), self._cells[: len(cells)])
        u.x.array.reshape(-1, dofmap.bs)[cells.ravel()] = values.reshape(-1, dofmap.bs)
        u.x.scatter_forward()
        if self._pressures is not None and self.comm.bcast("p" in arrays):
            p = fem.Function(self._pressures.space)
            places = _Places.of_dofs(p.function_space, self._pressures.region)
            places.put(p.x.array[:, None], self._wanted(arrays.get("p"), places.numbers))
            p.x.scatter_forward()
        memory = []
        for k, places in enumerate(self._points):
            wanted = self._wanted(arrays.get(f"memory{k}"), places.numbers)
            memory.append(np.zeros((places.order.size, wanted.shape[1] // places.order.shape[1])))
            places.put(memory[-1], wanted)
        t, layer = self.comm.bcast((float(arrays["t"]), float(arrays["layer"])) if self.comm.rank == 0 else None)
        numbers = {name: value for name, value in table.rows[row].items() if not isinstance(value, str)}
        found = {name: np.nan if value is None else float(value) for name, value in numbers.items()}
        audit = Audit(found["supplied"], found["stored"], found["dissipated"], found["remainder"], layer)
        report = Report("resumed", int(found["iterations"]), found["residual"], 0.0)
        return State(self.model, u, t, report, p, tuple(memory), audit)

    def _arrays(self, row: int, table: Table) -> tuple[dict[str, Array], str | None]:
        """The arrays of a state's file, or what is wrong with it; on rank 0."""
        try:
            with np.load(self._file(row), allow_pickle=False) as file:
                arrays = dict(file)
        except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile) as error:
            return {}, f"cannot be read ({error})"
        wanted = {"u", "t", "layer", *(f"memory{k}" for k in range(len(self._points)))}
        if lacking := wanted - arrays.keys():
            return {}, f"cannot be read (no {', '.join(sorted(lacking))} in it)"
        if float(arrays["t"]) != table.rows[row]["t"]:
            return {}, f"is of another time than row {row} of {self.path}"
        return arrays, None

    def _gather(self, numbers: Array, values: Array) -> Array:
        """All ranks' rows (number, values...) on rank 0, sorted by number, each once."""
        parts = self.comm.gather(np.column_stack([numbers.astype(float), values]))
        if parts is None:
            return np.empty((0, 0))
        rows = np.concatenate(parts)
        _, first = np.unique(rows[:, 0], return_index=True)
        return rows[first]

    def _wanted(self, rows: Array | None, numbers: Array) -> Array:
        """Of rows (number, values...) on rank 0 the values of the numbers that each rank wants."""
        width = self.comm.bcast(rows.shape[1] if rows is not None else None)
        rows = rows if rows is not None else np.empty((0, width))
        return carry(self.comm, rows[:, 0].astype(np.int64), rows[:, 1:], numbers)


class _Places:
    """Where values sit: (cells, k) places by cell, in an order that depends on the joint alone.

    Attributes:
        numbers: (cells,) original numbers of cells or facets.
        order: (cells, k) local index of the values of each cell.
    """

    def __init__(self, numbers: Array, indices: Array, x: Array | None) -> None:
        self.numbers, self.order = numbers, indices
        if x is not None:
            along = x @ np.array(DIRECTION[: x.shape[1]])
            self.order = np.take_along_axis(indices, np.argsort(along[indices], axis=1), axis=1)

    @classmethod
    def of_points(cls, points: LawPoints) -> _Places:
        """Places of quadrature points; in a cell their order is the cell's own."""
        region = points.region
        on_facets = region.dim < region.domain.joint.dim
        return cls(region.original[: len(points.cells)], points.cells, points.x if on_facets else None)

    @classmethod
    def of_dofs(cls, space: fem.FunctionSpace, region: Region) -> _Places:
        """Places of the degrees of freedom of a scalar space on a region, ghosts included."""
        cells = np.asarray(space.dofmap.list)
        x = space.tabulate_dof_coordinates()[:, : region.domain.joint.dim]
        return cls(region.original[: len(cells)], cells, x)

    def ordered(self, values: Array) -> Array:
        """Values (places, v) as rows (cells, k v)."""
        return values[self.order].reshape(len(self.numbers), self.order.shape[1] * values.shape[1])

    def put(self, out: Array, rows: Array) -> None:
        """The way back: fill (places, v)."""
        out[self.order.ravel()] = rows.reshape(self.order.size, out.shape[1])
