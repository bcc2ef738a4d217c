"""The files that a march resumes from, on any number of ranks."""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from thinlayer.equations import Equations
from thinlayer.exchange import carry
from thinlayer.loads import ModelError
from thinlayer.model import Model
from thinlayer.pointwise.points import LawPoints, Region
from thinlayer.state import Audit, Report, State, cell_values
from thinlayer.table import Table
from thinlayer.time.history import History

Array = npt.NDArray[Any]
DIRECTION = (0.5403023058681398, 0.2926817141205163, 0.7890437903507289)  # tells the points of a facet apart


def fingerprint(model: Model, **choices: Any) -> str:
    """What must be the same for a march to be resumed; loads, as functions, are not in it."""
    joint, layer = model.joint, model.layer
    content = {
        "model": repr(model),
        "cells": len(model.domain.joint.cells),
        "coordinates": [float(np.abs(joint.points).sum()), float(np.abs(joint.points).max())],
        "plane": model.plane,
        "law": repr(layer.law) if layer else None,
        "eps": float(layer.eps) if layer else None,
        "order": layer.order if layer else None,
        **choices,
    }
    return json.dumps(content, sort_keys=True)


@dataclass
class Pace:
    """What the length of the next steps depends on.

    Attributes:
        step: longest that the next step may be; None if nothing limits it.
        largest: norm of the largest displacements so far.
    """

    step: float | None
    largest: float = 0.0


class Checkpoint:
    """The files of a march in a folder: march.json with the table so far and the pace, and its states.

    Values are kept by the original number of the cell, or of the facet of S, that they belong to, in an order that the
    distribution has no part in. Files are replaced as a whole, states before the table that names them: a killed run
    leaves what it had. Collective, as all methods are.
    """

    def __init__(self, folder: Path, equations: Equations) -> None:
        self.folder, self.model, self.comm = folder, equations.model, equations.comm
        self.path = folder / "march.json"
        mesh = self.model.domain.mesh
        owned = mesh.topology.index_map(mesh.topology.dim).size_local
        self._owned, self._cells = np.arange(owned, dtype=np.int32), self.model.domain.original_cells
        self._points = [_Places.of_points(p) for p in equations.points]
        self._pressures = equations.constraint

    def _file(self, row: int) -> Path:
        return self.folder / "states" / f"{row:06d}.npz"

    def forget(self) -> None:
        """Remove the files of an earlier march."""
        if self.comm.rank == 0 and self.path.exists():
            self.path.unlink()
            for file in (self.folder / "states").glob("*.npz"):
                file.unlink()

    # ---------------------------------------------------------------- writing
    def write(self, mark: str, history: History, pace: Pace, new: list[int]) -> None:
        """Add the states of new rows, and replace the table; states that the history does not keep go."""
        for row in new:
            if row in history.states:
                self._write_state(row, history.states[row])
        if self.comm.rank:
            return
        rows = [list(row.values()) for row in history.table.rows]
        content = {"mark": mark, "pace": asdict(pace), "columns": history.table.columns, "rows": rows}
        with _replaced(self.path) as file:
            file.write(json.dumps(content).encode())
        for stale in (self.folder / "states").glob("*.npz"):
            if int(stale.stem) not in history.states:
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
        with _replaced(self._file(row)) as file:
            np.savez(file, allow_pickle=False, **arrays)

    # ---------------------------------------------------------------- reading
    def read(self, mark: str, keep: str) -> tuple[History, Pace] | None:
        """History and pace of the march; None if there is none.

        Raises:
            ModelError: the files are of another march, or damaged.
        """
        content, problem = self.comm.bcast(self._content(mark) if self.comm.rank == 0 else None)
        if problem:
            raise ModelError(problem)
        if content is None:
            return None
        table = Table(dict(zip(content["columns"], row, strict=True)) for row in content["rows"])
        last = len(table) - 1
        rows = self.comm.bcast([row for row in range(last + 1) if self._file(row).exists()])
        states = {row: self._read_state(row, table) for row in (rows if keep == "all" else [last])}
        return History(self.model, table, states), Pace(**content["pace"])

    def _content(self, mark: str) -> tuple[dict[str, Any] | None, str | None]:
        """What march.json says, or what is wrong with it; on rank 0."""
        if not self.path.exists():
            return None, None
        try:
            content = json.loads(self.path.read_text())
            there, here = json.loads(content["mark"]), json.loads(mark)
        except (OSError, ValueError, KeyError) as error:
            return None, f"{self.path} cannot be read ({error}); remove it to start anew"
        if there != here:
            other = [f"{k}: {there.get(k)} there, {here.get(k)} here" for k in here if here[k] != there.get(k)]
            return None, f"{self.path} is of another march ({'; '.join(other)}); remove it to start anew"
        return content, None

    def _read_state(self, row: int, table: Table) -> State:
        arrays, problem = self._arrays(self._file(row)) if self.comm.rank == 0 else ({}, None)
        if problem := self.comm.bcast(problem):
            raise ModelError(problem)
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
        found = {name: float(value or 0.0) for name, value in table.rows[row].items() if not isinstance(value, str)}
        audit = Audit(found["supplied"], found["stored"], found["dissipated"], found["remainder"], layer)
        report = Report("resumed", int(found["iterations"]), found["residual"], 0.0)
        return State(self.model, u, t, report, p, tuple(memory), audit)

    @staticmethod
    def _arrays(path: Path) -> tuple[dict[str, Array], str | None]:
        try:
            with np.load(path, allow_pickle=False) as file:
                return dict(file), None
        except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
            return {}, f"{path} cannot be read ({error}); remove the folder to start anew"

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


@contextmanager
def _replaced(path: Path) -> Iterator[BinaryIO]:
    """A file that takes the place of another one when it is whole and on the disk."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".part")
    with partial.open("wb") as file:
        yield file
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
    folder = os.open(path.parent, os.O_RDONLY)
    os.fsync(folder)
    os.close(folder)


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
