"""Eigenstrains of bodies: free and confined expansion, in-situ stress, energies in time, contact, cells; refusals."""

from dataclasses import replace

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import create_rectangle
from mpi4py import MPI

from forms import Anisotropic, HolonomicCoulomb, Incompressible, LinearElastic, Maxwell, Rubber, Stack, VonMises
from forms.base import InputError
from forms.work import stress
from geometry import block, periodic, sandwich
from tests.own_laws import Stiffening
from tests.refused import refused
from thinlayer import (
    Prestress,
    Structure,
    Surface,
    ThermalExpansion,
    ThinLayer,
    march,
    piecewise,
    solve,
)

pytestmark = pytest.mark.few(5)

LAW = LinearElastic.young(30.0, 0.3)
GLUE, CREEPING = LinearElastic(7.0, 5.0), Maxwell(7.0, 5.0, t1=0.7, t2=0.9)
SHEARED = ((2e-3, 1e-3), (1e-3, -3e-3))  # neither a unit nor symmetric about an axis
FLAT, SOLID = sandwich(2.0, 0.5, 0.75, 0.5), sandwich(1.0, 0.4, 0.6, 0.5, depth=0.5)
SIDES = ("LEFT", "RIGHT"), ("BOTTOM", "TOP")
AT_REST = {(0.0, -0.5): 0.0, (2.0, -0.5): {"y": 0.0}}
AT_REST_3D = {(0.0, -0.4, 0.0): 0.0, (1.0, -0.4, 0.0): {"y": 0.0, "z": 0.0}, (0.0, -0.4, 0.5): {"y": 0.0}}
ROLLERS = {"BOTTOM": {"y": 0.0}, "TOP": {"y": 0.0}, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}


def largest_stress(state):
    """Root mean square of the in-plane stresses of bodies."""
    d, volume = state.model.joint.dim, 0.0
    for p in state.bodies:
        s = stress(p, state.u)
        inside = ufl.as_matrix([[s[i, j] for j in range(d)] for i in range(d)])
        volume += state.integral(ufl.inner(inside, inside) * p.measure)
    return np.sqrt(volume)


# ---------------------------------------------------------------- free expansion
@pytest.mark.parametrize("law", [LAW, Stiffening(20.0, 10.0, 100.0)], ids=["linear", "hardening"])
def test_bodies_that_expand_freely_have_no_stress(law):
    """Any uniform strain, and a temperature that is linear in place, are strains of displacements."""
    hot = ThermalExpansion(2e-3, lambda x, t: 1 + 3 * x[0] - x[1] + 2 * x[2])
    state = solve(Structure(SOLID, body=law, supports=AT_REST_3D, eigenstrain=hot).bonded())
    confined = 2e-3 * 3 * LAW.lmbda
    assert largest_stress(state) < 1e-11 * confined
    assert state.energies()["bodies"] < 1e-20 * confined
    bent = ThermalExpansion(2e-3, lambda x, t: x[0] ** 2)
    assert largest_stress(solve(Structure(SOLID, body=law, supports=AT_REST_3D, eigenstrain=bent).bonded())) > 1e-3


def test_a_strip_in_plane_strain_is_stressed_across_the_plane_alone():
    state = solve(Structure(FLAT, body=LAW, supports=AT_REST, eigenstrain=4e-3).bonded())
    assert largest_stress(state) < 1e-12
    assert state.energies()["bodies"] == pytest.approx(30.0 * 4e-3**2 / 2 * 2.5, rel=1e-12)  # E e^2/2 of s_33 = -E e
    x = np.array([[2.0], [0.75]])
    corner = (1 + 0.3) * 4e-3 * (x - np.array([[0.0], [-0.5]]))
    top = np.abs(state.model.V.tabulate_dof_coordinates()[:, :2].T - x).sum(axis=0).argmin()
    assert state.u.x.array.reshape(-1, 2)[top] == pytest.approx(corner.ravel(), rel=1e-12)
    flat = solve(Structure(FLAT, body=LAW, supports=AT_REST, eigenstrain=SHEARED, plane="stress").bonded())
    assert largest_stress(flat) + flat.energies()["bodies"] < 1e-12


