"""Mechanics of masonry: panels whose mortar yields, by both models, and what happens in each layer."""

from __future__ import annotations

from dataclasses import replace
from math import cos, radians, sin, tan

import numpy as np
import pytest

from forms import LinearElastic, MohrCoulomb, MohrCoulombMonodirectional
from forms.base import InputError
from geometry import sandwich
from tests.meshed_cases import bricks, inner, mortar, panel
from tests.network_cases import springs
from tests.pictures import assert_coloured, assert_drawn
from tests.refused import refused
from tests.test_networks import cut_at, on
from thinlayer import LimitLoad, Structure, Surface, ThinLayer, march, plotting, solve

pytestmark = pytest.mark.few(5)

FAR = 0.2  # from junctions and ends: a traction of degree 1 takes their values one cell (0.125) farther
STEPS = 1 / 1024  # of the last planned step, to which a limit is found


# ---------------------------------------------------------------- panels, meshed and not
def test_tractions_of_a_panel():
    """Away from junctions they differ by O(eps), as the numbers of an independent program for nodal reactions do."""
    structure = panel("P2")
    surface = Surface(structure.interface(mortar(0.01)))
    by_law, errors, part = surface.traction(solve(surface.model, 1.0)), [], inner(surface, FAR)
    for eps in (0.02, 0.01, 0.005):
        t = surface.traction(solve(structure.full(mortar(eps)), 1.0))
        errors.append(surface.norm(t - by_law, part) / surface.norm(by_law, part))
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert ((orders > 0.9) & (orders < 1.1)).all()
    assert errors == pytest.approx([4.3e-3, 2.2e-3, 1.15e-3], rel=0.1)  # theirs fall with orders 1.01, .98


def limit_of(structure: Structure, layers, want: float) -> LimitLoad:
    limit = refused(LimitLoad, "", march, structure.interface(layers), [0.5 * want, 0.9 * want, 1.2 * want])
    assert limit.t <= want * (1 + 1e-12)
    assert limit.failed_at == pytest.approx(want, rel=STEPS)
    return limit


def test_limit_of_a_sheared_panel():
    """That of its bed, C cos(Omega) + sin(Omega) p, which gives way, not its heads."""
    p, C, angle = 0.02, 0.02, radians(30.0)
    bed = MohrCoulomb(0.6, 0.7, cohesion=C, friction_angle=30.0)
    head = MohrCoulomb(0.3, 0.45, cohesion=C / 2, friction_angle=30.0)
    data = {"body": LinearElastic.young(1.0, 0.2), "tractions": {"TOP": lambda x, t: (t, -p)}, "element": "Q1"}
    structure = Structure(bricks("quadrilateral", 0.25), supports={"BOTTOM": 0.0}, **data)
    layers = {"BED": ThinLayer(bed, 0.01, at=1.0), "HEAD": ThinLayer(head, 0.01, at=1.0)}
    limit = limit_of(structure, layers, C * cos(angle) + sin(angle) * p)
    assert limit.shares == pytest.approx({"BED": 1.0, "HEAD": 0.0}, abs=1e-3)
    assert ", with jumps at the seams 'BED' 100%. The states before" in str(limit)


def test_limit_of_a_pulled_panel():
    """A head of each course opens, and the bed between slides along half a brick."""
    C, cohesion, share = 0.02, 0.002, 0.5 / 1.0  # half a brick over the height of two courses
    bed = ThinLayer(MohrCoulomb(0.6, 0.7, cohesion=C, friction_angle=0.0), 0.01, at=1.0)
    head = ThinLayer(MohrCoulomb(0.3, 0.45, cohesion=cohesion, friction_angle=30.0), 0.02, at=1.0)
    want = share * C + cohesion / tan(radians(30.0))  # the apex of its yield surface
    supports = {"BOTTOM": {"y": 0.0}, "LEFT": {"x": 0.0}}
    data = {"body": LinearElastic.young(10.0, 0.2), "tractions": {"RIGHT": lambda x, t: (t, 0.0)}, "element": "Q1"}
    structure = Structure(bricks("quadrilateral", 0.25), supports=supports, **data)
    limit = limit_of(structure, {"BED": bed, "HEAD": head}, want)
    opened, slid = 1.0, 0.5 / 2  # lengths of two heads and half a brick; of a jump along S the strain squared is a half
    shares = {"HEAD": opened / (opened + slid), "BED": slid / (opened + slid)}
    assert limit.shares == pytest.approx(shares, abs=3e-3)  # the bricks are not rigid
    assert list(limit.shares) == ["HEAD", "BED"]


