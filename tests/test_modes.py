"""Natural modes, their loss and harmonic responses, against closed forms, meshed layers and published beams."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

import thinlayer.parts.inertia
from forms import Incompressible, KelvinVoigt, LinearElastic, Maxwell, VonMises
from forms.base import InputError
from geometry import sandwich
from tests.on_ranks import on_ranks
from tests.refused import refused
from tests.vibrating_bars import SIDES, UNIFORM, WIDTH, bar, frequencies
from thinlayer import Inertia, RangeWarning, Springs, Structure, ThinLayer, harmonic, modes

UNLIKE = {"eps": 0.08, "modulus": 0.3, "density": {"LOWER": 2.0, "UPPER": 0.7, "S": 1.3}, "heights": (0.3, 0.6)}
STEEL, MASS = LinearElastic.young(E=210e3, nu=0.3), Inertia({"LOWER": 7.8e-9, "UPPER": 7.8e-9, "S": 1.2e-9})


@pytest.mark.parametrize("data", [{}, UNLIKE], ids=["alike", "unlike"])
@pytest.mark.parametrize("kind", ["full", "interface"])
@pytest.mark.filterwarnings("ignore:a shear wave crosses")
def test_bar(kind, data):
    omega = modes(bar(kind=kind, h=1 / 30, **data), 2).omega
    assert omega == pytest.approx(frequencies(2, exact=kind == "full", **data), rel=1.5e-6)


@pytest.mark.filterwarnings("ignore:a shear wave crosses")
def test_bar_of_published_numbers(monkeypatch):
    """The twins have no mass in the layer, or that of the mean alone."""
    assert modes(bar(), 2).omega == pytest.approx([1.051521913, 3.520492637], rel=2e-6)
    assert modes(bar(density={**UNIFORM, "S": 0.0}), 2).omega == pytest.approx([1.0768740, 3.6435975], rel=2e-6)
    monkeypatch.setattr(thinlayer.parts.inertia, "JUMP_SHARE", 0.0)
    assert modes(bar(), 2).omega == pytest.approx([1.0531967, 3.5449327], rel=2e-6)


def lowest_wave(eps: float, nu: float, k: float = np.pi) -> float:
    """The lowest frequency of waves exp(ikx) in plane strain in two bodies and a layer, by matrix exponentials."""

    def determinant(omega):
        product = np.eye(4)
        for height, mu in ((0.5, 1.0), (eps, eps), (0.5, 1.0)):
            lmbda, inertia = 2 * nu / (1 - 2 * nu) * mu, omega**2
            M = lmbda + 2 * mu
            matrix = np.array(
                [[0, -k, 1 / mu, 0], [lmbda * k / M, 0, 0, 1 / M], [0, 0, 0, -k * lmbda / M], [0, -inertia, k, 0]]
            )
            matrix[2, 0] = k**2 * (M - lmbda**2 / M) - inertia
            product = expm(height * matrix) @ product
        return np.linalg.det(product[2:, 2:])

    grid = np.linspace(0.5, 4.0, 200)
    first = np.flatnonzero(np.diff(np.sign([determinant(omega) for omega in grid])))[0]
    return float(brentq(determinant, grid[first], grid[first + 1]))


@pytest.mark.filterwarnings("ignore:a shear wave crosses")
def test_waves_along_the_layer():
    """In plane strain, meshed and on S; the twin has no mass in the layer."""
    eps, nu = 1 / 16, 0.37
    exact, errors = lowest_wave(eps, nu), []
    for kind, rho in (("full", 1.0), ("interface", 1.0), ("interface", 0.0)):
        joint = sandwich(0.5, 0.5, 0.5, 1 / 16, cell="quadrilateral", structured=True)
        supports = {"BOTTOM": 0, "LEFT": {"y": 0}, "RIGHT": {"x": 0}}
        parts = [Inertia({**UNIFORM, "S": rho})]
        structure = Structure(joint, body=LinearElastic.shear(1.0, nu), supports=supports, parts=parts)
        model = getattr(structure, kind)(ThinLayer(LinearElastic.shear(eps, nu), eps, order=1))
        errors.append(modes(model, 1).omega[0] / exact - 1)
    assert errors == [pytest.approx(0.0, abs=2e-5), pytest.approx(0.0, abs=2e-3), pytest.approx(0.024, abs=0.01)]


FAMILIES = {
    "soft": (2.0, lambda eps: (eps, 1.0)),
    "fixed": (2.9, lambda eps: (3.0, 1.0)),
    "heavy": (1.0, lambda eps: (1.0, 1 / eps)),
}


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.filterwarnings("ignore:a shear wave crosses")
def test_rates(family):
    rate, data_of = FAMILIES[family]
    errors = []
    for eps in (1 / 32, 1 / 64):
        modulus, rho = data_of(eps)
        data = {"eps": eps, "modulus": modulus, "density": {**UNIFORM, "S": rho}}
        errors.append(modes(bar(**data, h=1 / 32), 1).omega[0] / frequencies(1, exact=True, **data)[0] - 1)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(rate, abs=0.25)


def beam(h=2 / 3, eps=0.2, **data):
    joint = sandwich(60, 2, 2, h, cell="quadrilateral", structured=True)
    return Structure(joint, body=STEEL, **{"supports": {"LEFT": 0}, "parts": [MASS]} | data)


@pytest.mark.filterwarnings("ignore:a shear wave crosses")
def test_order_0_loses_the_lever_of_a_cantilever():
    glue, plates = LinearElastic.young(E=5, nu=0.3), beam()
    exact = modes(plates.full(ThinLayer(glue, 0.8)), 2)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", "plates bend")
        errors = modes(plates.interface(ThinLayer(glue, 0.8, order=1)), 2).omega / exact.omega - 1
    assert (abs(errors) < [2e-5, 5e-5]).all()
    with pytest.warns(RangeWarning, match="plates bend about the layer 'S' of order 0"):
        lever = modes(plates.interface(ThinLayer(glue, 0.8)), 1)
    assert lever.omega[0] / exact.omega[0] - 1 == pytest.approx(-1.8e-2, abs=1e-3)
    shape = exact.shapes[0]
    assert sum(shape.energies()[name] for name in ("bodies", "layer")) == pytest.approx(
        exact.omega[0] ** 2 / 2, rel=1e-7
    )
    for shares in exact.shares.values():
        assert sum(shares.values()) == pytest.approx(np.ones(2), rel=1e-7)
    assert exact.hertz[0] == pytest.approx(499.86, abs=0.01)


def test_free_structures_have_rigid_modes_and_inclined_supports_are_as_straight_ones():
    glue = ThinLayer(LinearElastic.young(E=50, nu=0.3), 0.2, order=1)
    free = modes(beam(2, supports={}).interface(glue), 5).omega
    assert (free[:3] == 0).all()
    assert free[3] > 0
    glue, joint = ThinLayer(LinearElastic.young(E=70e3, nu=0.3), 0.02, order=1), sandwich(1.0, 0.5, 0.6, 0.25)
    data = {"body": STEEL, "supports": {"BOTTOM": {"n": 0}, "LEFT": {"n": 0}}, "parts": [MASS]}
    straight, turned = (modes(Structure(j, **data).interface(glue), 4) for j in (joint, joint.rotated(0.4)))
    assert turned.model.constraints.T is not None
    assert turned.omega == pytest.approx(straight.omega, rel=1e-8)
    assert turned.shares["kinetic"]["S"] == pytest.approx(straight.shares["kinetic"]["S"], rel=1e-6)


def test_incompressible_layers_and_springs():
    """Meshed and on S; springs add what they hold to the strain energy."""
    rubber, parts = Incompressible(mu=1.0), [MASS, Springs("BOTTOM", normal=1.0, tangential=1.0)]
    plates = beam(2, supports={}, parts=parts)
    meshed, on_s = (
        modes(m, 3).omega
        for m in (plates.full(ThinLayer(rubber, 0.2)), plates.interface(ThinLayer(rubber, 0.2, order=1)))
    )
    assert on_s == pytest.approx(meshed, rel=2e-3)
    lowest = modes(plates.interface(ThinLayer(STEEL, 0.2, order=1)), 3)
    assert (lowest.shares["strain"]["LOWER"] + lowest.shares["strain"]["UPPER"] < 0.2).all()


def damper(kind, **layer):
    """Half of a simply supported beam of the length 60 with a core between plates; in GPa, mm and g/cm^3."""
    joint = sandwich(30, 1.5, 0.8, h=1, cell="quadrilateral", structured=True)
    data = {
        "supports": {"LEFT": {"y": 0}, "RIGHT": {"x": 0}},
        "parts": [Inertia({"LOWER": 7.8, "UPPER": 7.8, "S": 1.1})],
    }
    core = ThinLayer(LinearElastic.shear(mu=0.0009, nu=0.49), 0.2, **layer)
    return getattr(Structure(joint, body=LinearElastic.young(E=210, nu=0.3), **data), kind)(core)


@pytest.mark.filterwarnings("ignore:plates bend")
def test_loss_of_a_damper():
    """Against Fourier series; the twins are order 0, and strain energies of the modes without loss."""
    exact = 5.666080024e-3, 0.022515528
    for kind, order in (("full", 0), ("interface", 1)):
        lowest = modes(damper(kind, order=order), 1)
        omega, loss = (values[0] for values in lowest.loss(S=0.6))
        assert (omega, loss) == (pytest.approx(exact[0], rel=2e-5), pytest.approx(exact[1], rel=3e-5))
    assert lowest.shares["strain"]["S"][0] * 0.6 == pytest.approx(1.00106 * loss, rel=1e-4)
    _, loss = modes(damper("interface"), 1).loss(S=0.6)
    assert loss[0] == pytest.approx(0.016520488, rel=3e-5)


RESPONSE = [2.37635199 - 0.44762912j, 5.50479412 - 7.31231993j, -0.49827175 - 0.03893070j]
TOP = {"top": lambda s: s.integral(s.u[1] * s.model.ds(s.model.domain.values("TOP"))) / WIDTH}


@pytest.mark.filterwarnings("ignore:a shear wave crosses")
def test_harmonic_response():
    """In closed form; the twin leaves the layer's mass out."""
    loaded = {"tractions": {"TOP": (0, 1.0)}}
    errors = []
    for rho in (1.0, 0.0):
        model = bar(density={**UNIFORM, "S": rho}, **loaded)
        values = harmonic(model, [0.5, 1.0, 2.0], TOP, loss={"S": 0.3}).values["top"]
        errors.append(abs(values / RESPONSE - 1))
    assert (errors[0] < 2e-6).all()
    assert (errors[1] > [4e-3, 2e-2, 4e-2]).all()


