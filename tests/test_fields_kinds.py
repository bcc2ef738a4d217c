"""Files for ParaView of all kinds of models: eigenstrains, planes, rates, order 1, contact in networks, bases."""

from __future__ import annotations

import numpy as np
import pytest

from forms import VonMises
from forms.base import InputError
from geometry import sandwich
from tests.fields_run import BODY, EPS, K
from tests.refused import refused
from tests.test_fields import last
from thinlayer import Structure, Surface, ThermalExpansion, ThinLayer, fields, march, solve

L, M, NU = BODY.lmbda, BODY.mu, BODY.lmbda / (2 * (BODY.lmbda + BODY.mu))
ROLLERS = {"BOTTOM": {"y": 0.0}, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}


@pytest.fixture
def written(tmp_path):
    def write(solution):
        fields.write(solution, tmp_path / "a.pvd")
        return last(tmp_path / "a.pvd")

    return write


def strips():
    return sandwich(2.0, 0.5, 0.7, 0.5)


def test_free_expansion_has_no_stress_in_the_plane(written):
    """In plane strain the expansion that is held out of the plane stresses: -E alpha dT."""
    supports = {"BOTTOM": {"y": 0.0}, "LEFT": {"x": 0.0}}
    hot = ThermalExpansion(1e-3, lambda x, t: 20.0 * t)
    structure = Structure(strips(), body=BODY, supports=supports, eigenstrain=hot)
    bodies = written(march(structure.interface(ThinLayer(K, EPS, at=1.0)), [0.5, 1.0]))["bodies"]
    E = M * (3 * L + 2 * M) / (L + M)
    assert bodies["stress"][:, 2] == pytest.approx(-E * 0.02, rel=1e-8)
    assert np.abs(np.delete(bodies["stress"], 2, axis=1)).max() < 1e-9


@pytest.mark.parametrize("law", [BODY, VonMises(L, M, strength=9.0)], ids=["form", "compiled"])
@pytest.mark.parametrize(("plane", "out"), [("strain", 1.0), ("stress", 0.0)])
def test_stress_out_of_the_plane(written, law, plane, out):
    """Pressed between rollers: along S nu/(1 - nu) or nu times the load, out of the plane the same or none."""
    structure = Structure(strips(), body=law, supports=ROLLERS, tractions={"TOP": (0.0, -0.3)}, plane=plane)
    stress = written(march(structure.interface(ThinLayer(K, EPS, at=1.0)), [1.0]))["bodies"]["stress"]
    along = -0.3 * (NU / (1 - NU) if plane == "strain" else NU)
    assert stress == pytest.approx(np.tile([along, -0.3, out * along, 0, 0, 0], (len(stress), 1)), rel=1e-6, abs=1e-8)


def test_two_points_through_a_layer_of_order_1(written):
    structure = Structure(strips(), body=BODY, supports=ROLLERS, tractions={"TOP": lambda x, t: (0.0, -0.3 * t)})
    law = VonMises(3.0, 2.0, strength=0.05, hardening=1.0)
    on_s = written(march(structure.interface(ThinLayer(law, EPS, order=1, at=1.0)), [0.5, 1.0]))["S"]
    assert {name for name in on_s.cell_data if name.startswith("plastic")} == {"plastic 1", "plastic 2"}
    assert on_s["plastic 1"] == pytest.approx(on_s["plastic 2"], rel=1e-6)  # nothing changes along S
    assert np.abs(on_s["plastic 1"]).max() > 1e-4


def test_s_of_a_meshed_layer(tmp_path):
    """Brought to the S of an interface model: tractions and jumps as `Surface` has them; nothing of its laws there."""
    structure = Structure(strips(), body=BODY, supports={"BOTTOM": 0.0}, tractions={"TOP": (0.1, -0.3)})
    full, limit = solve(structure.full(ThinLayer(K, EPS, at=1.0))), structure.interface(ThinLayer(K, EPS, at=1.0))
    surface = Surface(limit)
    fields.write(full, tmp_path / "a.pvd", surface=surface)
    blocks = last(tmp_path / "a.pvd")
    assert blocks.keys() == ["bodies", "layer", "S"]
    on_s = blocks["S"]
    x, t = surface.profile(surface.traction(full))
    at = [np.linalg.norm(on_s.points[:, :2] - place, axis=1).argmin() for place in x]
    assert on_s["traction"][at, :2] == pytest.approx(t, rel=1e-9)
    assert on_s.integrate_data()["traction"][0, :2] == pytest.approx([0.2, -0.6], rel=1e-9)
    assert list(on_s.cell_data) == ["seam"]
    other = Surface(Structure(strips(), body=BODY, supports={"BOTTOM": 0.0}).interface(ThinLayer(K, EPS, at=1.0)))
    refused(InputError, "of the same joint", lambda: fields.write(full, tmp_path / "a.pvd", surface=other))
    refused(InputError, "give Surface", lambda: fields.write(full, tmp_path / "a.pvd", surface=limit))
