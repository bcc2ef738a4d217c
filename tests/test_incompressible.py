"""Incompressible layers: the constraint, its multiplier, stability of the pair of spaces, and what they work with."""

from __future__ import annotations

from dataclasses import replace

import dolfinx.fem.petsc
import numpy as np
import pytest
import scipy.linalg
import ufl
from dolfinx import fem
from petsc4py import PETSc
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import splu

from forms import Incompressible, LinearElastic, VonMises
from forms.work import work
from geometry import ring, sandwich
from geometry.joint import Joint
from studies.problems import FOURIER_BODY, fourier
from tests import reference
from tests.orders import observed_orders
from tests.own_laws import Stiffening
from thinlayer import SolveError, Structure, Surface, ThinLayer, compare, march, solve
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.parts.pressure_part import PressurePart
from thinlayer.solving.solve import Solver

pytestmark = pytest.mark.few(5)

MU = 40.0
LAW = Incompressible(MU)
CELLS = ["triangle", "quadrilateral"]
BUILDS = [Structure.full, Structure.interface]
EXACT = 1e-10  # of a residual, relative to the sum of its terms' sizes
STIFF = 1e10  # lmbda per thickness of transfer matrices, in place of infinity


def sparse(A: PETSc.Mat) -> csr_matrix:
    indptr, indices, values = A.getValuesCSR()
    return csr_matrix((values, indices, indptr), shape=A.getSize())


def volume_change(model: Model) -> tuple[State, float]:
    """Equilibrium, and the largest int q tr e(u) of all pressures' basis functions q over the sum of its terms' sizes."""
    with Solver(model) as solver:
        state = solver.step(solver.rest_state(0.0), 0.0)
        (part,) = solver.equations.of_kind(PressurePart)
        G = sparse(part.G)
    u = state.u.x.array
    return state, float(np.abs(G @ u).max() / (abs(G) @ np.abs(u)).max())


def pressed(joint: Joint, **supports) -> dict:
    """Clamped below, pushed and sheared from above."""
    t = (0.3, -1.0, 0.1)[: joint.dim]
    return {"body": FOURIER_BODY, "supports": {"BOTTOM": 0.0} | supports, "tractions": {"TOP": t}}


# ---------------------------------------------------------------- many structures


def rubber_ring(cell):
    joint = ring(0.5, 1.0, 1.5, 0.25, degree=2, cell=cell)
    push = lambda x, t: (0.2 * x[1] - x[0], 1 - x[1])
    return joint, {"body": FOURIER_BODY, "supports": {"INSIDE": 0.0}, "tractions": {"OUTSIDE": push}}


def clamped_ends(cell):
    joint = sandwich(1.0, 0.5, 0.5, 1 / 8, cell=cell)
    return joint, pressed(joint, LEFT=0.0, RIGHT=0.0)


STRUCTURES = {"two bodies": lambda cell: fourier(1 / 8, cell=cell), "clamped ends": clamped_ends, "ring": rubber_ring}


def errors(structure, thicknesses, **choices):
    """Those of the interface law; the constraint holds and the energy balance closes in both models."""
    rows = []
    for eps in thicknesses:
        states, layer = [], ThinLayer(LAW, eps, at=1.0)
        for model in (structure.full(layer, **choices), structure.interface(layer)):
            state, change = volume_change(model)
            assert change < EXACT
            assert abs(state.audit.imbalance) < 1e-10
            energies = state.energies()
            assert energies["bodies"] + energies["layer"] == pytest.approx(energies["loads"] / 2, rel=1e-10)
            states.append(state)
        rows.append(compare(*states))
    return rows


@pytest.mark.parametrize(("name", "cell"), zip(STRUCTURES, [*CELLS, "triangle"], strict=True))
def test_structures(name, cell):
    """The constraint holds, the energy balance closes, the meshed layer's errors go to zero with about order 1."""
    joint, setup = STRUCTURES[name](cell)
    eps = (1 / 64, 1 / 128)
    rows = errors(Structure(joint, **setup), eps, bodies="kept" if joint.planar else "extended")
    for quantity in ("error_traction", "error_jump"):
        assert 0.9 < observed_orders(eps, [row[quantity] for row in rows])[1] < 1.3
    assert max(row["error_jump"] for row in rows) < 0.1