# ---------------------------------------------------------------- what happens in each layer
FULL = MohrCoulomb(0.0, 2.0, cohesion=0.1, friction_angle=30.0)
SLIPS = MohrCoulombMonodirectional(1.0, 2.0, cohesion=0.1, friction_angle=30.0, unilateral=True)


STATUSES = [
    (FULL, (0.15, -0.2), "sliding"),  # its slip is twice a strain, 0.15 to 0.1
    (FULL, (0.0, -0.05), "elastic"),
    (FULL, (0.0, -0.2), "crushed"),  # yields where mu e > C cos(Omega) + mu e sin(Omega), e = 0.0866
    (FULL, (0.0, 0.5), "torn"),
    (FULL, (0.4, -0.05), "sliding"),
    (SLIPS, (0.0, -0.2), "elastic"),
    (SLIPS, (0.4, -0.1), "sliding"),
    (SLIPS, (0.0, 0.2), "open"),
    (LinearElastic(1.0, 2.0), (0.4, 0.2), "elastic"),
    (None, (0.4, 0.2), "no layer"),
]


@pytest.mark.parametrize(("law", "move", "status"), STATUSES)
def test_status(law, move, status):
    """Of a layer between stiff blocks, one of which is moved; beside it an elastic one."""
    cuts = {"LOW": (on(1, -1.0), (0, 1)), "HIGH": (on(1, 2.0), (0, -1))}
    joint = cut_at(sandwich(2.0, 4.0, 4.0, 1.0, cell="quadrilateral"), cuts)
    supports = {"BOTTOM": 0.0, "TOP": {"x": lambda x, t: move[0] * t, "y": lambda x, t: move[1] * t}}
    structure = Structure(joint, body=LinearElastic(0.0, 1e5), supports=supports, element="Q1")
    layers = {"LOW": springs(3e4, 1e4), "HIGH": None if law is None else ThinLayer(law, 0.1, at=1.0)}
    last = march(structure.interface(layers), [0.5, 1.0]).last
    surface = Surface(last.model)
    statuses = surface.status(last)[:, 0]
    assert set(statuses[surface.seams == "HIGH"]) == {status}
    assert set(statuses[surface.seams == "LOW"]) == {"elastic"}
    assert Surface(last.model, "HIGH").table(last)[status] == pytest.approx(1.0)
    assert surface.table(last)["size"] == pytest.approx(2.0)


def test_status_along_a_seam(tmp_path):
    """A block that is tilted opens on the left of where it turns."""
    joint = sandwich(4.0, 1.0, 1.0, 0.5, cell="triangle")
    supports = {"BOTTOM": 0.0, "TOP": {"x": 0.0, "y": lambda x, t: 0.1 * t * (1.2 - x[0])}}
    structure = Structure(joint, body=LinearElastic(0.0, 1e5), supports=supports, element="P1")
    state = march(structure.interface(ThinLayer(replace(SLIPS, cohesion=0.6), 0.1, at=1.0)), [1.0]).last
    surface = Surface(state.model)
    open_ = surface.status(state) == "open"
    assert np.array_equal(open_[:, 0], surface.x[0].mean(axis=1) < 1.0)
    assert surface.integral(open_) == pytest.approx(1.0)
    assert surface.table(state).rows == [{"seam": "S", "size": pytest.approx(4.0), "elastic": pytest.approx(0.75),
                                          "open": pytest.approx(0.25), "sliding": 0, "crushed": 0, "torn": 0}]  # fmt: skip
    states, view = {"tilted": state, "again": state}, plotting.View(scale=1.0)
    assert_coloured(plotting.on_surface(states, Surface.status, view, save=tmp_path / "a.png"), {"elastic", "open"})
    assert_drawn(tmp_path / "a.png")
    refused(InputError, "scale is 'x'", lambda: plotting.View(scale="x"))
    assert set(surface.status(solve(structure.bonded(), 1.0)).ravel()) == {"bonded"}
