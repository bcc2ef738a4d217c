"""Every state that a solver returns is an equilibrium, found at any scale of the forces, and the only one."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse
from mpi4py import MPI
from petsc4py import PETSc

from forms import Anisotropic, HolonomicCoulomb, LinearElastic, MohrCoulomb, NonMonotone
from geometry import sandwich
from tests.refused import refused
from thinlayer import SolveError, Structure, Surface, ThinLayer, march, solve
from thinlayer.discretisation.constraints import local_csr
from thinlayer.parts.part import Block
from thinlayer.solving import newton
from thinlayer.solving.contact.contact_solver import ContactSolver
from thinlayer.solving.equations import Equations
from thinlayer.solving.newton import NewtonSolver
from thinlayer.solving.part_sum import augmented_in_place

STEEL = LinearElastic.young(E=210e3, nu=0.3)
PLATES = sandwich(40, 4, 6, h=2.0)
HELD = {"BOTTOM": 0}


def mean_jump(model, state):
    surface = Surface(model)
    w = surface.frame(surface.jump(state))
    return np.array([surface.integral(w[k]) for k in range(len(w))]) / surface.integral(1)


# ---------------------------------------------------------------------------------- scales of the forces
def flat(scale):
    """A layer that snaps in a relaxed way; homogeneous: stresses, and so jumps, go with the scale."""
    return NonMonotone(4e3, 1e3, 30.0 * scale, 0.22 * scale**2, [[0.2, 0.5], [0.5, 1.0]])


@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_flat_laws_at_any_scale(scale):
    """Loads and stresses times a number: so are the jumps."""

    def scaled_jump(s):
        loads = {"TOP": (6 * s, -30 * s), "LEFT/UPPER": (-60 * s, 5 * s)}
        model = Structure(PLATES, body=STEEL, supports=HELD, tractions=loads).interface(ThinLayer(flat(s), 0.4, at=1.0))
        return mean_jump(model, solve(model)) / s

    assert scaled_jump(scale) == pytest.approx(scaled_jump(1.0), rel=1e-9)


def test_a_soft_flat_layer_between_stiff_plates():
    """Plates on displacements, layer 1e11 times softer: residuals hide in the rounding of the plates' forces.

    Rigid plates would give the layer's own answer; rounding leaves 1e-3 of it.
    """
    joint = sandwich(10, 4, 4, h=1.0, structured=True)

    def force(soft):
        law = NonMonotone(0.0, 10.0 * soft, 15.0 * soft, 15.0 * soft, [[0, 0], [0, 1]])
        top = {"y": lambda x, t: 1.2 * (1 + 0.05 * x[0]), "x": 0}
        body = LinearElastic.young(E=2e5, nu=0.0)
        model = Structure(joint, body=body, supports={"BOTTOM": 0, "TOP": top}).interface(ThinLayer(law, 1.0))
        surface, state = Surface(model), solve(model)
        return surface.integral(surface.traction(state)[1]) / soft

    assert force(1e-7) == pytest.approx(force(1e-3), rel=3e-3)


# ---------------------------------------------------------------------------------- whoever says so
def yielding():
    law = MohrCoulomb(120.0, 80.0, cohesion=0.2, friction_angle=35)
    body, supports = LinearElastic.young(E=20e3, nu=0.2), {"BOTTOM": 0, "TOP": {"y": -0.02}}
    return Structure(PLATES, body=body, supports=supports, tractions={"TOP": (0.9, 0)}).interface(ThinLayer(law, 1.0))


def contact():
    law = HolonomicCoulomb(K_N=3e3, K_T=1e3, friction=0.4)
    supports = {"BOTTOM": 0, "RIGHT": {"x": 0}}
    loads = {"TOP": (0.3, -2.0), "LEFT/UPPER": (1.0, 0.0)}
    return Structure(PLATES, body=STEEL, supports=supports, tractions=loads, element="P1").interface(law)


def linear():
    law = LinearElastic.young(E=2e3, nu=0.4).scaled(1 / 0.2)
    loads = {"TOP": (6.0, -30.0)}
    return Structure(PLATES, body=STEEL, supports=HELD, tractions=loads).interface(ThinLayer(law, 0.2, at=1.0))


WEAK = [("snes_rtol", 0.9), ("snes_atol", 1e3), ("snes_stol", 1.0), ("snes_max_it", 1), ("snes_type", "ksponly")]


@pytest.mark.parametrize("option", WEAK)
def test_options_do_not_weaken_the_check(option):
    """An option that ends Newton's method early leads to an error, or to the same state."""
    for make, method in ((yielding, None), (contact, "newton")):
        try:
            state = solve(make(), options=dict([option]), method=method)
        except (SolveError, ValueError):
            continue
        exact = solve(make(), method=method)
        assert np.abs(state.u.x.array - exact.u.x.array).max() <= 1e-5 * np.abs(exact.u.x.array).max()


@pytest.mark.parametrize("solver", ["linear", "newton", "condensed", "multigrid", "relaxation", "contact newton"])
def test_a_solver_that_lies_is_found_out(solver, monkeypatch):
    """Whoever finds the unknowns: a thousandth more of them is no equilibrium."""
    for finder in (NewtonSolver, ContactSolver):

        def find(self, *args, real=finder.solve_step):
            solution = real(self, *args)
            solution.x.scale(1.001)
            return solution

        monkeypatch.setattr(finder, "solve_step", find)
    model = linear() if solver == "linear" else yielding() if solver == "newton" else contact()
    refused(SolveError, "not an equilibrium", lambda: solve(model, method=solver.removeprefix("contact ")))