def test_three_dimensions():
    joint = sandwich(1.0, 0.5, 0.5, 0.5, depth=0.5, cell="tetrahedron")
    setup = pressed(joint, LEFT={"x": 0.0}, RIGHT={"x": 0.0})
    wave = lambda x, t: (0.5 * ufl.sin(ufl.pi * x[0]), ufl.cos(ufl.pi * x[0]), 0.1)
    thick, thin = errors(Structure(joint, **setup | {"tractions": {"TOP": wave}}), (1 / 32, 1 / 64), cells_through=1)
    for quantity in ("error_traction", "error_jump"):
        assert thin[quantity] < 0.6 * thick[quantity]


def norm(p: fem.Function) -> float:
    return float(np.sqrt(fem.assemble_scalar(fem.form(p**2 * ufl.dx))))


# ---------------------------------------------------------------- multiplier and traction
@pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")  # of the free ends
@pytest.mark.parametrize("cell", CELLS)
def test_traction_is_the_multiplier(cell):
    """On S: t_N = p, both tested with the same functions of degree 1; t_T = mu [u_T], projected to degree 1."""
    joint, setup = fourier(1 / 8, cell=cell)
    setup["supports"] = {"BOTTOM": 0.0}  # no component of the traction on S is held
    state = solve(Structure(joint, **setup).interface(ThinLayer(LAW, 0.1, at=1.0)))
    surface = Surface(state.model)
    x, t = surface.profile(surface.traction(state))
    places = state.p.function_space.tabulate_dof_coordinates()[:, 0]
    p = state.p.x.array[np.argsort(places)]
    assert x[:, 0] == pytest.approx(np.sort(places), abs=1e-12)
    assert t[:, 1] == pytest.approx(p, abs=1e-10 * np.abs(p).max())
    sheared = surface.profile(MU * surface.jump(state))[1][:, 0]
    assert t[:, 0] == pytest.approx(sheared, abs=1e-10 * np.abs(sheared).max())


def exact(eps: float | None) -> np.ndarray:
    """Amplitudes of jump and traction of the Fourier problem, lmbda = STIFF standing for an infinite one."""
    return reference.marched([(1.0, lambda d: (STIFF, MU))], [0.0, 1.0], 1.0, eps=eps)[1]


@pytest.mark.parametrize("cell", CELLS)
def test_fourier_problem(cell):
    """Errors of both models against transfer matrices; the pressure on S is the traction's normal part, p = T cos(pi x)."""
    joint, setup = fourier(1 / 16, cell=cell)
    eps = 1 / 32
    states = [solve(build(Structure(joint, **setup), ThinLayer(LAW, eps, at=1.0))) for build in BUILDS]
    row = compare(*states)
    full, limit = exact(eps), exact(None)
    expected = [np.linalg.norm((full - limit)[part]) / np.linalg.norm(limit[part]) for part in (slice(2, 4), slice(2))]
    assert (row["error_traction"], row["error_jump"]) == pytest.approx(expected, rel=1e-2)
    p = states[1].p
    x = ufl.SpatialCoordinate(p.function_space.mesh)[0]
    assert fem.assemble_scalar(fem.form((p - limit[3] * ufl.cos(ufl.pi * x)) ** 2 * ufl.dx)) ** 0.5 < 2e-3 * norm(p)


@pytest.mark.parametrize("theta", [1.0, 0.5])
def test_pressure_at_the_end_of_a_step(theta):
    """With a growing load the pressure of a state is that of its time, as its displacements are."""
    joint, setup = fourier(1 / 8, cell="quadrilateral")
    setup["tractions"] = {"TOP": lambda x, t: (0.0, t * ufl.cos(ufl.pi * x[0]))}
    model = Structure(joint, **setup).interface(ThinLayer(LAW, 0.05, at=1.0))
    state = march(model, [0.5, 1.0], theta=theta).last
    alone = solve(model, t=1.0, method="newton")
    assert np.abs(state.u.x.array - alone.u.x.array).max() < 1e-9 * np.abs(alone.u.x.array).max()
    assert np.abs(state.p.x.array - alone.p.x.array).max() < 1e-8 * np.abs(alone.p.x.array).max()


