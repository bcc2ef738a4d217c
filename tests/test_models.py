"""Every option changes the answer it should and only that; what cannot be built says why."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import meshtags
from petsc4py import PETSc

from forms import LinearElastic
from forms.base import InputError
from forms.work import work
from geometry import sandwich
from geometry.seam import Seam
from tests.own_laws import Cubic
from tests.refused import refused
from thinlayer import SolveError, Structure, Surface, ThinLayer, piecewise, solve
from thinlayer.errors import RangeWarning
from thinlayer.output.nodal_forces import nodal_forces

pytestmark = pytest.mark.few(5)

JOINT = sandwich(1.0, 0.5, 0.7, 0.25)
BODY = LinearElastic.young(100.0, 0.3)
GLUE = LinearElastic(lmbda=15.0, mu=7.0)
LAYER = ThinLayer(GLUE, 0.05, at=1.0)
SETUP = {"body": BODY, "supports": {"BOTTOM": 0.0}, "tractions": {"TOP": (0.4, -0.9)}}


def structure(**change):
    return Structure(JOINT, **SETUP | change)


def test_coordinates_of_loads_belong_to_the_bodies():
    """In kept geometry the meshed layer moves the bodies apart; loads stay on the same material points."""
    load = {"TOP": lambda x, t: (0.0, x[1] * x[0]), "RIGHT": lambda x, t: (ufl.exp(x[1]), 0.0)}
    states = [solve(build(structure(tractions=load), LAYER)) for build in (Structure.full, Structure.interface)]
    work = [s.integral(s.model.external_work(ufl.as_vector([1.0, 2.0]), s.t)) for s in states]
    exact = (np.exp(0.7) - np.exp(-0.5)) + 2 * 0.7 * 0.5
    assert work == pytest.approx([exact, exact], rel=1e-6)  # quadrature of exp


def test_point_support_holds_both_sides_of_s():
    model = structure(**{"supports": {"BOTTOM": 0.0, (0.0, 0.0): {"x": 0.0}}}).interface(LAYER)
    state = solve(model)
    at = np.flatnonzero(np.all(np.abs(model.V.tabulate_dof_coordinates()[:, :2]) < 1e-12, axis=1))
    values = state.u.x.array.reshape(-1, 2)[at]
    assert len(at) == 2
    assert np.abs(values[:, 0]).max() == 0
    assert np.abs(values[:, 1]).min() > 0


def test_newton_on_a_users_law():
    """Uniform opening w of a hardening layer: 2 k w + c w^3 = pull, in both models, with quadratic convergence."""
    k, c, pull = 5.0, 4e5, 0.6
    rollers = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    pulled, layer = structure(supports=rollers, tractions={"TOP": (0.0, pull)}), ThinLayer(Cubic(k, c), 0.2, at=1.0)
    opening = np.roots([c, 0.0, 2 * k, -pull])
    opening = float(opening[np.abs(opening.imag) < 1e-12].real[0])
    limit = solve(pulled.interface(layer))
    surface = Surface(limit.model)
    for state in (limit, solve(pulled.full(layer))):
        assert surface.integral(surface.jump(state)[1]) == pytest.approx(opening, rel=1e-9)
        assert state.report.method == "newton"
        assert 3 <= state.report.iterations <= 12


def test_petsc_options():
    model = structure().interface(LAYER)
    direct = solve(model)
    iterative = solve(model, options={"ksp_type": "cg", "pc_type": "gamg", "ksp_rtol": 1e-12})
    assert iterative.report.iterations > 3
    assert np.abs(direct.u.x.array - iterative.u.x.array).max() < 1e-8 * np.abs(direct.u.x.array).max()
    refused(InputError, "-thinlayer_ksp_rtoll", lambda: solve(model, options={"ksp_rtoll": 1e-3}))
    for options in ({"pc_type": "nosuch"}, {"pc_type": "ilu"}, {3: 1}):
        refused(InputError, "PETSc does not take the value of|it must be", solve, model, options=options)
    PETSc.Options().setValue("thinlayer_snes_max_it", 7)
    try:
        refused(InputError, "linear solver: -thinlayer_snes_max_it", lambda: solve(model))
    finally:
        PETSc.Options().delValue("thinlayer_snes_max_it")


def test_failed_solves_say_why():
    model = structure().interface(LAYER)
    with pytest.raises(SolveError, match=r"DIVERGED_MAX_IT.*relative residual"):
        solve(model, options={"ksp_type": "cg", "pc_type": "jacobi", "ksp_max_it": 2})
    hard = structure().interface(ThinLayer(Cubic(5.0, 4e9), 0.1, at=1.0))
    refused(SolveError, r"failed after \d steps: DIVERGED.*residual.*try", solve, hard, options={"snes_max_it": 2})
    refused(ValueError, "linear, newton", lambda: solve(model, method="simplex"))


def test_models_that_cannot_be_built():
    for change, message in [
        (dict(supports={"BOTOM": 0.0}), "did you mean 'BOTTOM'.*known.*TOP"),
        (dict(supports={"BOTTOM": {"z": 0.0}}), "unknown component 'z'; known: n, x, y"),
        (dict(supports={"BOTTOM": {"x": float("nan")}}), "it needs a finite number"),
        (dict(supports={}), "no support against rigid motion"),
        (dict(supports={(0.0, -0.5): 0.0}), "rigid motion of the structure .rotation"),
        (dict(supports={(0.1, -0.5): 0.0}), "the nearest is"),
        (dict(supports={(0.0, -0.5, 0.0): 0.0}), "is not a place; give 2 coordinates"),
        (dict(supports={"S": 0.0}), "below a layer"),
        (dict(supports={"BOTTOM/UPPER": 0.0}), "empty"),
        (dict(tractions={"TOP": (1.0, 2.0, 3.0)}), "needs 2 finite components"),
        (dict(tractions={"TOP": lambda x, t: (np.sin(x[0]), 0.0)}), "use ufl.sin"),
        (dict(tractions={"UP": (1.0, 2.0)}), "unknown facet set 'UP'"),
        (dict(body_force={"MIDDLE": (0.0, 1.0)}), "unknown body 'MIDDLE'"),
        (dict(body={"LOWER": BODY}), "body 'UPPER' has no law"),
        (dict(plane="stres"), "did you mean 'stress'"),
        (dict(element="Q2"), "does not exist on triangle cells; allowed: P1, P2"),
        (dict(layer=GLUE), r"give ThinLayer\(law, eps\)"),
    ]:
        layer = change.pop("layer", LAYER)
        refused(InputError, message, lambda change=change, layer=layer: solve(structure(**change).interface(layer)))


# ---------------------------------------------------------------- terms of one's own
def test_a_term_beside_those_of_a_model():
    """At the equilibrium of a model the forces that are added alone are left, by the model's measures and by plain ones."""
    model = structure(supports={"BOTTOM": 0.0, "LEFT": {"x": 0.0}}).interface(LAYER)
    u, v = solve(model).u, ufl.TestFunction(model.V)
    x = ufl.SpatialCoordinate(model.domain.mesh)
    residual = work(model.terms, u, v) - model.external_work(v, 0.0)
    free = np.setdiff1d(np.arange(len(u.x.array)), model.constraints.bc_dofs)
    f, w = ufl.as_vector([x[0], 2.0]), model.sides.jump(v)
    for term, alone in (
        (ufl.inner(f, v) * model.dx, ufl.inner(f, v) * ufl.dx),
        (ufl.inner(f, v) * model.ds, ufl.inner(f, v) * ufl.ds),
        (ufl.inner(f, w) * model.dS, ufl.inner(f, w) * model.dS),
    ):
        expected = fem.assemble_vector(fem.form(alone)).array
        for form in (fem.form(residual + term), model.form(residual + term), model.form(residual + alone)):
            forces = fem.assemble_vector(form).array
            assert forces[free] == pytest.approx(expected[free], abs=1e-12 * np.abs(expected).max() + 1e-13)
    everywhere = ufl.inner(ufl.jump(u), ufl.jump(u))
    assert solve(model).integral(everywhere * ufl.dS) == pytest.approx(solve(model).integral(everywhere * model.dS(1)))
    tags = meshtags(model.domain.mesh, 2, np.arange(3, dtype=np.int32), np.array([4, 5, 4], np.int32))
    term = ufl.inner(f, v) * ufl.dx(4, subdomain_data=tags)  # tags of another kind than the model's
    expected = fem.assemble_vector(fem.form(term)).array
    forces = fem.assemble_vector(model.form(residual + term + ufl.inner(f, v) * model.dx + term)).array
    forces -= fem.assemble_vector(fem.form(ufl.inner(f, v) * ufl.dx)).array
    assert np.linalg.norm(expected) > 0.01
    assert forces[free] == pytest.approx(2 * expected[free], abs=1e-12)


