"""Columns in time: the interface law and the meshed layer agree at every step of a march, turned and in three dimensions.

That both models agree says nothing of the law, which they share: each law has its closed form as well.
"""

from __future__ import annotations

import numpy as np
import pytest
import ufl

from forms import Stack
from geometry import sandwich
from tests import closed_forms
from tests.columns_in_time import BODY, EXACT, LAWS, LOAD, TIMES, both, check_balance, check_same, column, joint
from tests.laws_at_points import KELVIN, LMBDA, MAXWELL_2, MU, NORTON_3
from tests.own_laws import Hardening
from thinlayer import Structure, Surface, ThinLayer, drive, march

pytestmark = pytest.mark.few(10)


@pytest.mark.parametrize(
    ("kind", "eps", "theta", "mode"),
    [
        ("sandwich", 0.3, 1.0, "shear"),
        ("sandwich", 0.3, 0.5, "normal"),
        ("sandwich", 1e-2, 1.0, "normal"),
        ("sandwich", 1e-2, 0.5, "shear"),
        ("sandwich", 1e-4, 1.0, "shear"),
        ("sandwich", 1e-4, 0.5, "normal"),
        ("block", 0.02, 0.5, "shear"),
        ("block", 0.02, 0.5, "normal"),
    ],
)
@pytest.mark.parametrize("name", LAWS)
def test_both_models_agree_at_every_step(name, kind, eps, theta, mode):
    """Between bodies and on a rigid base: a load that is sudden and then grows, in steps of several lengths."""
    setup = column(mode, load=lambda t: LOAD[mode] * (1 + 3 * t))
    if kind == "block":
        del setup["supports"]["BOTTOM"]
    limit, full = both(joint(kind), ThinLayer(LAWS[name], eps, at=1.0), setup, TIMES, theta=theta)
    check_same(limit, full)
    for history in (limit, full):
        check_balance(history)
        assert np.isfinite(history.table["stored"]).all()


@pytest.mark.parametrize(
    ("law", "mode", "eps"),
    [
        (MAXWELL_2, "shear", 0.02),
        (NORTON_3, "shear", 0.02),
        (LAWS["Maxwell, Kelvin-Voigt"], "shear", 0.02),
        (Hardening(LMBDA, MU), "normal", 0.3),  # knows closing from opening
    ],
    ids=["Maxwell t1 != t2", "Norton 3", "Maxwell, Kelvin-Voigt", "user, closing"],
)
def test_moved_end(law, mode, eps):
    """The top is moved back and forth: loading, unloading, reversal."""
    setup = column(mode, move=lambda x, t: 0.05 * ufl.cos(20 * t))
    limit, full = both(joint(), ThinLayer(law, eps, at=1.0), setup, np.linspace(0, 0.3, 7)[1:])
    check_same(limit, full)
    for history in (limit, full):
        check_balance(history)


ANGLE = 0.4
TRACTION = np.array([0.3, -0.8])


@pytest.mark.few(5)
@pytest.mark.parametrize("name", ["Kelvin-Voigt", "Maxwell t1 != t2", "Norton 1.5"])
def test_any_direction(name):
    """A column at an angle, pulled and sheared at once; the tractions on its sides follow the stresses of the layer."""
    turn = np.array([[np.cos(ANGLE), -np.sin(ANGLE)], [np.sin(ANGLE), np.cos(ANGLE)]])
    n, tangent, t = turn @ [0.0, 1.0], turn @ [1.0, 0.0], turn @ TRACTION
    law, times = LAWS[name], [0.0, *TIMES]
    lengths = np.diff(times) if law.traits.rate else [0.0, *np.diff(times)]
    point = drive(law, [{"t_T": TRACTION[0], "t_N": TRACTION[1]}] * len(lengths), n, dt=lengths)
    jumps, stresses = point.jumps @ turn.T, point.stress[:, :2, :2]
    if law.traits.rate:  # at rest at first
        jumps, stresses = (np.concatenate([0 * one[:1], one]) for one in (jumps, stresses))

    def side(sign):
        """The polynomial in t through the tractions at the ends of the steps."""
        powers = np.linalg.solve(np.vander(times, increasing=True), [sign * s @ tangent for s in stresses])
        return lambda x, time: sum(row * time**k for k, row in enumerate(map(ufl.as_vector, powers.tolist())))

    a = np.linalg.solve(closed_forms.elastic_stiffness(BODY.lmbda, BODY.mu, n), t)
    e = (np.outer(a, n) + np.outer(n, a)) / 2
    body = BODY.lmbda * np.trace(e) * np.eye(2) + 2 * BODY.mu * e
    tractions = {"TOP": tuple(t)}
    for edge, sign in (("LEFT", -1), ("RIGHT", 1)):
        tractions |= {f"{edge}/{region}": tuple(sign * body @ tangent) for region in ("LOWER", "UPPER")}
        tractions[f"{edge}/LAYER"] = side(sign)
    setup = {"body": BODY, "supports": {"BOTTOM": 0.0}, "tractions": tractions}
    limit, full = both(joint().rotated(ANGLE), ThinLayer(law, 0.05, at=1.0), setup, TIMES)
    check_same(limit, full)
    surface = Surface(limit.model)
    for state, w in zip(limit, jumps, strict=True):
        difference = surface.jump(state) - np.reshape(w, (-1, 1, 1))
        assert surface.norm(difference) < EXACT * np.linalg.norm(jumps[-1])


@pytest.mark.few(5)
@pytest.mark.parametrize(("cell", "mode"), [("hexahedron", "normal"), ("tetrahedron", "shear")])
def test_three_dimensions(cell, mode):
    """A law with memory of the whole stress, rate and layers in series; as in two dimensions."""
    where = sandwich(1.0, 0.5, 0.5, 0.5, depth=0.5, cell=cell, structured=True)
    law = Stack((0.5, MAXWELL_2), (0.5, KELVIN))
    setup = column(mode, load=LOAD[mode])
    plane = setup["supports"]
    sides = {"normal": {"z": 0.0}, "shear": {"y": 0.0, "z": 0.0}}[mode]
    plane |= {"BACK": sides, "FRONT": sides, "TOP": plane["TOP"] | {"z": 0.0}}
    if mode == "shear":
        plane |= {edge: sides for edge in ("LEFT", "RIGHT")}
    setup["tractions"] = {"TOP": (*setup["tractions"]["TOP"], 0.0)}
    limit, full = both(where, ThinLayer(law, 0.05, at=1.0), setup, TIMES)
    check_same(limit, full)
    check_balance(full)
    flat = march(Structure(joint(), **column(mode, load=LOAD[mode])).interface(ThinLayer(law, 0.05, at=1.0)), TIMES)
    assert limit.table["supplied"] == pytest.approx(0.5 * flat.table["supplied"], rel=1e-9, abs=1e-15)
