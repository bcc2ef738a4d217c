"""What goes into structures of a scalar field: refusals by name, stacks, seams that meet, periodic cells, scripts."""

import warnings
from dataclasses import dataclass

import numpy as np
import pytest
import ufl

from forms import (
    AnisotropicConduction,
    Conductance,
    Conduction,
    FluxLaw,
    Heat,
    HolonomicCoulomb,
    Incompressible,
    LinearElastic,
    Stack,
)
from forms.base import InputError
from forms.work import Interface
from geometry import block, bond_cell, periodic, ring, sandwich, wall
from tests.fourier import K, blocks, compliance, transfer
from tests.mpirun import CLONE
from tests.orders import observed_orders
from tests.refused import refused
from thinlayer import (
    Bond,
    Film,
    JouleHeat,
    PointLoad,
    Pressure,
    Prestress,
    RigidPlate,
    Springs,
    Structure,
    Surface,
    SurfaceSource,
    ThermalExpansion,
    ThinLayer,
    UflPart,
    compare,
    derivative,
    drive,
    estimate,
    goals,
    homogenised_conductivity,
    homogenised_stiffness,
    march,
    solve,
)
from thinlayer.running.case import DescribedCase
from thinlayer.running.description import Description

K_BODY, EPS = 0.05, 0.2
GLUE, ELASTIC = Conduction(2e-4), LinearElastic(1.0, 1.0)
LAYER = ThinLayer(GLUE, EPS)


def plates(**data):
    data = {"body": Conduction(K_BODY), "supports": {"BOTTOM": 20.0}, "fluxes": {"TOP": 0.05}} | data
    return Structure(sandwich(40, 4, 6, 5, cell="quadrilateral"), **data)


def on_base(**data):
    data = {"body": Conduction(K_BODY), "supports": {}, "fluxes": {"TOP": 0.05}} | data
    return Structure(block(40, 6, 5, cell="quadrilateral"), **data)


def elastic(**data):
    data = {"body": ELASTIC, "supports": {"BOTTOM": 0.0}, "tractions": {"TOP": (0.0, 1.0)}} | data
    return Structure(sandwich(40, 4, 6, 5, cell="quadrilateral"), **data)


def heating(**data):
    model = plates(**{"body": Heat(K_BODY, 2e-3), "initial": 20.0} | data)
    return model.interface(ThinLayer(Heat(2e-4, 1e-3), EPS, order=0))


@dataclass(frozen=True)
class Stressed(FluxLaw):
    k: float

    def stress(self, step):
        return self.k * step.mid


@dataclass(frozen=True)
class Ageing(FluxLaw):
    k: float
    internal = {"X": ()}

    def flux(self, step):
        return self.k * step.g

    def advance(self, step):
        return {"X": step["X"]}