# ---------------------------------------------------------------- stability
def schur(model: Model, degree: int) -> np.ndarray:
    """G K^-1 G^T with displacements of a degree: the square of a pressure's norm sup_v (int q tr e(v))^2/a(v, v)."""
    V = model.V if degree == 2 else model.space(degree)
    fine = lambda p: replace(p, measure=p.measure.reconstruct(metadata={"quadrature_degree": 2 * degree + 1}))
    part = PressurePart(V, fine(model.layer_terms[0]), stiffness=1.0)
    stiffness = work([fine(p) for p in model.terms], ufl.TrialFunction(V), ufl.TestFunction(V))
    K = dolfinx.fem.petsc.assemble_matrix(fem.form(stiffness))
    K.assemble()
    free = np.setdiff1d(np.arange(K.getSize()[0]), model.supports.bc_dofs_in(V))
    G = sparse(part.G)[:, free] / part.unit
    return G @ splu(sparse(K)[free][:, free].tocsc()).solve(G.T.toarray())


@pytest.mark.parametrize(("cell", "bound"), [("triangle", 0.45), ("quadrilateral", 0.75)])
@pytest.mark.parametrize("ends", ["rollers", "clamped", "free"])
def test_inf_sup_constant(cell, bound, ends):
    """beta = inf_q sup_{v in V_2}/sup_{v in V_4}: displacements of degree 4 stand for all displacements.

    Norms of their own: in L2 the constant of the continuous problem itself depends on h and eps.
    """
    end_supports = {"rollers": {"x": 0.0}, "clamped": 0.0}
    supports = {"BOTTOM": 0.0} | ({} if ends == "free" else dict.fromkeys(("LEFT", "RIGHT"), end_supports[ends]))
    for h, eps in ((1 / 4, 1e-1), (1 / 4, 1e-4), (1 / 16, 1e-1), (1 / 16, 1e-4)):
        joint = sandwich(1.0, 0.5, 0.5, h, cell=cell, structured=True)
        structure, layer = Structure(joint, body=FOURIER_BODY, supports=supports), ThinLayer(LAW, eps, at=1.0)
        for model in (structure.full(layer, cells_through=2), structure.interface(layer)):
            beta = scipy.linalg.eigh(schur(model, 2), schur(model, 4), eigvals_only=True)[0] ** 0.5
            assert bound < beta <= 1 + 1e-6, (model.name, h, eps)


@pytest.mark.few(1)
@pytest.mark.parametrize("cell", CELLS)
def test_s_with_too_few_cells(cell):
    """One cell between two ends where nothing jumps: a single normal jump for two pressures, refused, not wrong."""
    joint = sandwich(1.0, 1.0, 1.0, 1.0, cell=cell, structured=True)
    with pytest.raises(SolveError):
        solve(Structure(joint, **pressed(joint, LEFT=0.0, RIGHT=0.0)).interface(ThinLayer(LAW, 0.01, at=1.0)))


# ---------------------------------------------------------------- refused


def test_beside_bodies_that_are_not_linear():
    """Bodies whose laws are next to linear, in forms and at points, give what linear ones give."""
    joint, layer = sandwich(1.0, 0.5, 0.5, 0.25, structured=True), ThinLayer(Incompressible(30.0), 0.1, at=1.0)
    data = dict(supports={"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}, tractions={"TOP": (0.3, 1.0)})
    elastic, stiffening = LinearElastic(0.0, 60.0), Stiffening(0.0, 60.0, 1e-6)
    bodies = elastic, stiffening, VonMises(0.0, 60.0, strength=1e3)
    energies = [solve(Structure(joint, body=body, **data).interface(layer)).energies() for body in bodies]
    assert energies[1]["layer"] == pytest.approx(energies[0]["layer"], rel=1e-6)
    assert energies[2] == pytest.approx(energies[0], rel=1e-6)
