"""Columns in time: the interface law and the meshed layer agree at every step of a march, turned and in three dimensions.

That both models agree says nothing of the law, which they share: each law has its closed form as well.
"""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from mpi4py import MPI

from forms import BulkLaw, Stack
from geometry import sandwich
from tests import closed_forms
from tests.columns_in_time import BODY, EXACT, LAWS, LOAD, TIMES, both, check_balance, check_same, column, joint
from tests.laws_at_points import KELVIN, LMBDA, MAXWELL_2, MU, NORTON_3
from tests.own_laws import Hardening
from thinlayer import Structure, Surface, ThinLayer, march
from thinlayer.pointwise.material import Material

pytestmark = pytest.mark.few(5)


@pytest.mark.parametrize(
    ("eps", "theta", "mode"),
    [
        (0.3, 1.0, "shear"),
        (0.3, 0.5, "normal"),
        (1e-2, 1.0, "normal"),
        (1e-2, 0.5, "shear"),
        (1e-4, 1.0, "shear"),
        (1e-4, 0.5, "normal"),
    ],
)
@pytest.mark.parametrize("name", LAWS)
def test_both_models_agree_at_every_step(name, eps, theta, mode):
    """A load that is sudden and then grows, in steps of several lengths."""
    setup = column(mode, load=lambda t: LOAD[mode] * (1 + 3 * t))
    limit, full = both(joint(), ThinLayer(LAWS[name], eps, at=1.0), setup, TIMES, theta=theta)
    check_same(limit, full)
    for history in (limit, full):
        check_balance(history)
        assert np.isfinite(history.table["stored"]).all()


@pytest.mark.parametrize("name", LAWS)
def test_rigid_base(name):
    mode = "normal" if name in ("Maxwell t1 != t2", "user", "elastic, Norton 1.5") else "shear"
    setup = column(mode, load=lambda t: LOAD[mode] * (1 + 3 * t))
    del setup["supports"]["BOTTOM"]
    limit, full = both(joint("block"), ThinLayer(LAWS[name], 0.02, at=1.0), setup, TIMES, theta=0.5)
    check_same(limit, full)
    for history in (limit, full):
        check_balance(history)


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


def held_traction(law: BulkLaw, t: np.ndarray, n: np.ndarray, times: list[float]) -> tuple[list, list]:
    """Jumps and stresses (2, 2) of a layer under a traction that is held, step by step at one point."""
    material, n3 = Material(MPI.COMM_SELF, law), np.append(n, 0.0)[None]
    slots, root = [0, 1, 3], 2**0.5
    contract = np.array([[n[0], 0], [0, n[1]], [n[1] / root, n[0] / root]])  # w -> strain, and its transpose
    w, e, q = np.zeros(2), np.zeros((1, 3)), np.zeros((1, material.memory))
    jumps, stresses = [w], [np.zeros((2, 2))]
    for dt in np.diff(times) if law.traits.rate else [0.0, *np.diff(times)]:
        old = e
        for _ in range(50):
            e = (contract @ w)[None]
            s, tangent, new, _, failed = material.update(slots, e, old, q, n3, dt, 1.0)
            assert failed == 0
            w = w + np.linalg.solve(contract.T @ tangent[0] @ contract, t - contract.T @ s[0, slots])
        q = new
        jumps.append(w)
        stresses.append(np.array([[s[0, 0], s[0, 3] / root], [s[0, 3] / root, s[0, 1]]]))
    return (jumps, stresses) if law.traits.rate else (jumps[1:], stresses[1:])


@pytest.mark.few(5)
@pytest.mark.parametrize("name", ["Kelvin-Voigt", "Maxwell t1 != t2", "Norton 1.5"])
def test_any_direction(name):
    """A column at an angle, pulled and sheared at once; the tractions on its sides follow the stresses of the layer."""
    turn = np.array([[np.cos(ANGLE), -np.sin(ANGLE)], [np.sin(ANGLE), np.cos(ANGLE)]])
    n, tangent, t = turn @ [0.0, 1.0], turn @ [1.0, 0.0], turn @ TRACTION
    law, times = LAWS[name], [0.0, *TIMES]
    jumps, stresses = held_traction(law, t, n, times)

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