def test_a_structure_is_shown_in_a_line():
    assert repr(structure(supports={"TOP": 0})).startswith("Structure(Joint(")
    assert repr(structure(supports={"TOP": 0})).endswith(", strain, supports ['TOP'])")


def test_forms_whose_tags_overlap():
    """Forces of bodies and of their weight, on quadrilaterals, and integrals of several degrees over some of the tags."""
    joint = sandwich(1.0, 0.5, 0.7, 0.25, cell="quadrilateral")
    model = Structure(joint, **SETUP, body_force={"LOWER": (0.3, -1.1)}, element="Q2").interface(LAYER)
    u, v = solve(model).u, ufl.TestFunction(model.V)
    free = np.setdiff1d(np.arange(len(u.x.array)), model.constraints.bc_dofs)
    forces = lambda form: fem.assemble_vector(form).array
    residual = work(model.terms, u, v) - model.external_work(v, 0.0)
    loads = forces(model.form(model.external_work(v, 0.0)))
    assert forces(model.form(residual))[free] == pytest.approx(0 * free, abs=1e-11 * np.abs(loads).max())

    x, (low, high) = ufl.SpatialCoordinate(model.domain.mesh), model.domain.region_tags("LOWER", "UPPER")
    several = [
        x[0] * v[0] * model.dx((low, high), metadata={"quadrature_degree": 4}),
        x[1] ** 4 * v[1] * model.dx(high),
        2.0 * v[0] * model.dx(low, metadata={"quadrature_degree": 2}),
        v[1] * ufl.dx,
    ]
    expected = sum(forces(model.form(integral)) for integral in several)
    assert forces(model.form(sum(several))) == pytest.approx(expected, rel=1e-12, abs=1e-14)


