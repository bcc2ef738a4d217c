"""What holds of any structure and law, for random ones: few in each run, many with --hypothesis-profile=random."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forms import KelvinVoigt, LinearElastic, Maxwell, MohrCoulomb, Norton, NortonCreep, Stack, VonMises
from geometry import read, sandwich
from tests.meshes import GRID, QUADS, write
from thinlayer import Structure, ThinLayer, drive, march, solve

some = settings(max_examples=3 if settings().derandomize else 60)
sizes = st.floats(0.3, 3.0)
jumps = st.lists(st.floats(-0.05, 0.05), min_size=2, max_size=2).map(lambda w: np.round(w, 7))
SOFT, STIFF = LinearElastic(3.0, 2.0), LinearElastic.young(80.0, 0.3)
BODIES = {"LOW": STIFF, "UP": LinearElastic.young(50.0, 0.1)}
LOADS = {"TOP": np.array([0.3, 1.0]), "SIDE": np.array([-0.2, 0.7])}
FACETS = {"S": [[3, 4], [4, 5]], "TOP": [[6, 7], [7, 8]], "BED": [[0, 1], [1, 2]], "SIDE": [[2, 5], [5, 8]]}
NAMES = {name: (number, 1) for number, name in enumerate(FACETS, 1)} | {"LOW": (1, 2), "UP": (2, 2)}


# ---------------------------------------------------------------- structures
@some
@given(seed=st.integers(0, 2**32 - 1))
def test_numbers_places_units_and_orders_do_not_matter(tmp_path_factory, seed):
    """Of nodes, of cells and their corners, of loads and bodies; thicknesses of which a law's moduli are."""
    random, path = np.random.default_rng(seed), tmp_path_factory.mktemp("joint") / "a.msh"
    (eps, at, scale), angle, flip = random.uniform(0.3, 3.0, 3), random.uniform(-np.pi, np.pi), random.choice([-1, 1])
    points = GRID + random.uniform(-0.1, 0.1, (9, 2)) * (GRID[:, 1:] != 0)  # S stays straight

    def works(points, nodes, quads, regions, layer, loads, bodies, scale):
        """Of the loads, in the interface and in the full model."""
        blocks = [*(("line", nodes[rows]) for rows in FACETS.values()), ("quad", nodes[quads])]
        write(path, points, blocks, [[1, 1], [2, 2], [3, 3], [4, 4], regions], NAMES)
        structure = Structure(read(path, upper="UP", scale=scale), body=bodies, supports={"BED": 0.0}, tractions=loads)
        return [solve(model).load_work() for model in (structure.interface(layer), structure.full(layer))]

    scaled_law = LinearElastic(SOFT.lmbda * eps / at, SOFT.mu * eps / at)
    expected = works(points, np.arange(9), QUADS, [1, 1, 2, 2], ThinLayer(scaled_law, 0.1 * eps), LOADS, BODIES, 1.0)
    nodes, cells = random.permutation(9), random.permutation(4)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) * [flip, 1]
    placed, loads = np.empty_like(points), {name: turn @ LOADS[name] for name in ("SIDE", "TOP")}
    placed[nodes] = points @ turn.T + (5.0, -3.0)
    quads = np.array([np.roll(quad, random.integers(4))[:: random.choice([-1, 1])] for quad in QUADS[cells]])
    bodies, layer = dict(reversed(BODIES.items())), ThinLayer(SOFT, 0.1 * eps * scale, at=0.1 * at * scale)
    values = works(placed, nodes, quads, cells // 2 + 1, layer, loads, bodies, scale)
    assert values == pytest.approx(np.multiply(expected, scale**2), rel=1e-8)  # rounding, of layers 1e3 times softer


# ---------------------------------------------------------------- laws
LAWS = {
    "stack": lambda a, b: Stack((0.3, LinearElastic(a, b)), (0.7, VonMises(b, a, strength=0.05))),
    "kelvin": lambda a, b: KelvinVoigt(a, b, theta_lmbda=0.3, theta_mu=b),
    "maxwell": lambda a, b: Maxwell(a, b, t1=b),
    "norton": lambda a, b: Norton(a, b, eta=b, p=1.5),
    "creep": lambda a, b: NortonCreep(a, b, A=a, n=3.0),
    "von mises": lambda a, b: VonMises(a, b, strength=0.05 * a, kinematic=0.1 * b),
    "mohr-coulomb": lambda a, b: MohrCoulomb(a, b, cohesion=0.02 * b, friction_angle=30.0, elastic_fraction=0.1),
}


@pytest.mark.parametrize("name", LAWS)
@some
@given(a=sizes, b=sizes, path=st.lists(jumps, max_size=2), jump=jumps, other=jumps)
def test_a_larger_jump_needs_a_larger_traction(name, a, b, path, jump, other):
    """A step of a law without softening, whose flow is associated, has a convex potential, whatever was before."""
    law = LAWS[name](a, b)
    steps = [[{"w_T": w[0], "w_N": w[1]} for w in (*path, last)] for last in (jump, other)]
    t, u = (drive(law, each, dt=0.3).tractions[-1] for each in steps)
    rounding = 1e-9 * (np.linalg.norm(t) + np.linalg.norm(u)) * np.linalg.norm(jump - other)
    assert (t - u) @ (jump - other) >= -rounding  # tractions are found to 1e-12 of moduli


# ---------------------------------------------------------------- memory
def memory():
    """What the process has of the memory, in MB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


@pytest.mark.long
def test_memory_stays_flat():
    """After 100 of 300 models by less than 0.1 MB a model, of the 1 MB that each has; after 50 of 500 steps by 2 MB."""

    def model(k, law=SOFT):
        loads = {"TOP": lambda x, t: (0.1 * t, 1.0 + t)}
        joint = sandwich(2.0, 1.0, 1.0 + 1e-3 * k, 0.25)
        structure = Structure(joint, body=STIFF, supports={"BOTTOM": 0.0}, tractions=loads)
        return (structure.interface if k % 3 else structure.full)(ThinLayer(law, 0.1, at=1.0))

    used = [memory() for k in range(300) if solve(model(k))]
    assert used[-1] - used[100] < 20.0
    viscous = model(1, KelvinVoigt(60.0, 40.0, theta_lmbda=0.3, theta_mu=0.5))
    history = march(viscous, np.arange(1, 501) / 500, keep="last", observe={"memory": lambda state: memory()})
    assert history.table["memory"][-1] - history.table["memory"][50] < 2.0
