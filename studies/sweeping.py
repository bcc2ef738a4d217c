"""Comparisons that several studies share: the meshed layer against its interface law for decreasing thickness."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy.typing as npt

from forms import BulkLaw
from forms.base import Array
from studies.problems import LayerOfThickness, Problem, fourier
from thinlayer import Structure, Surface, Table, ThinLayer, compare, plotting, solve
from thinlayer.discretisation.layer import SurfaceLaw
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.output.comparison import WhereFunction
from thinlayer.output.plotting.curves import as_fraction
from thinlayer.output.sweep import needed_columns
from thinlayer.running.record import Record
from thinlayer.solving.history import Solution
from thinlayer.surface.surface_mesh import Where as OnSurface

ErrorFloors = Mapping[str, tuple[float, float]]  # traction or jump -> range of the error that a wrong law leaves
Tables = dict[str, Table]
Field = Callable[[Surface, State], Array]
Curves = dict[str, tuple[npt.ArrayLike, npt.ArrayLike]]  # label -> x and y
LAW_KEY = "interface law"


def halves(k: int, n: int = 4) -> tuple[float, ...]:
    """Return the n thicknesses 2^-k, 2^-(k+1), ..."""
    return tuple(2.0**-exponent for exponent in range(k, k + n))


FOURIER_SQUARES, FROM_EIGHTH = partial(fourier, cell="quadrilateral"), halves(3)


@dataclass(frozen=True)
class Sweep:
    """A comparison of a meshed layer with its interface law in one structure for decreasing thickness.

    Attributes:
        layer_fn: function of the thickness that returns the layer.
        label: text that distinguishes the sweep from other sweeps of its law.
        problem: function of the cell size, or of another parameter of the mesh, that returns the joint and the
            arguments of its `Structure`.
        h: argument of `problem` without --quick, and with it.
        eps: thicknesses.
        orders: smallest and largest allowed rate of convergence of traction and jump, between the last two thicknesses.
            The second may be None: no upper bound. None: no such check.
        times: ends of the time steps, from rest under loads that act from t = 0 on; the last states are compared. None:
            a static solve.
        quick_steps: slice that selects those `times` that are used with --quick.
        wrong_law: law of the interface model in place of the layer's law, to show the error of a wrong law; None: the
            layer's law.
        bodies: bodies of the full model, and of interface models of order 1: "kept" (a meshed layer moves them apart)
            or "extended" (it is cut out of them).
        cells_through: number of cells through the meshed layer.
        where: function of the coordinates that selects the part of S on which errors are measured; None: all of S.
        layer_variants: suffix -> function of the thickness that returns a layer with another interface law. The errors
            of this law are further columns, whose names end with the suffix.
        extras_fn: function of the solutions of the full and the interface model that returns further columns, name ->
            number; None: none.
        along_fn: function of a state and S that returns x and fields along S, name -> array, drawn for both models;
            None: nothing is drawn along S.
        floors: "traction" or "jump" -> smallest and largest relative error that a wrong law leaves, see
            `check_floors`. The sweep of a wrong law has the name of the right law's sweep and one more word.
        check: function of the record and of the tables so far (name of a sweep -> table) that makes further checks; None:
            none.
        drawn: which thickness deformed structures are drawn at: 0 is the largest; None: no picture.
        unit: unit of lengths; "": none.
        slow: whether the sweep is left out with --quick.
    """

    layer_fn: LayerOfThickness
    label: str = ""
    problem: Callable[..., Problem] = FOURIER_SQUARES
    h: tuple[object, object] = (1 / 32, 1 / 8)
    eps: Sequence[float] = FROM_EIGHTH
    orders: tuple[float, float | None] | None = (0.93, 1.07)
    times: Sequence[float] | None = None
    quick_steps: slice = slice(None)
    wrong_law: BulkLaw | SurfaceLaw | None = None
    bodies: str = "kept"
    cells_through: int = 4
    where: WhereFunction | None = None
    layer_variants: Mapping[str, LayerOfThickness] = field(default_factory=dict)
    extras_fn: Callable[[Solution, Solution], dict[str, float]] | None = None
    along_fn: Callable[[State, Surface], dict[str, Array]] | None = None
    floors: ErrorFloors = field(default_factory=dict)
    check: Callable[[Record, Tables], None] | None = None
    drawn: int | None = 0
    unit: str = ""
    slow: bool = False

    def compare_all(self, record: Record, name: str, eps: Sequence[float], *, quick: bool, pictured: bool) -> Table:
        """Compare both models at each thickness, and check the last rates of convergence.

        The laws are printed, and deformed structures are drawn for one thickness.

        Args:
            record: record of the run, which writes the table and receives the checks.
            name: name of this `Sweep`.
            eps: thicknesses.
            quick: whether to use coarser meshes and fewer steps.
            pictured: whether to draw deformed structures.

        Returns:
            Table of the errors of traction and jump, and of the sweep's further columns, with a line for each thickness.
        """
        joint, setup = self.problem(self.h[quick])
        structure, case_file = Structure(joint, **setup), name.replace(" ", "_")
        times = self.times[self.quick_steps] if self.times and quick else self.times
        drawn_eps = None if self.drawn is None or not pictured else sorted(eps, reverse=True)[: self.drawn + 1][-1]
        law = self.layer_fn(eps[0]).law
        record.parameters[name] = {"layer": str(law), "h": self.h[quick], "times": times}

        def run_model(model: Model, what: str) -> Solution:
            return record.march(model, times, f"{what}_{case_file}") if times else record.add_report(solve(model))

        def solve_interface(layer: ThinLayer | SurfaceLaw, what: str) -> Solution:
            bodies = self.bodies if isinstance(layer, ThinLayer) and layer.order else "kept"
            return run_model(structure.interface(layer, bodies=bodies), what)

        def compare_at(e: float) -> dict[str, float]:
            layer, wrong_law = self.layer_fn(e), self.wrong_law
            full = run_model(structure.full(layer, bodies=self.bodies, cells_through=self.cells_through), f"full_{e:g}")
            law_or_layer = ThinLayer(wrong_law, e, at=1.0) if isinstance(wrong_law, BulkLaw) else wrong_law or layer
            limit = solve_interface(law_or_layer, f"interface_{e:g}")
            states = {f"meshed layer, eps = {e:.4g} {self.unit}".rstrip(): end_state(full), LAW_KEY: end_state(limit)}
            if self.along_fn:
                surface, rows = Surface(end_state(limit).model), Table()
                for model, state in states.items():
                    rows.extend(Table.of({"model": model, **self.along_fn(state, surface)}))
                record.write(along_file(name, e), rows)
            if e == drawn_eps:
                what = re.split(r"[;.]\s", getattr(self.problem, "func", self.problem).__doc__ or name)[0]
                title, save = ", ".join(filter(None, (what, self.label))), record.path(f"deformed_{case_file}.png")
                plotting.deformed(states, plotting.View(unit=self.unit), save=save, title=title)
            row = compare(full, limit, where=self.where)
            for suffix, variant_fn in self.layer_variants.items():
                errors = compare(full, solve_interface(variant_fn(e), f"interface{suffix}_{e:g}"), where=self.where)
                row |= {f"{column}{suffix}": errors[column] for column in needed_columns(errors)[1:]}
            return row | (self.extras_fn(full, limit) if self.extras_fn else {})

        record.say(f"meshed layer {law}, on S {self.wrong_law}" if self.wrong_law else law)
        table = record.sweep(compare_at, eps, table_file(name))
        low, high = self.orders or (None, None)
        columns = {column.removeprefix("error_"): column for column in needed_columns(table.columns)[1:]}
        columns |= {"traction": "error_reaction"} if "error_reaction" in table.columns else {}
        for what, column in columns.items() if self.orders and len(eps) > 1 else ():
            record.check(f"last observed order of the {what}, {name}", last_order(table, column), low=low, high=high)
        return table


def end_state(solution: Solution) -> State:
    """Return the last state of a history; a state is returned as it is."""
    return solution if isinstance(solution, State) else solution.last


def last_order(table: Table, column: str) -> float:
    """Return the observed rate of convergence between the last two rows of `table`; NaN if it cannot be computed.

    `column` is the name of a column of errors; the sizes are in the column "eps".
    """
    return table.orders(column)[-1] or math.nan


def reaction_error(full: Solution, limit: Solution, where: WhereFunction | None = None) -> dict[str, float]:
    """Measure the error of the tractions that are equivalent to the bodies' nodal forces on S (`Surface.reaction`).

    In the laws' own tractions the next term in eps nearly cancels, so that their errors do not show it.

    Args:
        full: solution of the full model.
        limit: solution of the interface model.
        where: function of the coordinates that selects a part of S; None: all of S.

    Returns:
        "error_reaction" -> relative error in the L2 norm on S.
    """
    state = end_state(limit)
    return {"error_reaction": difference(Surface(state.model), Surface.reaction, end_state(full), state, where or 1.0)}


def difference(surface: Surface, field: Field, state: State, reference: State, where: OnSurface | float = 1.0) -> float:
    """Return the relative difference between a field on S in two states, in the L2 norm on S.

    Args:
        surface: the surface S.
        field: function of S and a state that returns the field, as `Surface.jump`.
        state: a state.
        reference: state with which it is compared; the norm of its field is the divisor.
        where: function of the coordinates that selects a part of S, or weights on S, (n, q) at q points of n facets.
    """
    reference_field = field(surface, reference)
    return surface.norm(field(surface, state) - reference_field, where) / surface.norm(reference_field, where)


def check_floors(record: Record, name: str, wrong: Table, right: Table, floors: ErrorFloors) -> None:
    """Check that a wrong law's errors lie in their ranges, do not decrease with eps, and exceed those of the right law.

    Args:
        record: record of the run, which receives the checks.
        name: name of the `Sweep` of the wrong law.
        wrong: table of errors of the wrong law, a line for each thickness.
        right: table of errors of the right law.
        floors: "traction" or "jump" -> smallest and largest relative error of the wrong law at the smallest thickness.
    """
    for of, (low, high) in floors.items():
        errors = wrong[f"error_{of}"]
        record.check(f"error of the {of} that {name} leaves", errors[-1], low=low, high=high)
        record.check(f"error of the {of}, {name} over right law", errors[-1] / right[f"error_{of}"][-1], low=4.0)
        if len(errors) > 1:
            record.check(f"last observed order of the {of}, {name}", wrong[f"order_{of}"][-1], low=-0.2, high=0.2)


def table_file(case: str) -> str:
    """Return the name of the csv file with the table of errors of the `Sweep` named `case`."""
    return f"table_{case.replace(' ', '_')}.csv" if case else "table.csv"


def along_file(case: str, eps: float) -> str:
    """Return the name of the csv file with fields along S of the `Sweep` named `case`, at the thickness `eps`."""
    return f"along_{case.replace(' ', '_')}_{eps:g}.csv"


def draw_along(record: Record, cases: Mapping[str, str], name: str) -> None:
    """Draw a field along S in meshed layers of all thicknesses and under the interface law.

    The field is the last column of the tables along S in the folder of `record`.

    Args:
        record: record of the run.
        cases: title of a panel -> name of the `Sweep` drawn there.
        name: name of the picture's file, without its ending.
    """
    panels: dict[str, Curves] = {}
    for label, case in cases.items():
        for eps in record.load(table_file(case))["eps"]:
            table = record.load(along_file(case, eps))
            column = table.columns[-1]
            lines = panels.setdefault(f"{column}, {label}", {})
            for model, rows in table.split("model").items():
                lines.pop(LAW_KEY, None)  # the interface law comes last
                line = LAW_KEY if model == LAW_KEY else f"meshed layer, eps = {as_fraction(eps)}"
                lines[line] = rows["x"], rows[column]
    look = {"styles": {LAW_KEY: "--"}, "colours": {LAW_KEY: "black"}, "columns": 2, "save": record.path(f"{name}.svg")}
    plotting.curves(panels, "x along S over half the width", **look)
