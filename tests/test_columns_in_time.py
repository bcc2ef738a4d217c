"""Columns in time: the interface law and the meshed layer agree at every step of a march, turned and in three dimensions.

That both models agree says nothing of the law, which they share: each law has its closed form as well.
"""

from __future__ import annotations

import numpy as np
import pytest
import ufl

from forms import Stack
from geometry import sandwich
from tests.columns_in_time import LAWS, LOAD, TIMES, both, check_balance, check_same, column, joint
from tests.laws_at_points import KELVIN, MAXWELL_2
from thinlayer import Structure, ThinLayer, march

pytestmark = pytest.mark.few(10)


SANDWICHES = [(0.3, 1.0, "shear"), (1e-2, 0.5, "normal"), (1e-4, 1.0, "normal")]
COLUMNS = [*(("sandwich", *case) for case in SANDWICHES), ("block", 0.02, 0.5, "shear")]


@pytest.mark.parametrize(("kind", "eps", "theta", "mode"), COLUMNS)
@pytest.mark.parametrize("name", LAWS)
def test_both_models_agree_at_every_step(name, kind, eps, theta, mode):
    """Between bodies and on a rigid base: a sudden load that grows and turns, in steps of several lengths."""
    setup = column(mode, load=lambda t: LOAD[mode] * (1 + 3 * t) * ufl.cos(20 * t))
    if kind == "block":
        del setup["supports"]["BOTTOM"]
    theta = 1.0 if name == "user, not quadratic" else theta  # it answers at once, and not linearly
    limit, full = both(joint(kind), ThinLayer(LAWS[name], eps, at=1.0), setup, TIMES, theta=theta)
    check_same(limit, full)
    for history in (limit, full):
        check_balance(history)
        assert np.isfinite(history.table["stored"]).all()


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
