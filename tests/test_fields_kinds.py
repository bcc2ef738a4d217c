"""Files for ParaView of all kinds of models: eigenstrains, planes, rates, order 1, contact in networks, bases."""

from __future__ import annotations

import numpy as np
import pytest

from forms import KelvinVoigt, LinearElastic, Maxwell, Norton, Stack, VonMises
from forms.base import InputError
from geometry import sandwich
from tests.dry_walls import dry_wall
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
    wanted = np.tile([along, -0.3, out * along, 0, 0, 0], (len(stress), 1))
    assert stress == pytest.approx(wanted, rel=1e-6, abs=1e-8)


def test_bodies_of_revolution(written):
    """A rod under an axial load, sides on rollers: hoop stress as along r; weights of cell means are volumes."""
    rod = Structure(strips(), body=BODY, supports=ROLLERS, tractions={"TOP": (0.0, -0.3)}, plane="axisymmetric")
    found = written(solve(rod.interface(ThinLayer(K, EPS, at=1.0))))
    along = -0.3 * NU / (1 - NU)
    stress = found["bodies"]["stress"]
    assert stress == pytest.approx(np.tile([along, -0.3, along, 0, 0, 0], (len(stress), 1)), rel=1e-8, abs=1e-10)
    assert found["S"]["t_N"] == pytest.approx(-0.3, rel=1e-7)


@pytest.mark.parametrize("theta", [1.0, 0.5])
@pytest.mark.parametrize(
    "law",
    [KelvinVoigt(L, M, 0.3, 0.5), Maxwell(L, M, 0.7, 1.9), Norton(L, M, 3.0, 1.5)],
    ids=["KV", "Maxwell", "Norton"],
)
def test_stress_out_of_the_plane_of_laws_with_rates(written, law, theta):
    """Pressed between rollers, strained neither along S nor out of the plane: the stresses there are the same."""
    press = {"TOP": lambda x, t: (0.0, -0.3 * t)}
    structure = Structure(strips(), body={"LOWER": law, "UPPER": BODY}, supports=ROLLERS, tractions=press)
    found = written(march(structure.interface(ThinLayer(K, EPS, at=1.0)), [0.5, 1.0], theta=theta))["bodies"]
    stress = found["stress"][found["region"] == list(found.field_data["regions"]).index("LOWER")]
    assert stress[:, 1] == pytest.approx(-0.3, rel=1e-6)
    assert stress[:, 2] == pytest.approx(stress[:, 0], rel=1e-7)
    assert np.abs(stress[:, 0] / (-0.3 * NU / (1 - NU)) - 1).min() > 0.02  # not that of the spring
    if isinstance(law, KelvinVoigt) and theta == 1:  # (A + B/dt) e = sigma + B/dt e_old
        A, B, dt, e = L + 2 * M, 0.3 * L + 2 * 0.5 * M, 0.5, [0.0]
        for sigma in (-0.15, -0.3):
            e.append((sigma + B / dt * e[-1]) / (A + B / dt))
        assert stress[:, 2] == pytest.approx(L * e[2] + 0.3 * L * (e[2] - e[1]) / dt, rel=1e-7)


def test_stress_out_of_the_plane_of_a_stack():
    """In plane stress there is none, also in a sublayer whose plane stress is a closed form."""
    law, press = Stack((0.3, Maxwell(L, M, 0.7)), (0.7, LinearElastic(L, M))), {"TOP": lambda x, t: (0.0, -0.3 * t)}
    for plane in ("strain", "stress"):
        structure = Structure(strips(), body=BODY, supports=ROLLERS, tractions=press, plane=plane)
        stress = march(structure.interface(ThinLayer(law, EPS, at=1.0)), [0.5, 1.0]).last.stresses["layer"]
        assert stress[:, 1] == pytest.approx(-0.3, rel=1e-7)
        assert (stress[:, 2] < -0.05).all() if plane == "strain" else not stress[:, 2].any()


def test_two_points_through_a_layer_of_order_1(written):
    structure = Structure(strips(), body=BODY, supports=ROLLERS, tractions={"TOP": lambda x, t: (0.0, -0.3 * t)})
    law = VonMises(3.0, 2.0, strength=0.05, hardening=1.0)
    on_s = written(march(structure.interface(ThinLayer(law, EPS, order=1, at=1.0)), [0.5, 1.0]))["S"]
    names = {name for name in on_s.cell_data if name.startswith("plastic")}
    assert names == {"plastic 1", "plastic 2"}
    assert on_s["plastic 1"] == pytest.approx(on_s["plastic 2"], rel=1e-6)  # nothing changes along S
    assert np.abs(on_s["plastic 1"]).max() > 1e-4


def test_contact_on_several_seams(written):
    history = march(dry_wall(), [0.2])
    on_s = written(history)["S"]
    codes = {code.split(maxsplit=1)[1]: int(code.split()[0]) for code in on_s.field_data["contact codes"]}
    for number, name in enumerate(on_s.field_data["seams"]):
        report = Surface(history.last.model, str(name)).contact(history.last)
        part = on_s.extract_cells(on_s["seam"] == number)
        found = {name: int((part["contact"] == code).sum()) for name, code in codes.items()}
        corners = np.bincount(report.surface.nodes.ravel(), minlength=len(report.x))
        wanted = {status: int(corners[report.status == status].sum()) for status in codes}
        assert found == wanted
    assert (on_s["contact"] >= 0).all()


def test_bonded_bodies_have_an_s(written):
    structure = Structure(strips(), body=BODY, supports={"BOTTOM": 0.0}, tractions={"TOP": (0.1, -0.3)})
    on_s = written(solve(structure.bonded()))["S"]
    codes = {code.split(maxsplit=1)[1]: int(code.split()[0]) for code in on_s.field_data["status codes"]}
    assert set(on_s["status"]) == {codes["bonded"]}


def test_s_of_a_meshed_layer(tmp_path):
    """Brought to the S of an interface model: tractions and jumps as `Surface` has them; nothing of its laws there."""
    structure = Structure(strips(), body=BODY, supports={"BOTTOM": 0.0}, tractions={"TOP": (0.1, -0.3)})
    full, limit = solve(structure.full(ThinLayer(K, EPS, at=1.0))), structure.interface(ThinLayer(K, EPS, at=1.0))
    surface = Surface(limit)
    fields.write(full, tmp_path / "a.pvd", surface=surface)
    found = last(tmp_path / "a.pvd")
    assert found.keys() == ["bodies", "layer", "S"]
    on_s = found["S"]
    x, t = surface.profile(surface.traction(full))
    at = [np.linalg.norm(on_s.points[:, :2] - place, axis=1).argmin() for place in x]
    assert on_s["traction"][at, :2] == pytest.approx(t, rel=1e-9)
    force = on_s.integrate_data()["traction"][0, :2]
    assert force == pytest.approx([0.2, -0.6], rel=1e-9)
    assert list(on_s.cell_data) == ["seam"]
    other = Surface(Structure(strips(), body=BODY, supports={"BOTTOM": 0.0}).interface(ThinLayer(K, EPS, at=1.0)))
    for wrong, path in ((other, "a.pvd"), (surface, "a.bp")):
        with pytest.raises(InputError, match=r"for \.pvd files, and of an interface model of the same joint"):
            fields.write(full, tmp_path / path, surface=wrong)
    refused(InputError, "give Surface", lambda: fields.write(full, tmp_path / "a.pvd", surface=limit))