def viscous_response(moduli, omega, load=1.0, motion=0.0):
    """Of the bar with a complex modulus of the layer: bodies of the modulus and density 1, no mass in the layer."""
    k, s, c = moduli(omega) * 16, np.sin(omega / 2), np.cos(omega / 2)
    # below u = motion cos(omega y) + lower sin(omega y), above u = upper cos(omega (1 - y)) - load/omega sin(omega (1 - y))
    A = np.array([[omega * c + k * s, -k * c], [k * s, omega * s - k * c]], complex)
    b = np.array(
        [k * (-load / omega * s) - motion * (-omega * s + k * c), -k * load / omega * s - load * c - k * motion * c]
    )
    return np.linalg.solve(A, b)[1]


LAWS = {
    "KelvinVoigt": (KelvinVoigt(0.0, 1 / 32, 0.0, 0.25), lambda w: (1 + 0.25j * w) / 16),
    "Maxwell": (Maxwell(0.0, 1 / 32, 2.0), lambda w: 2j * w / (1 + 2j * w) / 16),
}


@pytest.mark.parametrize("name", LAWS)
def test_harmonic_response_of_viscous_layers(name):
    """Under loads, and by motion of the support; the march reaches the same amplitude."""
    law, moduli = LAWS[name]
    light = {**UNIFORM, "S": 0.0}
    for data, closed in (
        ({"tractions": {"TOP": (0, 1.0)}}, {}),
        ({"supports": {"BOTTOM": {"y": 1.0}, **SIDES}}, {"load": 0.0, "motion": 1.0}),
    ):
        values = harmonic(bar(law=law, density=light, **data), [0.5, 2.0], TOP).values["top"]
        assert values == pytest.approx([viscous_response(moduli, w, **closed) for w in (0.5, 2.0)], rel=3e-6)