# ---------------------------------------------------------------------------------- the only one
SLIDES = ThinLayer(Anisotropic(np.diag([0, 1e3, 0, 0, 0, 0.0]), "layer"), 0.1, at=1.0)


def loaded(layer, joint=PLATES, supports=HELD, **more):
    d = joint.dim
    return Structure(joint, body=STEEL, supports=supports, tractions={"TOP": (0, -1.0, 0)[:d]}, **more).interface(layer)


@pytest.mark.parametrize("angle", [0.0, 0.5])
def test_a_layer_without_tangential_stiffness(angle):
    """Nothing tells how far the upper plate has slid, whatever the mesh's place; held, its compression is p/K_N."""
    joint = sandwich(10, 4, 4, h=2.0, structured=True)
    joint = joint.rotated(angle) if angle else joint
    refused(SolveError, r"no unique solution: body 'UPPER' can move along", lambda: solve(loaded(SLIDES, joint)))
    if not angle:
        free = loaded(HolonomicCoulomb(K_N=1e3, K_T=500, friction=0.0), element="P1")  # mesh of PLATES
        refused(SolveError, "no unique solution: body 'UPPER' can move along", lambda: solve(free))
        model = loaded(SLIDES, joint, {"BOTTOM": 0, "TOP": {"x": 0}})
        assert mean_jump(model, solve(model)) == pytest.approx([0, -1e-3], rel=1e-9, abs=1e-6)


def test_a_meshed_layer_that_hardly_resists():
    """Loads that do not push it leave its slip to rounding, which the second solve of the refinement shows."""

    def made(K_T):
        layer = ThinLayer(Anisotropic.springs(1e3, K_T), 0.1, at=1.0)
        return Structure(PLATES, body=STEEL, supports=HELD, tractions={"TOP": (0, -1.0)}).full(layer)

    refused(SolveError, "no unique solution: rounding of the forces changes the displacements", solve, made(1e-11))
    slip = solve(made(1e-3)).u.x.array.reshape(-1, 2)[:, 0]
    assert abs(slip.mean()) < 1e-3 * np.abs(slip).max()


def test_a_step_whose_pivots_show_that_nothing_can_move_is_solved_once(monkeypatch):
    solve_linear, seen = newton.solve_linear, []
    monkeypatch.setattr(newton, "solve_linear", lambda *these: (seen.append(1), solve_linear(*these)))
    solve(linear())
    assert len(seen) == 1


def test_an_error_of_petsc_keeps_the_march(monkeypatch):
    solve_linear, seen = newton.solve_linear, []

    def breaks_down(ksp, b, x):
        seen.append(1)
        if len(seen) > 2:
            raise PETSc.Error(76)
        return solve_linear(ksp, b, x)

    monkeypatch.setattr(newton, "solve_linear", breaks_down)
    assert list(refused(SolveError, r"error 76", march, linear(), [1.0, 2.0, 3.0]).history.t) == [0.0, 1.0]


# ---------------------------------------------------------------------------------- one matrix
@pytest.mark.parametrize("places", [0.0, 1.0])
def test_a_lent_matrix_is_the_sum_with_supports_and_afterwards_what_it_was(places):
    """The other block has entries in the pattern, or outside; one held row has a neighbour that no other change touches."""

    def matrix(dense, also=0.0):
        csr = scipy.sparse.csr_matrix((dense != 0) + also)
        csr.data = dense[csr.nonzero()]
        return PETSc.Mat().createAIJ(dense.shape, csr=(csr.indptr, csr.indices, csr.data), comm=PETSc.COMM_SELF)

    chain = np.diag(np.sqrt(np.arange(2.0, 9.0))) - 0.3 * np.eye(7, k=1) - 0.7 * np.eye(7, k=-1)
    spring, bc_dofs = np.zeros((7, 7)), np.array([0, 4], PETSc.IntType)
    spring[np.ix_([1, 6], [1, 6])] = [[3.0, -1 / 3], [-1 / 3, 2.0]]
    K, whole = matrix(chain, places * spring), chain + 0.1 * spring
    whole[bc_dofs], whole[:, bc_dofs], whole[bc_dofs, bc_dofs] = 0.0, 0.0, 5.0
    with augmented_in_place(MPI.COMM_SELF, K, [Block(matrix(spring), 0.1)], bc_dofs, 5.0) as A:
        np.testing.assert_allclose(A[:, :], whole, rtol=1e-15)
    assert np.array_equal(K[:, :], chain)


def test_the_matrix_of_the_bodies_has_places_for_laws_on_S():
    model = Structure(PLATES, body=STEEL, supports=HELD).interface(ThinLayer(LinearElastic(6.0, 4.0), 0.4, at=1.0))
    equations = Equations(model)
    body, law = (local_csr(part.K) for part in (*equations.bodies, *equations.layers))
    body.data[:] = law.data[:] = 1.0
    assert law.multiply(body).nnz == law.nnz > 0
