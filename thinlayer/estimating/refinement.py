"""Adaptive meshes for bounds of goals in the continuum: cells that widen the bounds are divided up to a tolerance.

The width of a goal's interval is the sum of indicators (attribute `by_cell` of `ContinuumBounds`). What is refined is a
cell of the bodies; a facet of S, with the layer's cells above it that are wider than high; a row of the layer's cells,
for those that are higher than wide; or the iteration that leads from the interface law to the meshed layer. The largest
indicators with half of the sum are marked (Doerfler 1996).
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from forms.base import Array, InputError, is_finite, is_integer, require
from geometry.inflating.band_cells import level_heights
from geometry.joint import Joint
from geometry.refining import refined
from geometry.refusals import place_text, require_known
from geometry.topology import BoolArray, FloatArray, IntArray, is_tensor
from thinlayer.discretisation.full_model import LayerModel
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.errors import SolveError, Violation, warn
from thinlayer.estimating.continuum import ContinuumBounds
from thinlayer.estimating.estimate import estimate
from thinlayer.estimating.global_local import DEFAULT_WIDTH
from thinlayer.estimating.goals import Compliance, Goal
from thinlayer.estimating.result import FIXED_GOAL_TOLERANCE, Estimate
from thinlayer.solving.petsc import Options
from thinlayer.solving.solve import solve
from thinlayer.system.progress import report
from thinlayer.system.table import Table
from thinlayer.system.units import percent

MARKED_SHARE = 0.5  # share of the interval's width whose causes are refined at once
WIDTH_REDUCTION = 0.1  # factor of the estimate's `width` if the interface law causes a large part of the interval
MIN_WIDTH = 1e-6  # least `width`, at which steps from the interface law have only rounding errors
MAX_MESHES = 60  # largest number of meshes
MAX_CELLS = 20_000  # number of cells of bodies and layers above which a mesh is the last
Heights = dict[str, FloatArray]  # name of a seam -> heights between which the rows of its layer lie, from 0 to 1


class Causes(NamedTuple):
    """Causes of the width of an interval that are refined at once.

    Attributes:
        cells: numbers of cells of the bodies.
        facets: numbers of facets of S.
        rows: name of a seam -> mask (n_rows,) of the rows of its layer.
        law: whether the estimate makes more steps from the interface law to the meshed layer.
    """

    cells: IntArray
    facets: IntArray
    rows: dict[str, BoolArray]
    law: bool


@dataclass(frozen=True)
class Indicators:
    """Parts of the width of an interval, by what can be refined.

    Attributes:
        bodies: (n_cells,) parts of the cells of bodies.
        facets: (n_S,) parts of the layers' cells that are wider than high, summed over those above a facet of S.
        rows: name of a seam -> parts of the other cells of its layer, by rows from the lower to the upper face. Where
            layers meet, the cells of the junctions belong to the first seam.
        law: part of the interface law.
    """

    bodies: FloatArray
    facets: FloatArray
    rows: Mapping[str, FloatArray]
    law: float

    @classmethod
    def of(cls, parts: Array, law: float, joint: Joint, layers: LayerModel, heights: Heights) -> Indicators:
        """Return the indicators of an interval.

        Args:
            parts: (nc,) parts of the width from the cells of bodies and layers.
            law: part of the interface law, which `parts` of the layers' cells contain.
            joint: the joint without meshed layers.
            layers: model of the meshed layers.
            heights: heights of the rows of each layer.
        """
        inflated, d, n_bodies = layers.inflated_joint, joint.dim, len(joint.cells)
        x, vertices = inflated.points[inflated.corners[n_bodies:]], joint.points[joint.surface[:, : joint.dim]]
        volumes = np.abs(np.linalg.det(x[:, 1:] - x[:, :1])) / math.factorial(d)
        edges = vertices[:, 1:] - vertices[:, :1]
        areas = np.sqrt(np.linalg.det(edges @ np.swapaxes(edges, 1, 2))) / math.factorial(d - 1)
        facet_parts, row_parts, first = np.zeros(len(areas)), {}, 0
        total = float(parts[n_bodies:].sum())
        of_layers = parts[n_bodies:] * max(1 - law / total, 0.0) if total else parts[n_bodies:]
        for name, levels in heights.items():
            facets, n_rows = joint.facets_of(name), len(levels) - 1
            shape, size = (n_rows, d, len(facets)), n_rows * d * len(facets)
            of_seam, volume = (values[first : first + size].reshape(shape) for values in (of_layers, volumes))
            is_wide = areas[facets] ** (d / (d - 1)) > d * volume  # area^(1/(d-1)) is a width, d volume/area a height
            facet_parts[facets] += np.where(is_wide, of_seam, 0.0).sum(axis=(0, 1))
            row_parts[name] = np.where(is_wide, 0.0, of_seam).sum(axis=(1, 2))
            first += size
        next(iter(row_parts.values()))[0] += of_layers[first:].sum()
        return cls(parts[:n_bodies], facet_parts, row_parts, law)

    def marked(self) -> Causes:
        """Return the largest causes, which make up half of the width of the interval."""
        all_parts = np.concatenate([self.bodies, self.facets, *self.rows.values(), [self.law]])
        order = np.argsort(-all_parts, kind="stable")
        sums = np.cumsum(all_parts[order])
        is_marked = np.zeros(len(order), bool)
        is_marked[order[: np.searchsorted(sums, MARKED_SHARE * sums[-1]) + 1]] = True
        ends = np.cumsum([len(self.bodies), len(self.facets), *map(len, self.rows.values())])
        bodies, facets, *rows, law = np.split(is_marked, ends)
        return Causes(
            np.flatnonzero(bodies), np.flatnonzero(facets), dict(zip(self.rows, rows, strict=True)), bool(law)
        )


@dataclass(frozen=True, repr=False)
class Refinement:
    """Goals of the continuum with bounds as narrow as wished, the result of `solve_to`.

    Attributes:
        bounds: name of a goal -> its bounds for any mesh, on the best cells: the last ones if the tolerance is reached.
            Their `value` is that of the interface model on the cells that the user gave.
        errors: name of a goal -> half the interval over the quantity to which the tolerance is relative.
        of: "goal" or "change": that quantity.
        estimate: the estimate on these cells, with state, joint and model.
        table: a row for each mesh: "unknowns" (of the interface model), "cells" (of bodies and layers), "seconds" (so
            far), then for each goal "NAME lower", "NAME upper" and "NAME error", of `errors`.
        reason: why the tolerance was not reached; "": it was.
    """

    bounds: Mapping[str, ContinuumBounds]
    errors: Mapping[str, float]
    of: str
    estimate: Estimate
    table: Table
    reason: str = ""

    @property
    def reached(self) -> bool:
        """Whether all goals are known to the tolerance."""
        return not self.reason

    def __str__(self) -> str:
        of_change, goals = " of the change" * (self.of == "change"), []
        for name, bounds in self.bounds.items():
            half = f"+- {percent(self.errors[name])}{of_change}"
            goals.append(f"{name} {bounds.lower:.6g} to {bounds.upper:.6g}, {half}")
        text = f"{'; '.join(goals)}; for any mesh, by {self.estimate.state.model.unknowns} unknowns"
        return f"{text}; {self.reason}" if self.reason else text

    def __repr__(self) -> str:
        return f"Refinement({self})"

    def ended(self, tolerance: float, reason: str) -> Refinement:
        """Warn that the tolerance is not reached, and return the result with the reason."""
        remedy = "the bounds hold all the same; allow a larger tolerance"
        text = f"solve_to: the tolerance {percent(tolerance)} is not reached: {reason}; {remedy}"
        warn("tolerance", text, self.estimate.state.model.comm)
        return replace(self, reason=reason)


@report("solve_to")
def solve_to(
    model: InterfaceModel,
    goals: Sequence[Goal] = (Compliance(),),
    tolerance: float = 0.02,
    *,
    of: str = "goal",
    t: float = 0.0,
    max_cells: int = MAX_CELLS,
    options: Options | None = None,
) -> Refinement:
    """Solve on finer and finer cells until goals of the continuum are known to a tolerance.

    Bounds hold for any mesh, see `Estimate.continuum`: the true goal differs from the middle of its bounds by at most
    the tolerance. The given cells are divided where they cause the width of the interval: those of bodies, on both sides
    of S alike, and the layer's, along S and through its thickness. Names, supports, loads and laws stay the same. Curved
    sides stay the polygons that the given cells describe.

    Args:
        model: the interface model, `structure.interface(layer)`, on the first cells: straight triangles or tetrahedra.
        goals: quantities of interest.
        tolerance: largest half of the interval, > 0, relative to what `of` says.
        of: "goal": relative to the goal's value. "change": relative to its change if the given model is replaced by the
            continuum, which answers whether the layer's mesh may be dropped.
        t: time of loads and supports.
        max_cells: number of cells of bodies and layers above which a mesh is the last.
        options: {name of a PETSc option without its prefix: value}, as in `solve`.

    Returns:
        Bounds, and the estimate on the best cells so far. If the tolerance is not reached, a warning and `reason` say why.

    Raises:
        InputError: a structure or goal without bounds for any mesh, or cells that cannot be divided, with a key and a
            remedy.
        SolveError: the structure on the first cells has no unique solution.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, solve_to
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> plates = Structure(
        ...     sandwich(4, 1, 2, h=0.5),
        ...     body=steel,
        ...     supports={"BOTTOM": 0},
        ...     tractions={"TOP": (3, -10)},
        ... )
        >>> model = plates.interface(ThinLayer(glue, eps=0.05))
        >>> result = solve_to(model, tolerance=0.01)
        >>> print(result.table["unknowns"], result.reached)
        [588. 608.] True
    """
    _check_arguments(model, goals, tolerance, of, max_cells)
    start, width, table, best = time.perf_counter(), DEFAULT_WIDTH, Table(), None
    first_values: dict[str, float] = {}
    heights = {name: level_heights(1, 4, layer.as_thin_layer.fractions) for name, layer in model.layers.items()}
    while True:
        try:
            through = {name: tuple(map(float, levels)) for name, levels in heights.items()}
            result = estimate(solve(model, t, options=options), None, goals, width=width, cells_through=through)
            bounds = result.continuum()
        except (InputError, SolveError) as error:
            if best is None:
                raise
            return best.ended(tolerance, f"finer cells have no bounds: {error}")
        first_values = first_values or {name: b.value for name, b in bounds.items()}
        bounds = {name: replace(b, value=first_values[name]) for name, b in bounds.items()}
        errors = {name: _relative_half(b, of, result.goals[name].scale) for name, b in bounds.items()}
        worst, layers = max(errors, key=lambda name: errors[name]), result.inside.model
        assert isinstance(layers, LayerModel)
        inflated = layers.inflated_joint
        n_cells = len(inflated.cells)
        row: dict[str, Any] = {"unknowns": model.unknowns, "cells": n_cells, "seconds": time.perf_counter() - start}
        for name, b in bounds.items():
            row |= {f"{name} lower": b.lower, f"{name} upper": b.upper, f"{name} error": errors[name]}
        table.append(row)
        if best is None or errors[worst] <= max(best.errors.values()):
            best = Refinement(bounds, errors, of, result, table)
        if errors[worst] <= tolerance:
            return best
        largest = inflated.points[inflated.corners[int(np.argmax(bounds[worst].by_cell))]].mean(axis=0)
        if n_cells > max_cells or len(table.rows) == MAX_MESHES:
            limit = f"max_cells={max_cells}, which may be larger" if n_cells > max_cells else f"{MAX_MESHES} meshes"
            text = (
                f"{worst} is known to {percent(best.errors[worst])}, with the largest part near {place_text(largest)}"
            )
            return best.ended(tolerance, f"{text}, by {n_cells} cells; the limit is {limit}")
        wide = [b for name, b in bounds.items() if errors[name] > tolerance]
        parts = np.sum([b.by_cell / (b.upper - b.lower) for b in wide], axis=0)
        law = sum(b.law for b in wide) if width > MIN_WIDTH else 0.0  # else more steps have no effect
        causes = Indicators.of(parts, law, model.joint, layers, heights).marked()
        width = max(width * WIDTH_REDUCTION, MIN_WIDTH) if causes.law else width
        heights = _divided(heights, causes.rows, model.joint.seams_meet)
        if len(causes.cells) or len(causes.facets):
            model = model.with_joint(refined(model.joint, causes.cells, model.joint.surface_rows[causes.facets]))


def _divided(heights: Heights, rows: Mapping[str, BoolArray], together: bool) -> Heights:
    """Return the heights with marked rows halved, symmetrically about the middle; `together`: in all layers alike."""
    out = {}
    for name, levels in heights.items():
        mask = np.logical_or.reduce([*rows.values()]) if together else rows[name]
        out[name] = np.sort(np.append(levels, (levels[1:] + levels[:-1])[mask | mask[::-1]] / 2))
    return out


def _relative_half(bounds: ContinuumBounds, of: str, scale: float) -> float:
    """Return half the interval over the goal or, `of` = "change", over its change; 0 if it is rounding of `scale`."""
    middle = (bounds.lower + bounds.upper) / 2
    size = abs(middle) if of == "goal" else abs(middle - bounds.value)
    half = (bounds.upper - bounds.lower) / 2
    if half <= FIXED_GOAL_TOLERANCE * scale:  # equilibrium determines the goal, which may be zero, and its change is
        return 0.0
    return half / size if size else math.inf


def _check_arguments(model: InterfaceModel, goals: Sequence[Goal], tolerance: float, of: str, max_cells: int) -> None:
    require(isinstance(model, InterfaceModel), "solve_to: model", model, "give structure.interface(layer)")
    require(
        not isinstance(goals, Sequence) or len(goals) > 0,
        "solve_to: goals",
        goals,
        "give at least one of thinlayer.goals",
    )
    require(is_finite(tolerance) and tolerance > 0, "solve_to: tolerance", tolerance, "allowed: > 0, such as 0.02")
    require_known("reference (of=...)", of, ("goal", "change"), "solve_to")
    require(is_integer(max_cells, 1), "solve_to: max_cells", max_cells, "allowed: whole numbers >= 1")
    if model.bonds:
        reason = f"bodies are bonded at {', '.join(model.bonds)}, so that the layer is not known"
        raise Violation("bonded", reason, "give the layer, structure.interface(layer)").error("solve_to: ")
    for name in model.layers:
        model.applicability[name].require("estimate", "solve_to: ")
    if is_tensor(model.joint.cell_type):
        raise Violation(
            "divided", f"cells of the type {model.joint.cell_type} are not divided", "use triangles or tetrahedra"
        ).error("solve_to: ")
