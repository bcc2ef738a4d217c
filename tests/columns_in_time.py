"""Columns in time: uniform strain in each body and in the layer, so that both models agree at every step of a march.

Bodies are 0.5 high, E = 100, nu = 0.3. A column is pulled (sides u_T = 0) or sheared (sides u_n = 0).
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from forms import BulkLaw, Incompressible, LinearElastic, Stack
from geometry import block, sandwich
from tests.laws_at_points import LAWS as OF_POINTS
from tests.laws_at_points import LMBDA, MU, NORTON_15, STIFF
from thinlayer import Structure, Surface, ThinLayer, march
from thinlayer.discretisation.state import displacements_of
from thinlayer.solving.history import History

BODY = LinearElastic.young(100.0, 0.3)
K = {"normal": LMBDA + 2 * MU, "shear": MU}
C = {"normal": 1 / (BODY.lmbda + 2 * BODY.mu), "shear": 1 / BODY.mu}  # compliance of both bodies together
G = {"normal": LMBDA * 0.3 + 2 * MU * 0.5, "shear": MU * 0.5}
T1, T2 = 0.7, 1.5
AXIS, LOAD, MOVE = {"normal": 1, "shear": 0}, {"normal": 1.0, "shear": 0.5}, {"normal": 0.02, "shear": 0.05}

TAKEN = ("Norton's creep", "Kelvin-Voigt", "Maxwell t1 != t2", "Norton 1.5", "Norton 3", "user", "user, not quadratic")
LAWS = {name: OF_POINTS[name] for name in (*TAKEN, "Maxwell, Kelvin-Voigt")} | {
    "elastic, Norton 1.5": Stack((0.4, STIFF), (0.6, NORTON_15)),
    "incompressible": Incompressible(MU),
}
EXACT = 1e-9  # relative: MUMPS on cells as flat as 1e-4, Newton's method to 1e-10 of the forces
TIMES = [0.02, 0.05, 0.1]


def column(mode: str, **ends) -> dict:
    """Data of a column: `load` is the traction on top, or `move` the displacement of the top."""
    across, axis = "xy"[1 - AXIS[mode]], "xy"[AXIS[mode]]
    side = "x" if mode == "normal" else "y"
    top = {across: 0.0}
    tractions = {}
    if "move" in ends:
        top[axis] = ends["move"]
    else:
        load = ends["load"]
        vector = lambda value: (0.0, value) if mode == "normal" else (value, 0.0)
        tractions["TOP"] = (lambda x, t: vector(load(t))) if callable(load) else vector(load)
    supports = {"BOTTOM": 0.0, "LEFT": {side: 0.0}, "RIGHT": {side: 0.0}, "TOP": top}
    return {"body": BODY, "supports": supports, "tractions": tractions}


@cache
def joint(kind: str = "sandwich"):
    if kind == "block":
        return block(1.0, 0.5, 0.5, structured=True)
    return sandwich(1.0, 0.5, 0.5, 0.5, structured=True)


def check_same(limit: History, full: History, exact: float = EXACT) -> None:
    """Displacements of the bodies and energies at every step; jump and traction at the last one."""
    surface = Surface(limit.model)
    assert limit.t == pytest.approx(full.t)
    largest = max(np.abs(state.u.x.array).max() for state in limit)
    assert largest > 0
    for state, other in zip(limit, full, strict=True):
        assert np.abs(displacements_of(other, limit.model).x.array - state.u.x.array).max() < exact * largest, state.t
    energies = np.abs(limit.table["supplied"]).max()
    for name in ("supplied", "stored", "dissipated", "remainder"):
        assert full.table[name] == pytest.approx(limit.table[name], abs=exact * energies), name
    t = surface.traction(limit.last)
    assert surface.norm(surface.traction(full.last) - t) < exact * surface.norm(t)
    jump = surface.jump(limit.last)
    assert surface.norm(surface.jump(full.last) - jump) < exact * max(surface.norm(jump), 1e-3 * largest)


def check_balance(history: History) -> None:
    assert np.abs(history.table["imbalance"]).max() < 1e-10


def both(where, layer: ThinLayer, setup: dict, times, **options) -> tuple[History, History]:
    columns = Structure(where, **setup)
    models = columns.interface(layer), columns.full(layer, cells_through=1)
    return march(models[0], times, **options), march(models[1], times, **options)


def jump_of(history: History, mode: str, state=None) -> float:
    surface = Surface(history.model)
    return surface.integral(surface.jump(state or history.last)[AXIS[mode]])


def marched(law: BulkLaw, mode: str, theta: float, times, **ends) -> History:
    return march(Structure(joint(), **column(mode, **ends)).interface(ThinLayer(law, 0.1, at=1.0)), times, theta=theta)