def test_a_form_keeps_the_time_it_was_taken_at():
    """Of a load with a table, one that moves along the body, and one that is asked for another time."""
    table = piecewise({0: (0.0, 1.0), 1: (2.0, 1.0), 3: (2.0, 5.0)})
    pull = lambda x, t: [ufl.sin(t * x[0]) * a + b for a, b in zip(table(x, t), table(x, t / 2), strict=True)]
    model = structure(tractions={"TOP": pull}, supports={"BOTTOM": {"x": 0.0, "y": lambda x, t: t * x[0]}}).full(LAYER)
    times, v = (0.5, 2.0), ufl.as_vector([1.0, -3.0])
    compiled = [model.form(model.external_work(v, t)) for t in times]
    assert compiled[0].module.__file__ == compiled[1].module.__file__  # for all times one
    solve(model, 1.0)
    s = np.linspace(0, 1, 10001)
    for t, form in zip(times, compiled, strict=True):
        now, half = ([np.interp(at, [0, 1, 3], values) for values in ((0, 2, 2), (1, 1, 5))] for at in (t, t / 2))
        expected = np.trapezoid(np.sin(t * s), s) * (now[0] - 3 * now[1]) + half[0] - 3 * half[1]
        assert fem.assemble_scalar(form) == pytest.approx(expected, rel=1e-4)
    first, last = model.constraints.bc_values(0.5), model.constraints.bc_values(2.0)
    assert (first.max(), last.max()) == pytest.approx((0.5, 2.0))


# ---------------------------------------------------------------- loads on sides
def total(model):
    """Sum of the nodal forces of its loads, (d,)."""
    forces = nodal_forces(model.V, model.external_work(ufl.TestFunction(model.V), t=0.0))
    owned = model.V.dofmap.index_map.size_local * model.joint.dim
    return forces.x.array[:owned].reshape(-1, model.joint.dim).sum(axis=0)


@pytest.mark.parametrize(("name", "depth"), [("LEFT", None), ("LEFT/LOWER", 0.6)])
def test_a_load_on_a_side_is_the_same_in_all_models(name, depth):
    """Where the bodies gave up room, the layer carries what acted there, but for a load of its own."""
    joint = sandwich(1.0, 0.2, 0.5, 0.5, depth=depth)
    load, area = np.array([0.7, -0.2, 0.4])[: joint.dim], depth or 1.0
    data, layer = {"body": BODY, "supports": {"BOTTOM": 0.0}}, ThinLayer(GLUE, 0.1, at=1.0)
    height = {"LEFT": 0.7, "LEFT/LOWER": 0.2}[name]
    loaded = Structure(joint, tractions={name: load}, **data)
    for model in (loaded.interface(layer), loaded.full(layer), loaded.full(layer, bodies="extended")):
        assert total(model) == pytest.approx(load * height * area, rel=1e-10)
    alone = Structure(joint, tractions={name: load, "LEFT/LAYER": 3 * load}, **data).full(layer, bodies="extended")
    given_up = 0.1 if name == "LEFT" else 0.05
    assert total(alone) == pytest.approx(load * (height - given_up + 3 * 0.1) * area, rel=1e-10)


def test_a_load_that_the_layer_cannot_share():
    """Two bodies end at the same named side of the layer, and one of them is loaded."""
    joint = sandwich(1.0, 0.5, 0.5, 0.25)
    far = (joint.points[joint.corners].mean(axis=1)[:, 0] > 0.5) & (joint.region == joint.regions.index("UPPER"))
    sides = np.concatenate([joint.facets["LEFT"], joint.facets["RIGHT"]])
    parts = {"regions": (*joint.regions, "END"), "region": np.where(far, 2, joint.region)}
    seams = {"S": Seam(("LOWER",), ("UPPER", "END"))}
    joint = replace(joint, facets={**joint.facets, "SIDES": sides}, seams=seams, **parts)
    loaded = Structure(joint, body=BODY, supports={"BOTTOM": 0.0}, tractions={"SIDES/END": (1.0, 0.0)})
    with pytest.warns(RangeWarning, match=r"'SIDES/END': other bodies than 'END'.*Load 'SIDES', or 'SIDES/LAYER'"):
        loaded.full(ThinLayer(GLUE, 0.1, at=1.0), bodies="extended")