def test_a_hollow_cylinder_expands_freely():
    """Its radii and its height grow by the expansion; unequal expansion of hoops alone is no strain of displacements."""
    tube = replace(FLAT, points=np.add(FLAT.points, (1.0, 0.0)))
    data = {"body": LAW, "supports": {(1.0, -0.5): {"y": 0.0}}, "plane": "axisymmetric"}
    state = solve(Structure(tube, eigenstrain=4e-3, **data).bonded())
    assert state.energies()["bodies"] < 1e-20
    assert state.u.x.array[::2] == pytest.approx(4e-3 * state.model.V.tabulate_dof_coordinates()[:, 0], rel=1e-10)
    assert solve(Structure(tube, eigenstrain=np.diag([0.0, 0.0, 4e-3]), **data).bonded()).energies()["bodies"] > 1e-5


@pytest.mark.few(5)
@pytest.mark.parametrize("plane", ["strain", "stress", "axisymmetric"])
def test_bodies_that_yield_know_the_strain_less_the_eigenstrain(plane):
    """As a linear one below their strength, also what is across the plane; beyond it they carry no more."""
    tube = replace(FLAT, points=np.add(FLAT.points, (1.0, 0.0)))
    hot = ThermalExpansion((1e-3, 2e-3, 4e-3), lambda x, t: t * (1 + x[0]))
    energies = {}
    yields = [VonMises(LAW.lmbda, LAW.mu, **args) for args in ({"strength": 9.0}, {"strength": 0.04, "hardening": 1.0})]
    for law in (LAW, *yields):
        data = {"body": law, "supports": {"BOTTOM": 0.0, "TOP": {"x": 0.01}}, "plane": plane, "eigenstrain": hot}
        state = march(Structure(tube, **data).bonded(), [0.5, 1.0]).last
        assert abs(state.audit.imbalance) < 1e-8
        energies[law] = state.energies()["bodies"]
    linear, strong, weak = energies.values()
    projected = plane == "axisymmetric"  # volume strains of VonMises, see `Term.bbar_degree`
    assert strong == pytest.approx(linear, rel=1e-4 if projected else 1e-8)
    assert weak < 0.7 * linear


# ---------------------------------------------------------------- confined
def confined(plane="strain", law=LAW, **data):
    return solve(Structure(FLAT, body=law, supports=ROLLERS, plane=plane, **data).bonded()).mean_stress()


def test_bodies_between_rollers_are_stressed_by_their_expansion():
    lmbda, mu = LAW.lmbda, LAW.mu
    assert confined(eigenstrain=4e-3) == pytest.approx(-(3 * lmbda + 2 * mu) * 4e-3 * np.eye(2), rel=1e-12, abs=1e-12)
    assert confined("stress", eigenstrain=4e-3) == pytest.approx(-30 / 0.7 * 4e-3 * np.eye(2), rel=1e-12, abs=1e-12)
    e = np.diag([2e-3, -3e-3])
    assert confined(eigenstrain=e) == pytest.approx(-lmbda * e.trace() * np.eye(2) - 2 * mu * e, rel=1e-12, abs=1e-12)
    out = confined(eigenstrain=np.diag([0.0, 0.0, 5e-3]))  # across the plane: free in plane stress
    assert out == pytest.approx(-lmbda * 5e-3 * np.eye(2), rel=1e-12, abs=1e-12)
    assert np.abs(confined("stress", eigenstrain=np.diag([0.0, 0.0, 5e-3]))).max() == 0.0


def test_eigenstrains_add_up_and_forms_of_input_agree():
    hot = ThermalExpansion((1e-3, 2e-3, 3e-3), T=2.0)
    summed = confined(eigenstrain=[hot, 1e-3, lambda x, t: np.diag([0.0, 0.0, -6e-3])])
    assert summed == pytest.approx(confined(eigenstrain=np.diag([3e-3, 5e-3, 1e-3])), rel=1e-12)
    several = confined(eigenstrain={"LOWER": 1e-3, "UPPER": lambda x, t: 1e-3 + 0 * x[0]})
    assert several == pytest.approx(confined(eigenstrain=1e-3), rel=1e-12, abs=1e-12)
    bent = ThermalExpansion(np.diag([1e-3, 2e-3, 0]) + 1e-3 * np.ones((3, 3)), piecewise({0: 0.0, 1: 2.0}))
    states = march(Structure(FLAT, body=LAW, supports=ROLLERS, eigenstrain=bent).bonded(), [0.5])
    assert states.last.model.break_times == {0.0, 1.0}
    table = np.diag([2e-3, 3e-3, 1e-3]) + 1e-3 * (1 - np.eye(3))
    assert states.last.mean_stress() == pytest.approx(confined(eigenstrain=table), rel=1e-12, abs=1e-12)


