"""Structures whose fields are known."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from forms import IncrementalCoulomb, LinearElastic, MohrCoulombMonodirectional
from geometry import block, bond_cell, sandwich, wall
from thinlayer import Structure, ThinLayer, fields, march, solve

BODY = LinearElastic(lmbda=60.0, mu=40.0)
EPS, K = 0.1, LinearElastic(lmbda=3.0, mu=2.0)  # parameters per thickness: K_T = 2, K_N = 7
SIZE = {2: (2.0, 1.2), 3: (2.0, 1.2, 1.0)}  # width, height, depth
DIM = {2: {}, 3: {"depth": 1.0}}
ANGLE = 0.4
STRESS = {  # in the turned axes: along S, across it, out of the plane; tractions are its second row
    2: np.array([[0.7, -0.3], [-0.3, 0.5]]),
    3: np.array([[0.7, -0.3, 0.1], [-0.3, 0.5, 0.25], [0.1, 0.25, -0.2]]),
}

CASES = [(2, "triangle", "P1"), (2, "quadrilateral", "S2"), (3, "hexahedron", "Q1"), (3, "tetrahedron", "P2")]


def axes(d: int) -> np.ndarray:
    """Rows: the turned axes."""
    c, s = np.cos(ANGLE), np.sin(ANGLE)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])[:d, :d]


def uniform(
    d: int = 2, cell: str | None = None, element: str | None = None
) -> tuple[Structure, np.ndarray, np.ndarray]:
    """Turned blocks moved at all their sides so that stresses are uniform at t = 1, and proportional to t; stress, jump."""
    chosen = {} if cell is None else {"cell": cell}
    joint = sandwich(2.0, 0.5, 0.7, 0.5, structured=True, **DIM[d], **chosen).rotated(ANGLE)
    stress = axes(d).T @ STRESS[d] @ axes(d)
    mean = np.trace(stress) / (2 * BODY.mu + d * BODY.lmbda)  # plane strain has no third strain
    strain = (stress - BODY.lmbda * mean * np.eye(d)) / (2 * BODY.mu)
    t = STRESS[d][1]
    across = np.full(d, K.mu)
    across[1] = K.lmbda + 2 * K.mu
    jump = (t / across) @ axes(d)

    def moved(k, w, x, time):
        return time * (sum(strain[k, i] * x[i] for i in range(d)) + w[k])

    supports = {}
    for region, w in (("LOWER", np.zeros(d)), ("UPPER", jump)):
        for side in ("LEFT", "RIGHT", "FRONT", "BACK")[: 2 * (d - 1)]:
            supports[f"{side}/{region}"] = {"xyz"[k]: partial(moved, k, w) for k in range(d)}
    supports["BOTTOM"] = {"xyz"[k]: partial(moved, k, np.zeros(d)) for k in range(d)}
    supports["TOP"] = {"xyz"[k]: partial(moved, k, jump) for k in range(d)}
    return Structure(joint, body=BODY, supports=supports, element=element), stress, jump


def slipping(kind: str = "interface", law: object = None):
    """A layer that slips, between blocks that are pressed and sheared."""
    law = law or MohrCoulombMonodirectional(3.0, 2.0, cohesion=0.05, friction_angle=20.0, elastic_fraction=0.1)
    joint = sandwich(2.0, 0.5, 0.7, 0.5, h_S=0.25)
    structure = Structure(joint, body=BODY, supports={"BOTTOM": 0.0, "TOP": {"x": lambda x, t: 0.4 * t, "y": -0.05}})
    return march(getattr(structure, kind)(ThinLayer(law, EPS, at=1.0)), [0.5, 1.0])


def network():
    """Bricks in running bond, their beds slipping."""
    bed = MohrCoulombMonodirectional(30.0, 20.0, cohesion=0.01, friction_angle=20.0, elastic_fraction=0.1)
    layers = {"BED": ThinLayer(bed, 0.1, at=1.0), "HEAD": ThinLayer(LinearElastic(3.0, 2.0), 0.1, at=1.0)}
    loads = {"TOP": lambda x, t: (0.05 * t, -0.1)}
    panel = Structure(wall(2, 3, (2.0, 1.0), h=0.5), body=BODY, supports={"BOTTOM": 0.0}, tractions=loads)
    return march(panel.interface(layers), [0.5, 1.0])


def on_a_base():
    """A bar pushed along a rigid base, with friction and memory, in 3D."""
    joint, loads = block(2.0, 1.0, 0.5, depth=1.0, cell="hexahedron"), {"LEFT": (0.8, 0, 0), "TOP": (0, -0.5, 0.1)}
    bar = Structure(joint, body=BODY, supports={"RIGHT": {"x": 0.0}, "BACK": {"z": 0.0}}, tractions=loads, element="Q1")
    return march(bar.interface(IncrementalCoulomb(K_N=90.0, K_T=30.0, friction=0.4)), [1.0])


def cell():
    """A periodic cell of a wall under a mean strain."""
    whole = Structure(bond_cell((2.0, 1.0), 0.5), body=BODY, supports={}, strain=((0.01, 0.004), (0.004, -0.02)))
    return solve(whole.interface({"BED": ThinLayer(K, 0.1, at=1.0), "HEAD": ThinLayer(K, 0.1, at=1.0)}))


def write_all(out: Path) -> None:
    solid = uniform(3, cell="hexahedron", element="Q1")[0]
    fields.write(solve(solid.full(ThinLayer(K, EPS, at=1.0), cells_through=1)), out / "full.pvd")
    for name, make in {"network": network, "base": on_a_base, "cell": cell}.items():
        fields.write(make(), out / f"{name}.pvd")