def test_modes_near_a_frequency_that_is_exact():
    """Without a step aside, K - omega^2 M has no inverse, and rounding hides all other modes."""
    model = beam(2).interface(ThinLayer(LinearElastic.young(E=50, nu=0.3), 0.2, order=1))
    lowest = modes(model, 4).omega
    for k, n, wanted in ((0, 2, lowest[:2]), (2, 3, lowest[:3]), (1, 1, lowest[1:2])):
        assert modes(model, n, near=lowest[k]).omega == pytest.approx(wanted, rel=1e-8)


def omegas() -> list[float]:
    return [*modes(beam(2).interface(ThinLayer(LinearElastic.young(E=50, nu=0.3), 0.2, order=1)), 4).omega]


@on_ranks(omegas, 2)
def test_on_two_ranks(there):
    assert there == pytest.approx(omegas(), rel=1e-9)


def test_refused():
    refused(InputError, "has no mass", lambda: modes(bar(parts=[])))
    for density, words in ((3.0, "density is 3.0"), ({"LOWER": 1.0, "UPPER": 1.0, "GLUE": 1.0}, "layer 'GLUE'; known")):
        refused(InputError, words, bar, parts=[Inertia(density)])
    refused(InputError, "VonMises is not linear", lambda: modes(bar(law=VonMises(0.0, 1 / 32, 0.02, 0.02), order=0)))
    refused(InputError, "in 2.24 radians", lambda: modes(bar(), 3))
    refused(InputError, "n is 0", lambda: modes(bar(), 0))
    model = bar()
    refused(InputError, "loss factor of 'S'", lambda: modes(model, 1).loss(S=-0.1))
    refused(InputError, "body or layer 'T'", lambda: modes(model, 1).loss(T=0.1))
    squared = {"top": lambda s: TOP["top"](s) ** 2}
    loaded = bar(tractions={"TOP": (0, 1.0)})
    refused(InputError, "not linear in the displacements", lambda: harmonic(loaded, [1.0], squared, loss={"S": 0.3}))
    refused(InputError, "not linear in the displacements", lambda: harmonic(loaded, [1.0], squared))
    for wrong in ([0.0], [], 1.0, ["a"]):
        refused(InputError, "omegas", lambda: harmonic(loaded, wrong, TOP))  # noqa: B023
    refused(InputError, "value of 'top' is array", lambda: harmonic(loaded, [1.0], {"top": lambda s: s.u.x.array}))
    refused(InputError, "observe", lambda: harmonic(loaded, [1.0], TOP["top"]))
    refused(InputError, "loss is 0.3", lambda: harmonic(loaded, [1.0], TOP, loss=0.3))
    refused(InputError, "n is 100000000; the model has", lambda: modes(bar(), 10**8))
    with pytest.warns(RangeWarning, match="a shear wave crosses the layer 'S' in 1.24 radians"):
        modes(bar(), 2)