# ---------------------------------------------------------------- in-situ stress
MODULI = np.diag([40.0, 30.0, 20.0, 9.0, 8.0, 7.0])
MODULI[:3, :3] += 5.0
MODULI[:3, 5] = MODULI[5, :3] = 1.5, 1.5, 0.5
MODULI[3, 4] = MODULI[4, 3] = 1.0
TILTED = Anisotropic(MODULI)  # orthotropic, its axes turned about z


def rock(law, sigma, plane="strain", joint=FLAT):
    """Two blocks and a layer under their weight, 2 per volume, between smooth walls."""
    walls = {"BOTTOM": {"y": 0.0}, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    if joint.dim == 3:
        walls |= {"FRONT": {"z": 0.0}, "BACK": {"z": 0.0}}
    insitu = {} if sigma is None else {"eigenstrain": Prestress(sigma)}
    data = {"body_force": (0.0, -2.0, 0.0)[: joint.dim], "supports": walls, "plane": plane}
    return Structure(joint, body=law, **data, **insitu).interface(ThinLayer(GLUE, 0.05, at=1.0, **insitu))


@pytest.mark.parametrize(("law", "shape"), [(LAW, 2), (TILTED, 3), (LAW, "stress"), (TILTED, "solid")])
def test_rock_under_its_weight_does_not_move(law, shape):
    """The in-situ stress balances the weight: nothing moves, and S carries it."""
    joint, plane = SOLID if shape == "solid" else FLAT, "stress" if shape == "stress" else "strain"
    top, sides = (0.6, 0.5) if shape == "solid" else (0.75, 2.0)

    def sigma(x, t):
        s = 2.0 * (x[1] - top)
        rows = ((0.4 * s, 0, 0), (0, s, 0), (0, 0, 0.7 * s))
        return rows if shape in (3, "solid") else tuple(row[:2] for row in rows[:2])

    model = rock(law, sigma, plane, joint)
    state, surface = solve(model), Surface(model)
    assert np.abs(state.u.x.array).max() < 1e-11 * np.abs(solve(rock(law, None, plane, joint)).u.x.array).max()
    assert surface.integral(surface.traction(state)[1]) == pytest.approx(-2.0 * top * sides, rel=1e-10)


def test_a_prestress_of_two_components_has_the_third_of_plane_strain():
    nu = LAW.lmbda / (2 * (LAW.lmbda + LAW.mu))
    sigma = np.array([[0.3, 0.1], [0.1, -0.2]])
    strips = lambda stress, bcs: solve(Structure(FLAT, body=LAW, supports=bcs, eigenstrain=Prestress(stress)).bonded())
    assert strips(sigma, dict.fromkeys(ROLLERS, 0.0)).mean_stress() == pytest.approx(sigma, rel=1e-12, abs=1e-12)
    # a free body keeps none, s_33 vanishes too
    assert strips(np.diag([0.3, -0.2]), AT_REST).energies()["bodies"] < 1e-20
    other = strips(np.diag([0.3, -0.2, 0.1 * nu + 0.06]), AT_REST)
    assert other.energies()["bodies"] == pytest.approx(0.06**2 / 30.0 / 2 * 2.5, rel=1e-10)


@pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")
@pytest.mark.parametrize("law", [GLUE, Rubber.shear(5.0, 0.49), Incompressible(5.0)])
def test_a_stress_that_balances_the_loads_moves_no_layer(law):
    """Uniform, with a mean part: of an incompressible layer the pressure bears it."""
    sigma = ((-1.0, 0.0), (0.0, -2.3))
    loads = {"TOP": (0, -2.3), "BOTTOM": (0, 2.3), "LEFT": (1.0, 0), "RIGHT": (-1.0, 0)}
    insitu = {"eigenstrain": Prestress(sigma)}
    data, layer = {"body": LAW, "supports": AT_REST, **insitu}, ThinLayer(law, 0.1, at=1.0, **insitu)
    sides = {f"{name}/LAYER": loads[name] for name in ("LEFT", "RIGHT")}
    meshed = Structure(FLAT, tractions=loads | sides, **data).full(layer)
    for model in (meshed, Structure(FLAT, tractions=loads, **data).interface(layer)):
        assert np.abs(solve(model).u.x.array).max() < 1e-12


# ---------------------------------------------------------------- energies in time
@pytest.mark.parametrize(("kind", "theta"), [("full", 1.0), ("interface", 0.5)])
def test_the_energy_balance_knows_the_work_of_growing_strains(kind, theta):
    """Heat in place and time, beside a load: what is supplied is stored, but for the scheme's remainder."""
    hot = ThermalExpansion(2e-3, lambda x, t: ufl.sin(t) * (1 + x[0] ** 2))
    data = {"supports": {"BOTTOM": 0.0}, "tractions": {"TOP": lambda x, t: (0.02 * t, -0.05 * t)}, "eigenstrain": hot}
    layer = ThinLayer(GLUE, 0.1, eigenstrain=lambda x, t: ((-3e-3 * t, 0), (0, 2e-3 * t * x[0])), at=1.0)
    history = march(getattr(Structure(FLAT, body=LAW, **data), kind)(layer), [0.4, 1.0, 1.5], theta=theta)
    for state in history:
        audit = state.audit
        assert abs(audit.imbalance) < 1e-11
        energies = state.energies()
        assert audit.total == pytest.approx(energies["bodies"] + energies["layer"], rel=1e-10, abs=1e-16)
        if theta == 0.5 and state.t:
            assert abs(audit.remainder) < 1e-11 * audit.total
    assert history.last.audit.supplied > 0


# ---------------------------------------------------------------- contact
@pytest.mark.parametrize("method", ["condensed", "multigrid"])
def test_a_block_that_expands_against_its_base(method):
    """Springs of S and the block in series: w (K + M/H) = -(3 lmbda + 2 mu) e."""
    joint, e, K = block(4.0, 2.0, 0.5, structured=True), 3e-3, 40.0
    walls = {"TOP": {"y": 0.0}, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    structure = Structure(joint, body=LAW, supports=walls, element="P1", eigenstrain=e)
    state = solve(structure.interface(HolonomicCoulomb(K_N=K, K_T=9.0, friction=0.4)), method=method)
    surface = Surface(state.model)
    w = -(3 * LAW.lmbda + 2 * LAW.mu) * e / (K + (LAW.lmbda + 2 * LAW.mu) / 2.0)
    assert surface.integral(surface.jump(state)[1]) == pytest.approx(4.0 * w, rel=1e-8)
    assert surface.integral(surface.traction(state)[1]) == pytest.approx(4.0 * K * w, rel=1e-8)


# ---------------------------------------------------------------- periodic cells
@pytest.mark.parametrize("theta", [1.0, 0.5])
def test_the_expansion_of_a_laminate(theta):
    """Free of mean stress: (1 + nu) times the mean expansion, and the jump of a layer that shrinks; energies balance."""
    joint = periodic(sandwich(1.0, 0.4, 0.6, 0.2, cell="quadrilateral", structured=True), *SIDES)
    expansion = {"LOWER": lambda x, t: 1e-3 * t, "UPPER": lambda x, t: 4e-3 * t}
    layer = ThinLayer(GLUE, 0.02, eigenstrain=lambda x, t: -5e-3 * t, at=1.0)
    data = {"body": LAW, "supports": {}, "stress": np.zeros((2, 2)), "eigenstrain": expansion}
    history = march(Structure(joint, **data).interface(layer), [0.5, 1.0], theta=theta)
    closed = 1.3 * (0.4 * 1e-3 + 0.6 * 4e-3) * np.eye(2)
    closed[1, 1] -= 0.02 * 5e-3 * (3 * GLUE.lmbda + 2 * GLUE.mu) / (GLUE.lmbda + 2 * GLUE.mu)
    assert history.last.mean_strain() == pytest.approx(closed, rel=1e-10, abs=1e-14)
    assert np.abs(history.last.mean_stress()).max() < 1e-13
    assert max(abs(state.audit.imbalance) for state in history) < 1e-11


# ---------------------------------------------------------------- refusals
def computed(values, element=("Lagrange", 2), width=2.0) -> fem.Function:
    """A function on a mesh of its own."""
    T = fem.Function(fem.functionspace(create_rectangle(MPI.COMM_WORLD, [(0.0, -0.5), (width, 0.75)], (5, 5)), element))
    T.interpolate(values)
    return T


@pytest.mark.parametrize("kind", ["full", "interface"])
def test_a_computed_temperature_is_that_of_a_formula(kind):
    data = {"body": LAW, "supports": {"BOTTOM": 0.0}, "tractions": {"TOP": (0.02, -0.05)}}
    T, joint = computed(lambda x: 1 + x[0] ** 2), sandwich(2.0, 0.5, 0.75, 0.25)
    more = lambda x, t: ((0, 1e-3 * x[0]), (1e-3 * x[0], -2e-3 * t))
    sums = []
    for hot in ThermalExpansion(2e-3, lambda x, t: t * (1 + x[0] ** 2)), ThermalExpansion(2e-3, T, lambda x, t: t):
        layer = ThinLayer(CREEPING, 0.1, eigenstrain=[hot, more], at=1.0)
        state = march(getattr(Structure(joint, eigenstrain=hot, **data), kind)(layer), [0.5, 1.0]).last
        sums.append([state.integral(ufl.inner(state.u, state.u) * ufl.dx), state.audit.supplied, state.audit.total])
    assert sums[1] == pytest.approx(sums[0], rel=1e-7)


def test_a_layer_between_bodies_of_two_temperatures_has_their_mean():
    halves = computed(lambda x: 2.0 + np.sign(x[1]), ("DG", 0))
    data = {"body": LAW, "supports": {"BOTTOM": 0.0}}
    layers = (ThinLayer(LAW, 0.1, eigenstrain=hot, at=1.0) for hot in (ThermalExpansion(1e-3, halves), 2e-3))
    pair = [solve(Structure(FLAT, **data).interface(layer)) for layer in layers]
    assert pair[0].u.x.array == pytest.approx(pair[1].u.x.array, abs=1e-9 * np.abs(pair[1].u.x.array).max())


def test_temperatures_that_do_not_cover_the_bodies_or_are_no_scalars_are_refused():
    for T, message in (
        (computed(lambda x: x[0], width=1.5), r"a function is unknown at \(1\.\d+, "),
        (computed(lambda x: x[:2], ("Lagrange", 1, (2,))), "it needs a finite number"),
    ):
        hot = Structure(FLAT, body=LAW, supports={"BOTTOM": 0.0}, eigenstrain=ThermalExpansion(1e-3, T))
        refused(InputError, message, hot.bonded)


def test_refused():
    for strain, match in [
        ("hot", "the eigenstrain of the body 'LOWER' is 'hot'"),
        ([1.0, 2.0], "a list of these that add up"),
        ([], "a list of these that add up"),
        (np.eye(4), "2 x 2 finite components or 3 x 3"),
        (((1.0, 2.0), (3.0, 1.0)), "is not symmetric: components 21 and 12"),
        (lambda x, t: ((x[0], x[1]), (x[0], x[1])), "is not symmetric"),
        (lambda x, t: ufl.lt(x[0], 1), "it needs .*of finite real numbers"),
        ({"MIDDLE": 1.0}, "unknown body 'MIDDLE'"),
    ]:
        make = lambda strain=strain: Structure(FLAT, body=LAW, supports=ROLLERS, eigenstrain=strain).bonded()
        refused(InputError, match, make)


def test_refused_helpers():
    for alpha in ((1.0, 2.0), "x", ((1.0, 2.0, 0), (0, 1.0, 0), (0, 0, 1.0))):
        refused(InputError, r"alpha|symmetric", ThermalExpansion, alpha, 1.0)
    refused(InputError, "T is 'warm'", lambda: ThermalExpansion(1.0, "warm"))
    hot = Structure(FLAT, body=LAW, supports=ROLLERS, eigenstrain=ThermalExpansion(1.0, lambda x, t: 1 / (t - 1)))
    refused(InputError, "eigenstrain of the bodies is not finite at t = 1", lambda: solve(hot.bonded(), 1.0))
    out = Structure(FLAT, body=LAW, supports=ROLLERS, plane="stress", eigenstrain=Prestress(1.0))
    refused(InputError, "out of the plane", lambda: out.bonded())
    plates = Structure(FLAT, body=LAW, supports=ROLLERS)
    stacked = ThinLayer(Stack((0.3, GLUE), (0.7, LAW)), 0.1, eigenstrain=Prestress(1.0), at=1.0)
    refused(InputError, "the layer: its sublayers have stiffnesses", lambda: plates.interface(stacked))
    springs = ThinLayer(Anisotropic.springs(K_N=2.0, K_T=1.0), 0.1, eigenstrain=Prestress(1.0), at=1.0)
    refused(InputError, r"no strain of .* causes some stresses", plates.interface, springs)
