"""Free ends of a layer: constants with which laws of order 1 correct them, and errors with and without the correction.

The study also checks for which stiffness of the bodies the correction is good.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from forms import BulkLaw, Incompressible, LinearElastic, Rubber
from forms.base import Array
from forms.ends import free_end
from forms.ends.constants import chebyshev_poisson_ratios
from geometry import block
from geometry.topology import BoolArray
from studies.half_strip import compute_free_end
from studies.problems import FOURIER_BODY, free_blocks, top_loaded
from studies.sweeping import last_order, reaction_error
from thinlayer import Structure, ThinLayer, compare, plotting, solve
from thinlayer.discretisation.state import State
from thinlayer.errors import RangeWarning
from thinlayer.running.record import Record
from thinlayer.system.table import Table

POISSON_RATIOS = (0.0, 0.1, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.475, 0.49, 0.499, 0.4999, 0.5)  # Poisson's ratios
N_TABLE_ROWS = 17  # number of rows of the package's table
EPS = (1 / 16, 1 / 32, 1 / 64, 1 / 128)
CELLS_2D = 24  # per thickness, through it and near the ends: with 12 the mesh's own error is of order 1.5 at nu = 0.45
CELLS_RUBBER = 12
CORRECTED, IGNORED = "known", "ignored"  # treatment of ends; laws that ignore them treat the layer as infinite
EDGE_OPTIONS = {CORRECTED: "free", IGNORED: "plain"}
QUANTITIES = ("traction", "jump", "work")
CELL_SIZE, H_S = 1 / 8, 1 / 32  # cell sizes
UNEQUAL_LAWS = {"LOWER": LinearElastic.young(E=20.0, nu=0.2), "UPPER": FOURIER_BODY}


# ---------------------------------------------------------------- structures
@dataclass(frozen=True)
class EndCase:
    """A structure whose layer has free ends, and the rates of convergence that errors of interface laws must have.

    Attributes:
        name: name of the structure.
        make_structure: function of the thickness, and of the number of cells per thickness near the ends of S, that
            returns the structure.
        law: law of the layer.
        min_order: least allowed rate of convergence, between the two smallest thicknesses, if the law corrects the
            ends.
        slow_errors: errors ("traction", "jump", "work") whose rate must not exceed 1.3 if the law ignores the ends.
            Errors that are not listed may change sign.
    """

    name: str
    make_structure: Callable[[float, float], Structure]
    law: BulkLaw
    min_order: float = 1.9
    slow_errors: Sequence[str] = QUANTITIES

    @property
    def csv_name(self) -> str:
        """Name of the csv file with the errors for all thicknesses."""
        return f"{self.name.replace(', ', '_').replace(' ', '_')}.csv"


def _blocks(eps: float, cells: float) -> Structure:
    return free_blocks(eps / cells)


def _unequal_blocks(eps: float, cells: float) -> Structure:
    return free_blocks(eps / cells, lambda x, t: (-0.6, 1 + x[0]), (0.3, 0.6), body=UNEQUAL_LAWS)


def _block_on_base(eps: float, cells: float) -> Structure:
    joint = block(1.0, 0.5, h=CELL_SIZE, h_S=H_S, h_ends=eps / cells, cell="quadrilateral")
    return top_loaded(joint, (1.0, -0.2), supports={})


CASES = (
    EndCase("equal blocks", _blocks, LinearElastic.shear(40.0, 0.3)),
    EndCase("equal blocks, nu = 0.45", _blocks, LinearElastic.shear(8.0, 0.45)),
    EndCase("unequal blocks, nu = 0.45", _unequal_blocks, LinearElastic.shear(1.6, 0.45)),
    EndCase("rigid base, sheared", _block_on_base, LinearElastic.shear(8.0, 0.3)),
)
RUBBERS = {"rubber, nu = 0.45": Rubber.shear(40.0, 0.45), "rubber, nu = 0.5": Incompressible(40.0)}
RUBBER_CASES = [EndCase(name, _blocks, law, min_order=1.6, slow_errors=("jump",)) for name, law in RUBBERS.items()]


# ---------------------------------------------------------------- errors
def run(record: Record, *, nu: Sequence[float] = POISSON_RATIOS, quick: bool = False) -> None:
    """Compute the constants of free ends, compare them with the package's table, and measure errors of laws of order 1.

    The constants (`FreeEnd`) describe how much less a layer bears near a free end. The package has a table of them,
    with which laws of order 1 correct their free ends.

    Args:
        record: record of the run, with its folder, tables and checks.
        nu: Poisson's ratios of the layer, from 0 to 0.5.
        quick: every other ratio, three structures with two thicknesses; the table's own rows are not computed anew.
    """
    _check_constants(record, "table.csv", nu[::2] if quick else nu, 1e-8)
    if quick:
        _check_rates(record, CASES[:1], EPS[:2], CELLS_2D // 2)
    else:
        _check_constants(record, "nodes.csv", chebyshev_poisson_ratios(N_TABLE_ROWS), 1e-9)
        _check_rates(record, CASES, EPS, CELLS_2D)
    _check_rates(record, RUBBER_CASES, EPS[:2] if quick else EPS, CELLS_RUBBER)


def _check_constants(record: Record, file: str, ratios: Iterable[float], high: float) -> None:
    """Compute the constants of free ends anew, and check them against those that the package has for its laws.

    Args:
        record: record of the run, which gets the file and the check.
        file: name of the csv file with the constants; those that are infinite have no entry.
        ratios: Poisson's ratios of the layer.
        high: largest relative difference that is allowed.
    """

    def row(nu: float) -> dict[str, float | None]:
        end, shipped = compute_free_end(nu), free_end(nu)
        errors = [abs(new / old - 1) for new, old in zip(end[1:], shipped[1:], strict=True) if 0 < old < math.inf]
        finite_constants = {name: value if value < math.inf else None for name, value in end._asdict().items()}
        return finite_constants | {"from_table": max(errors)}

    table = record.rows(file, map(float, ratios), row, "nu = {:g}")
    record.check(f"{file}: largest difference from the package's table", table["from_table"].max(), high=high)


def _error_row(record: Record, case: EndCase, cells: int, eps: float) -> dict[str, float]:
    """Measure errors of interface laws of order 1, with and without correction of free ends, at one thickness.

    Args:
        record: record of the run, which keeps the solver's reports.
        case: the structure.
        cells: number of cells through the layer, and per thickness near the ends.
        eps: thickness.

    Returns:
        Table row with "eps" and the errors relative to the meshed layer. "error_QUANTITY" is with correction,
        "error_QUANTITY, ignored" without. A quantity is "traction" or "jump", on the inner part of S, or "work", that
        of the loads on top.
    """
    structure, row, law = case.make_structure(eps, cells), {"eps": eps}, case.law
    full = record.add_report(solve(structure.full(ThinLayer(law, eps, at=1.0), cells_through=cells)))
    for treatment, edges in EDGE_OPTIONS.items():
        with warnings.catch_warnings(action="ignore", category=RangeWarning):  # says that ends are ignored
            limit = record.add_report(solve(structure.interface(ThinLayer(law, eps, order=1, edges=edges, at=1.0))))
        row[_column_name("traction", treatment)] = reaction_error(full, limit, _is_inner)["error_reaction"]
        row[_column_name("jump", treatment)] = compare(full, limit, where=_is_inner)["error_jump"]
        row[_column_name("work", treatment)] = abs(_work_on_top(limit) / _work_on_top(full) - 1)
    return row


def _is_inner(x: Array) -> BoolArray:
    return np.asarray(abs(x[0] - 0.5) < 0.25)


def _work_on_top(state: State) -> float:
    """Return the work of the tractions on "TOP" in the displacements of `state`.

    Other loads are left out, as a load on the layer's lateral side does work that no law on S includes.
    """
    model = state.model
    top_model = model.with_loads(tractions={"TOP": (model.structure.tractions or {})["TOP"]})
    return state.integral(top_model.external_work(state.u, state.t))


def _column_name(quantity: str, treatment: str) -> str:
    return f"error_{quantity}" + ("" if treatment == CORRECTED else f", {treatment}")


def _check_rates(record: Record, cases: Sequence[EndCase], sizes: Sequence[float], cells: int) -> None:
    """Write the errors of structures with free ends for decreasing thickness, and check their rates of convergence.

    Args:
        record: record of the run, which gets a table for each structure, and the checks.
        cases: the structures.
        sizes: the thicknesses, decreasing.
        cells: number of cells through the layer, and per thickness near the ends.
    """
    rows = Table()
    for case in cases:
        table = record.sweep(partial(_error_row, record, case, cells), sizes, case.csv_name)
        for kind in EDGE_OPTIONS:
            errors = {what: float(table[_column_name(what, kind)][-1]) for what in QUANTITIES}
            orders = {what: last_order(table, _column_name(what, kind)) for what in QUANTITIES}
            for what in QUANTITIES if kind == CORRECTED else case.slow_errors:
                bounds = {"low": case.min_order} if kind == CORRECTED else {"high": 1.3}
                record.check(f"{case.name}, ends {kind}: last order of the {what}", orders[what], **bounds)
            orders = {f"order of {what}": order for what, order in orders.items()}
            rows.append({"structure": case.name, "ends": kind, "eps": sizes[-1]} | errors | orders)
    record.say(rows)


def draw(record: Record) -> None:
    """Draw errors over the thickness, with and without correction, from the tables in the folder of `record`."""
    for case in (CASES[0], *RUBBER_CASES):
        table, errors = record.load(case.csv_name), {}
        for kind in EDGE_OPTIONS:
            columns = {f"error_{what}": table[_column_name(what, kind)] for what in QUANTITIES[:2]}
            errors[f"ends {kind}"] = Table.of({"eps": table["eps"], **columns})
        title, save = f"{case.name}, order 1, inner half of S", record.path(case.csv_name.replace(".csv", ".svg"))
        plotting.rates(errors, reference=2.0, title=title, save=save)
