"""Free ends of a layer: constants with which laws of order 1 correct them, and errors with and without the correction.

The constants are those of a layer between rigid faces, in plane strain on the half strip x > 0, 0 < y < 1. The faces
y = 0 and y = 1 are moved by -w/2 and w/2, across the layer (N) or along it (T). The end x = 0 is free. Far from it the
strain is uniform; near it the layer is weaker. Lengths are relative to the thickness, stresses to mu.

A few quadrilaterals shrink towards the singular corner, with displacements of a high degree p and pressures of degree
p - 2. The pressures are discontinuous, so that nothing locks up to an incompressible material.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import basix.ufl
import dolfinx.mesh
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI
from scipy.sparse.linalg import splu

from forms import BulkLaw, Incompressible, LinearElastic, Rubber
from forms.base import Array
from forms.ends import FreeEnd, free_end
from forms.ends.constants import TABLE_FILE, flow_factor, lame_over_mu
from forms.tensors import Expr
from geometry import block
from geometry.domain import create_mesh
from geometry.topology import BoolArray
from studies.problems import FOURIER_BODY, free_blocks, top_loaded
from studies.sweeping import last_order, reaction_error
from thinlayer import Structure, ThinLayer, compare, plotting, solve
from thinlayer.errors import RangeWarning
from thinlayer.running.record import Record
from thinlayer.system.table import Table

POISSON_RATIOS = (0.0, 0.1, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.475, 0.49, 0.499, 0.4999, 0.5)  # Poisson's ratios
EPS = (1 / 16, 1 / 32, 1 / 64, 1 / 128)
CELLS_2D = 24  # per thickness, through it and near the ends: with 12 the mesh's own error is of order 1.5 at nu = 0.45
CELLS_RUBBER = 12
CORRECTED, IGNORED = "known", "ignored"  # treatment of ends; laws that ignore them treat the layer as infinite
EDGE_OPTIONS = {CORRECTED: "free", IGNORED: "plain"}
QUANTITIES = ("traction", "jump", "work")
CELL_SIZE, H_S = 1 / 8, 1 / 32  # cell sizes
UNEQUAL_LAWS = {"LOWER": LinearElastic.young(E=20.0, nu=0.2), "UPPER": FOURIER_BODY}

MIDDLE_Y = 0.5  # y of the middle line; the half of the strip below it is solved
FAR_X = 14.0  # x at which fields that decay over the thickness are negligible
GRADING_RATIO = 0.2  # ratio of sizes of cells that shrink towards the corner
LEVELS, DEGREE = 10, 10  # number of times that cells shrink, and degree of displacements: constants to nine digits
SPLIT_LMBDA = -0.5  # first Lame modulus over mu of the stress without the pressure, which stays positive definite


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


# ---------------------------------------------------------------- the half strip
def compute_free_end(nu: float, degree: int = DEGREE, levels: int = LEVELS) -> FreeEnd:
    """Compute the constants of a layer's free end, by finite elements on a half strip between rigid faces.

    Args:
        nu: Poisson's ratio, in [0, 0.5].
        degree: polynomial degree of the displacements, >= 3.
        levels: number of times that the size of cells decreases by the factor 0.2 towards the corner.

    Returns:
        The constants; lengths are relative to the thickness, stresses to the shear modulus.

    Raises:
        InputError: nu out of range.
    """
    lmbda = lame_over_mu(nu)
    delta = math.sqrt(lmbda / 12) if lmbda < math.inf else 0.0  # decay length of the pressure in case N
    mesh = _half_strip_mesh(levels, max(FAR_X, 24 * delta), 2 * delta)
    cell, variants = "quadrilateral", basix.LagrangeVariant
    u_element = basix.ufl.element("P", cell, degree, lagrange_variant=variants.gll_warped, shape=(2,))
    p_element = basix.ufl.element("P", cell, degree - 2, lagrange_variant=variants.legendre, discontinuous=True)
    W = fem.functionspace(mesh, basix.ufl.mixed_element([u_element, p_element]))
    (u, p), (v, q), x = ufl.TrialFunctions(W), ufl.TestFunctions(W), ufl.SpatialCoordinate(mesh)
    quadrature = {"quadrature_degree": 2 * degree + 5}
    dx = ufl.Measure("dx", domain=mesh, metadata=quadrature)
    end_facets = dolfinx.mesh.locate_entities_boundary(mesh, 1, lambda x: x[0] < GRADING_RATIO ** (levels + 1))
    tags = dolfinx.mesh.meshtags(mesh, 1, end_facets, np.ones(len(end_facets), np.int32))
    ds_end = ufl.Measure("ds", domain=mesh, subdomain_data=tags, metadata=quadrature)(1)

    def stress(u: Expr, p: Expr) -> Expr:
        return (SPLIT_LMBDA * ufl.div(u) + p) * ufl.Identity(2) + 2 * ufl.sym(ufl.grad(u))

    compliance = fem.Constant(mesh, 1 / (lmbda - SPLIT_LMBDA))
    form = ufl.inner(stress(u, p), ufl.grad(v)) * dx + q * (ufl.div(u) - compliance * p) * dx
    K = fem.assemble_matrix(fem.form(form)).to_scipy().tocsr()

    def locate_dofs(space: fem.FunctionSpace, where: Callable[[Array], BoolArray]) -> npt.NDArray[np.int32]:
        return np.asarray(fem.locate_dofs_geometrical((space, space.collapse()[0]), where)[0])

    face_dofs = locate_dofs(W.sub(0), lambda x: (x[1] < 1e-13) | np.isclose(x[0], x[0].max()))

    def solve_loaded(traction: Expr, zero_component: int) -> tuple[float, Callable[[Expr], float]]:
        """Solve the half strip with fixed faces under a traction on its end x = 0.

        Args:
            traction: the traction (2,), a function of the place.
            zero_component: displacement component that is zero on the middle line by symmetry, 0 for x, 1 for y.

        Returns:
            The work of the traction in its displacements; and a function that integrates f(stress) over the solved half
            of the strip, where f maps the stress (2, 2) to a UFL scalar.
        """
        load = fem.assemble_vector(fem.form(ufl.inner(traction, v) * ds_end)).array
        bc_dofs = np.union1d(face_dofs, locate_dofs(W.sub(0).sub(zero_component), lambda x: np.isclose(x[1], MIDDLE_Y)))
        free_dofs, w = np.setdiff1d(np.arange(len(load)), bc_dofs), fem.Function(W)
        w.x.array[free_dofs] = splu(K[free_dofs][:, free_dofs].tocsc()).solve(load[free_dofs])
        s = stress(*ufl.split(w))
        return float(load @ w.x.array), lambda f: float(fem.assemble_scalar(fem.form(f(s) * dx)))

    X, Y, zero = x[0], x[1] - MIDDLE_Y, 0 * x[0]
    # T: u_x is odd in y - 1/2; the end is pushed by mu w, which cancels the traction of the uniform strain
    work, integrate = solve_loaded(ufl.as_vector([zero, zero + 1]), zero_component=0)
    c_T, m_T = 2 * work, -2 * integrate(lambda s: s[0, 1] * X + s[0, 0] * Y)
    if nu == 0.5:
        # Poiseuille's flow out of the end, 1/8 - (y - 1/2)^2/2 with the pressure x, has a shear stress on it
        work, _ = solve_loaded(ufl.as_vector([zero, -Y]), zero_component=1)
        return FreeEnd(nu, math.inf, math.inf, math.inf, c_T, m_T, 1 / (1 - 24 * work))
    # N: u_y is odd in y - 1/2; the end is pressed by lmbda w, here by 1
    work, integrate = solve_loaded(ufl.as_vector([zero + 1, zero]), zero_component=1)
    M = lmbda + 2
    c_N, rho_N = 2 * work * lmbda**2 / M, -2 * integrate(lambda s: s[0, 0])
    m_N = -2 * lmbda / M * integrate(lambda s: s[1, 1] * X + s[0, 1] * Y)
    kappa = flow_factor(delta, c_N * M / lmbda - delta) if lmbda else 0.0
    return FreeEnd(nu, c_N, m_N, rho_N, c_T, m_T, kappa)


def _half_strip_mesh(levels: int, length: float, max_length: float) -> dolfinx.mesh.Mesh:
    """Mesh the half of the strip below its middle line, from x = 0 to `length`.

    Cells shrink `levels` times by the factor 0.2 towards the corner (0, 0). Far from the end x = 0 they are at most
    `max_length` long. Lengths are relative to the strip's height.
    """
    points, cells = [(0.0, 0.0)], []
    for size in MIDDLE_Y * GRADING_RATIO ** np.arange(levels, -1, -1.0):  # a square, then pairs of trapezoids around it
        k = len(points)
        points += [(size, 0.0), (0.0, size), (size, size)]
        cells += [[0, 1, 2, 3]] if k == 1 else [[k - 2, k - 1, k + 1, k + 2], [k - 3, k, k - 1, k + 2]]
    right_vertices, cell_length = [len(points) - 3, len(points) - 1], MIDDLE_Y
    while points[-1][0] < length:
        if points[-1][0] > FAR_X / 2:
            cell_length = max(cell_length, min(1.5 * cell_length, max_length))
        x, k = points[-1][0] + cell_length, len(points)
        points += [(x, 0.0), (x, MIDDLE_Y)]
        cells.append([right_vertices[0], k, right_vertices[1], k + 1])
        right_vertices = [k, k + 1]
    return create_mesh(MPI.COMM_SELF, np.array(points), np.array(cells), "quadrilateral")


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
        table_ratios = np.loadtxt(TABLE_FILE, delimiter=",", skiprows=1, usecols=0)
        _check_constants(record, "nodes.csv", table_ratios, 1e-9)
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
        row[_column_name("work", treatment)] = abs(limit.load_work() / full.load_work() - 1)
    return row


def _is_inner(x: Array) -> BoolArray:
    return np.asarray(abs(x[0] - 0.5) < 0.25)


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