REFUSED = {
    "eigenstrain= does not act on a scalar field": lambda: plates(eigenstrain=ThermalExpansion(1e-5, 20.0)),
    "eigenstrain is 0.01; it is of displacements": lambda: ThinLayer(GLUE, EPS, eigenstrain=0.01),
    r"eigenstrain is Prestress\(": lambda: ThinLayer(GLUE, EPS, eigenstrain=Prestress(np.eye(2))),
    "edges is 'free'": lambda: ThinLayer(GLUE, EPS, edges="free"),
    "a scalar field takes fluxes": lambda: plates(fluxes={"TOP": Pressure(1.0)}).interface(LAYER),
    "flux on 'TOP' is": lambda: plates(fluxes={"TOP": (0.0, 1.0)}).interface(LAYER),
    "fluxes is 1.0": lambda: plates(fluxes=1.0).interface(LAYER),
    "sources: unknown body 'PLATE'; known: LOWER, S, UPPER": lambda: plates(sources={"PLATE": 1.0}).interface(LAYER),
    "tractions= does not act on a scalar field; allowed: fluxes, sources": lambda: plates(tractions={"TOP": (0, 1)}),
    "fluxes= does not act on a displacement": lambda: elastic(fluxes={"TOP": 1.0}),
    "loads= does not act": lambda: plates().interface(LAYER).with_loads(loads=[PointLoad((0.0, 6.0), (0.0, 1.0))]),
    "RigidPlate.* acts on a displacement": lambda: plates(parts=[RigidPlate("TOP")]),
    "Springs.* acts on a displacement": lambda: plates(parts=[Springs("TOP", normal=1.0)]),
    "Film.* acts on a scalar field": lambda: elastic(parts=[Film("TOP", 1.0, 20.0)]),
    "each must be a part": lambda: plates(parts=["film"]),
    "unknown component 'n'; known: T": lambda: plates(supports={"BOTTOM": {"n": 20.0}}).interface(LAYER),
    "nothing holds the field": lambda: plates(supports={}).interface(LAYER),
    "gradient= does not act on a displacement": lambda: elastic(gradient=(1.0, 0.0)),
    "strain= does not act on a scalar field": lambda: plates(strain=np.zeros((2, 2))),
    "initial= does not act on a displacement": lambda: elastic(initial=20.0),
    "a march with a capacity needs": lambda: march(
        plates(body=Heat(1.0, 1.0)).interface(ThinLayer(Heat(1.0, 1.0), EPS)), [1.0]
    ),
    "LinearElastic is a law of a displacement": lambda: plates().interface(ThinLayer(ELASTIC, EPS)),
    "Conduction is a law of a scalar field": lambda: elastic().interface(LAYER),
    "HolonomicCoulomb is a law": lambda: plates().interface(HolonomicCoulomb(1.0, 1.0, 0.3)),
    "Incompressible is a law": lambda: plates().interface(ThinLayer(Incompressible(1.0), EPS)),
    "laws of different unknowns": lambda: plates(body={"LOWER": GLUE, "UPPER": ELASTIC}),
    "laws of one unknown": lambda: Stack((0.5, GLUE), (0.5, ELASTIC)),
    r"order=2 of the law is Stack\(": lambda: ThinLayer(Stack((0.5, GLUE), (0.5, Conduction(1.0))), EPS, order=2),
    "order 2 is of laws of a scalar field": lambda: ThinLayer(ELASTIC, EPS, order=2),
    "of order 2 do not take the heat of a current": lambda: plates(
        parts=[JouleHeat(solve(plates().interface(LAYER)))]
    ).interface(ThinLayer(GLUE, EPS, order=2)),
    r"Stressed has a method stress that is never called: write flux\(step\)": lambda: Stressed(1.0),
    "Ageing has a method advance that is never called: write evolve": lambda: Ageing(1.0),
    "no field of a structure, nor values on S": lambda: Film("TOP", 1.0, Surface(plates().bonded()).function(1.0)),
    "mean flux: a law of the bodies, or a part, is not linear or has a rate": lambda: derivative(
        march(heating(), [1]), goals.MeanFlux(), ["S.k"]
    ),
    "layered: along is": lambda: AnisotropicConduction.layered([1.0], 2.0),
    "drive is for laws of a displacement": lambda: drive(GLUE, [{"w_T": 1.0, "w_N": 0.0}]),
    "it is bonded; a source needs a layer": lambda: plates(sources={"S": SurfaceSource(1.0)}).bonded(),
    "the flux on 'LEFT/LAYER' acts on the side.*use order=0, which leaves it out, or mesh": lambda: plates(
        fluxes={"LEFT/LAYER": 0.1}
    ).interface(LAYER),
    "film LEFT/LAYER: this facet set is empty.*mesh it": lambda: plates(
        parts=[Film("LEFT/LAYER", 1.0, 20.0)]
    ).interface(LAYER),
    "no equilibrium without time.*for a steady state take Conduction in place of Heat": lambda: solve(heating()),
    "estimate: Heat remembers steps beside.*take Conduction in place of Heat": lambda: estimate(march(heating(), [1])),
    "order=1 of a Stack on a curved S: .*mesh the layer.*, or use order=0": lambda: Structure(
        ring(1.0, 1.5, 2.0, 0.5, angle=1.2, cell="quadrilateral"), body=GLUE, supports={"INSIDE": 0.0}
    ).interface(ThinLayer(Stack((0.5, GLUE), (0.5, Conduction(1.0))), EPS), bodies="extended"),
    "homogenised_stiffness is for laws of a displacement": lambda: homogenised_stiffness(cell().interface(LAYER)),
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_is_refused_by_name(words):
    refused(InputError, words, REFUSED[words])


@pytest.mark.parametrize("place", ["side", "body", "support", "eigenstrain"])
def test_values_on_s_are_no_data_of_bodies(place):
    """They would be zero away from S."""
    values = Surface(plates().bonded()).function(1.0)
    data = {
        "side": {"fluxes": {"TOP": values}},
        "body": {"sources": {"UPPER": values}},
        "support": {"supports": {"BOTTOM": values}},
        "eigenstrain": {"eigenstrain": ThermalExpansion(1e-5, values, reference=0)},
    }[place]
    make, layer = (elastic, ThinLayer(ELASTIC, EPS)) if place == "eigenstrain" else (plates, LAYER)
    for kind in ("full", "interface"):
        refused(InputError, "values on S are data of layers", getattr(make(**data), kind), layer)


def test_a_stack_of_laws_that_are_not_linear_is_refused_on_s():
    @dataclass(frozen=True)
    class Hotter(FluxLaw):
        k: float
        symmetric = False

        def flux(self, step):
            return self.k * (1 + step.T**2) * step.g

    refused(InputError, "not linear, so its part", ThinLayer, Stack((0.5, Hotter(1.0)), (0.5, GLUE)), EPS)


def test_a_part_in_ufl_acts_on_a_scalar_field():
    """Radiation, proportional to T^4, takes a part of the flux."""
    radiation = UflPart(virtual_work=lambda u, v, m: 1e-9 * u[0] ** 4 * v[0] * m.ds(m.domain.values("TOP")))
    T = solve(plates(parts=[radiation]).interface(LAYER)).u.x.array.max()
    assert pytest.approx((0.05 - 1e-9 * T**4) * (10 / K_BODY + EPS / 2e-4), rel=1e-8) == T - 20.0


# ---------------------------------------------------------------- stacks
@pytest.mark.parametrize(
    ("fractions", "conductivities", "errors"),
    [
        ((0.5, 0.5), lambda eps: (eps, 4 * eps), {1 / 8: 9.1e-6, 1 / 16: 1.3e-6}),
        ((0.3, 0.7), lambda eps: (0.2, 5.0), {1 / 8: 3.2e-5, 1 / 16: 5.5e-6}),
        ((0.5, 0.5), lambda eps: (1 / eps, eps), {1 / 8: 3.9e-6, 1 / 16: 1.4e-6}),  # a foil under glue
        (
            (0.3, 0.2, 0.5),
            lambda eps: (eps, 1 / eps, 2 * eps),
            {1 / 8: 2.9e-4, 1 / 16: 2.8e-4},
        ),  # between glues: no rate
    ],
    ids=["insulating", "fixed", "foil", "foil between"],
)
def test_stacks(fractions, conductivities, errors):
    for eps, error in errors.items():
        ks = conductivities(eps)
        layer = ThinLayer(Stack(*((a, Conduction(k)) for a, k in zip(fractions, ks, strict=True))), eps)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            state = solve(blocks(1 / 16).interface(layer))
        want = compliance(*(transfer(k, a * eps) for a, k in zip(fractions, ks, strict=True)))
        assert want - state.energies()["loads"] == pytest.approx(error, rel=0.1)
        assert any("spreads the field" in str(w.message) for w in caught) == (len(ks) == 3)


@pytest.mark.filterwarnings("ignore::thinlayer.RangeWarning")
@pytest.mark.parametrize(
    ("lower", "upper", "error"),
    [
        (Conduction(16.0), GLUE, 1e-3),
        (Conduction(lambda x: 0.1 * (1 + x[0])), Conduction(lambda x: 0.2 * (2 - x[0])), 5e-3),
        (AnisotropicConduction.layered(1.0, 0.1), Conduction(0.1), 1e-3),
    ],
    ids=["foil", "functions", "anisotropic"],
)
def test_stacks_agree_with_meshed_ones(lower, upper, error):
    layer, structure = ThinLayer(Stack((0.5, lower), (0.5, upper)), 1 / 16), blocks()
    errors = compare(solve(structure.full(layer)), solve(structure.interface(layer)))
    assert max(errors["error_flux"], errors["error_jump"]) < error


@pytest.mark.filterwarnings("ignore::thinlayer.RangeWarning")
def test_stacks_whose_shares_of_the_jump_vary_along_s(monkeypatch):
    """Flux and jump converge at rate 2 or more, and not at all without the jump times the gradient of the shares."""

    def orders():
        def errors(eps):
            k = lambda factor, sign: lambda x: factor / eps * (1.6 + sign * np.cos(K * x[0]))
            layer = ThinLayer(Stack((0.4, Conduction(k(1.3, -1))), (0.6, Conduction(k(0.3, 1)))), eps)
            compared = compare(solve(structure.full(layer)), solve(structure.interface(layer)))
            return compared["error_flux"], compared["error_jump"]

        sizes = (1 / 4, 1 / 8)
        return [observed_orders(sizes, of)[-1] for of in zip(*map(errors, sizes), strict=True)]

    structure = blocks(1 / 12, fluxes={"TOP": lambda x, t: 1 + ufl.cos(K * x[0])})
    assert min(orders()) > 2
    monkeypatch.setattr(Interface, "gradient_along", lambda self, f: ufl.zero(2))
    assert max(orders()) < 1


@pytest.mark.parametrize("make", [plates, on_base], ids=["bodies", "rigid base"])
def test_a_source_in_a_stack_goes_to_the_face_that_is_nearer(make):
    """Nearer by the resistance between; half to each would be an error of 5 % in the jump."""
    layer = ThinLayer(Stack((0.3, Conduction(lambda x: 2e-4 + 1e-6 * x[0])), (0.7, Conduction(4e-3))), EPS)
    structure = make(sources={"S": 0.1})
    errors = compare(solve(structure.full(layer)), solve(structure.interface(layer)))
    assert max(errors["error_flux"], errors["error_jump"]) < 2e-3


# ---------------------------------------------------------------- seams that meet, shapes
@pytest.mark.filterwarnings("ignore::thinlayer.RangeWarning")
def test_a_wall_of_conducting_seams():
    """They exchange their fluxes where they meet, at order 1, also in elements of degree 1; at order 0 they do not."""
    eps, joint = 1 / 16, wall(2, 2, (0.5, 0.5), h=1 / 8)
    data = {"body": Conduction(1.0), "supports": {"BOTTOM": 0.0}, "fluxes": {"TOP": lambda x, t: 1 + x[0]}}

    def compliance(make, order=1, element="Q2"):
        layers = dict.fromkeys(joint.seams, ThinLayer(Conduction(16.0), eps, order=order))
        return solve(getattr(Structure(joint, element=element, **data), make)(layers)).energies()["loads"]

    want = compliance("full")
    assert compliance("interface") == pytest.approx(want, rel=0.03)
    assert compliance("interface", element="Q1") == pytest.approx(want, rel=0.03)
    assert compliance("interface", order=0) > 1.8 * want


def test_a_taper():
    layer = ThinLayer(GLUE, EPS, profile=lambda x: 1 + 0.4 * np.cos(np.pi * x[0] / 40))
    joint = sandwich(40, 4, 6, 2, cell="quadrilateral")
    data = {"body": Conduction(K_BODY), "supports": {"BOTTOM": 20.0}, "fluxes": {"TOP": 0.05}}
    for make in ("full", "interface"):
        model = getattr(Structure(joint, **data), make)(layer, bodies="extended")
        assert solve(model).u.x.array.max() == pytest.approx(83.62312865, abs=2e-8)


# ---------------------------------------------------------------- periodic cells
def cell(h=0.25, joint=None, k=2.0, **data):
    joint = joint or periodic(sandwich(1, 0.5, 0.5, h=h, cell="quadrilateral"), ("LEFT", "RIGHT"), ("BOTTOM", "TOP"))
    return Structure(joint, body=Conduction(k), supports={}, **data)


@pytest.mark.filterwarnings("ignore::thinlayer.RangeWarning")
@pytest.mark.parametrize("k", [0.3, 30.0])
def test_conductivity_of_a_laminate(k):
    """Conductances add up along it, resistances across it; at order 0 the layer has none along it."""
    eps, law = 0.1, Stack((0.3, Conduction(k)), (0.7, Conduction(2 * k)))
    along, across = 2.0 + eps * 1.7 * k, 1 / (0.5 + eps * 0.65 / k)
    for order, want in ((1, [along, across]), (0, [2.0, across])):
        K_eff = homogenised_conductivity(cell().interface(ThinLayer(law, eps, order=order)))
        assert K_eff == pytest.approx(np.diag(want), abs=1e-11)


def test_a_mean_gradient():
    """Across a laminate it drops in the layer; the mean flux follows."""
    joint = periodic(sandwich(1, 0.5, 0.5, h=0.25, cell="quadrilateral"), ("BOTTOM", "TOP"))
    for bodies, want in (("kept", 1 / (0.5 + 0.1 / 0.3)), ("extended", 1 / (0.9 / 2.0 + 0.1 / 0.3))):
        state = solve(cell(joint=joint, gradient=(0, 3.0)).interface(ThinLayer(Conduction(0.3), 0.1), bodies=bodies))
        assert state.mean_strain() == pytest.approx([0.0, 3.0])
        assert state.mean_stress() == pytest.approx([0.0, 3.0 * want])


def test_a_mean_gradient_is_not_handed_over():
    """The field of such a state is its periodic part alone."""
    joint = periodic(sandwich(1, 0.5, 0.5, h=0.25, cell="quadrilateral"), ("LEFT", "RIGHT"))
    state = solve(Structure(joint, body=GLUE, supports={"BOTTOM": 0}, gradient=(1, 0)).interface(ThinLayer(GLUE, 0.1)))
    heat = Structure(joint, body=GLUE, supports={"BOTTOM": 0}, parts=[JouleHeat(state)])
    refused(InputError, "has a mean gradient", lambda: solve(heat.interface(ThinLayer(GLUE, 0.1))))
    swollen = Structure(
        joint, body=ELASTIC, supports={"BOTTOM": 0}, eigenstrain=ThermalExpansion(1.0, state, reference=0)
    )
    refused(InputError, "has a mean gradient", swollen.interface, ThinLayer(ELASTIC, 0.1))


def test_a_temperature_is_of_a_model_with_the_same_axis():
    hot = ThermalExpansion(1e-5, solve(plates(plane="axisymmetric").interface(LAYER)), reference=20)
    refused(InputError, "with this plane=", elastic(eigenstrain=hot).interface, ThinLayer(ELASTIC, EPS))
    refused(InputError, "with this plane=", elastic().interface, ThinLayer(ELASTIC, EPS, eigenstrain=hot))


def test_a_current_has_the_shape_of_the_model_of_heat():
    def current(layer=LAYER, bodies="kept", **data):
        return solve(plates(**data).interface(layer, bodies=bodies))

    for words, state in {
        "plane= and bodies=": current(plane="axisymmetric"),
        "bodies= of the model": current(bodies="extended"),
        "a layer with a thickness": current(Conductance(1e-3)),
        "needs a layer": current({"S": Bond()}),
        "the same thickness": current(ThinLayer(GLUE, 2 * EPS)),
    }.items():
        refused(InputError, words, lambda state=state: solve(plates(parts=[JouleHeat(state)]).interface(LAYER)))
    heated = plates(parts=[JouleHeat(current())])
    refused(InputError, "in place of bonds", heated.bonded)


def test_a_bond_conducts_as_its_bricks():
    structure = cell(joint=bond_cell((2.0, 1.0), 0.5), gradient=(0, 0))
    bonded = structure.interface(dict.fromkeys(structure.joint.seams, Bond()))
    assert homogenised_conductivity(bonded) == pytest.approx(2.0 * np.eye(2), abs=1e-11)


# ---------------------------------------------------------------- descriptions
PAD = CLONE / "studies" / "data" / "pad.toml"


def test_a_described_pad():
    """The heat of its film leaves by the support; a flux and a source add theirs."""
    case = DescribedCase.from_description(Description.read(PAD))
    state = solve(case.make_model())
    assert [goal.value(state, state.model) for goal in case.goals] == pytest.approx([0.1471, 34.71], rel=1e-3)
    assert state.reaction("LEFT").flow == pytest.approx(-state.reaction("RIGHT").flow, rel=1e-9)
    more = Description.read(PAD, ["fluxes={RIGHT=0.01}", "films={}", "sources={'UPPER PLATE'=1e-4}"])
    state = solve(DescribedCase.from_description(more).make_model())
    assert state.reaction("LEFT").flow == pytest.approx(-state.applied().flow, rel=1e-9)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("tractions={TOP=[0,1]}", "tractions= does not act on a scalar field"),
        ("layer.eigenstrain=0.1", "it is of displacements"),
        ("films={RIGHT={h=-1,T=20}}", "films.RIGHT.h: -1 is not > 0"),
        ("body.k='50 W/m/K'", "units are read in lengths, stresses, forces and times"),
        ("fluxes={RIGHT=[1,2]}", "is not a finite number"),
        ("body={law='FluxLaw'}", "unknown law of strains 'FluxLaw'"),
    ],
)
def test_described_wrongly(setting, words):
    refused(InputError, words, lambda: DescribedCase.from_description(Description.read(PAD, [setting])))
