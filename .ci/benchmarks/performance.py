"""Benchmark: cost of laws on S against bonded bodies, meshed layers and other programs; cost of friction."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from operator import itemgetter
from pathlib import Path

import numpy as np

import thinlayer
from forms import IncrementalCoulomb, LinearElastic, NonMonotone, VonMises
from geometry import sandwich
from geometry.joint import Joint
from studies.by_hand import CHOLESKY, K_N, K_T, LOAD, MULTIGRID, E, by_hand
from studies.friction_cost import WORKS, friction
from studies.other_programs import MODULES, ngsolve, scikit_fem
from studies.problems import SNAP_LAW_ARGS, SUPPORTS, top_loaded
from studies.timing import Stages, check_ratios, compared, in_turn, timed, timed_in_turn
from thinlayer import ArcLength, Bond, SolveError, Structure, ThinLayer, estimate, goals, march, solve
from thinlayer.discretisation.coefficient import LoadInput
from thinlayer.discretisation.layer import SurfaceLaw
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.running.record import Record
from thinlayer.solving.history import History
from thinlayer.system.progress import logger
from thinlayer.system.table import Row

SIZES = {2: (70, 222, 700), 3: (14, 32, 46)}  # dimension -> cells along: about 1e4, 1e5 and 1e6 unknowns, 3e5 in 3D
QUICK = {2: (70,), 3: (10,)}
SOLVERS = {"direct": {"pc_type": "cholesky"}, "iterative": {"pc_type": "gamg"}}
BY_HAND = {"direct": CHOLESKY, "iterative": MULTIGRID}
# name -> its work, largest numbers of cells along a side with a reasonable time, limits of ratios for the largest mesh
PROGRAMS: dict[str, tuple[Callable[..., dict[str, float]], dict[tuple[int, str], int], dict[int, float]]] = {
    "script by hand": (by_hand, {(dim, kind): SIZES[dim][-1] for dim in SIZES for kind in SOLVERS}, {2: 1.0, 3: 1.05}),
    "NGSolve": (ngsolve, {(2, "direct"): 700, (3, "iterative"): 46}, {2: 0.5, 3: 0.5}),
    "scikit-fem": (scikit_fem, {(2, "direct"): 222, (3, "direct"): 14}, {}),
}
BEST = {2: "direct", 3: "iterative"}  # dimension -> the faster solver for the largest mesh
BONDED_LIMITS = {"direct": 1.1, "iterative": 1.3}  # time with a law on S over time with bonded bodies
STIFFER, STIFF = (1.0, 100.0, 1e4), 100.0  # K h/E of S; ratios of times have a limit up to STIFF
RANKS = {2: (1 / 1.6, math.inf), 4: (math.inf, 0.35)}  # limits of time, for fewer ranks than cores, and of memory
ESTIMATE_LIMIT = 1.6  # time of an estimate over time of a solve
EPS = {2: (1 / 16, 1 / 32, 1 / 64, 1 / 128), 3: (1 / 8, 1 / 16, 1 / 32)}  # thickness of the layer over the width of S
SAME = 1e-9  # relative difference of energies of other programs and of the interface model
FINEST = "cells as long as thick"  # meshed layer whose energy is the reference
SECONDS, FIRST = itemgetter("seconds"), itemgetter(0)
TENTHS = [k / 10 for k in range(1, 11)]
COLUMNS: tuple[str, ...] = ("part", "work", "dim", "unknowns", "eps", "reference", "seconds", "reference_seconds")
COLUMNS += ("ratio", "limit", "error", "peak_mb", "reference_peak_mb", "mesh", "model", "solve", "results", "compiled")
ALONE = """import json, sys
from mpi4py import MPI
from studies import performance
work, size, others = getattr(performance, sys.argv[1]), *map(json.loads, sys.argv[2:])
work(6, *others)  # compiles
row = work(size, *others)
MPI.COMM_WORLD.rank or print(json.dumps(row))"""
SOLVED = """from studies.performance import blocks, layer
from thinlayer import solve
solve(blocks(4, 2).interface(layer()))"""


def run(record: Record, *, quick: bool = False) -> None:
    """Measure each work in processes of its own, and friction in one; the least of several times counts.

    Two blocks under a traction, displacements of degree 1 on a structured mesh. Times are from the mesh to the energy, by
    the clock: leave the machine alone.

    Args:
        record: where to write.
        quick: the smallest meshes, one repeat.
    """
    table = record.new_table("table.csv")
    for part, rows in parts(quick=quick).items():
        for row in rows():
            table.append({name: ({"part": part} | row).get(name) for name in COLUMNS})
    check_ratios(record, () if quick else table)


def parts(*, quick: bool = False) -> dict[str, Callable[[], Iterable[Row]]]:
    """Name of a part -> function that measures its rows; to run one part: `[*parts()["ranks"]()]`."""
    sizes, repeats, cube = (QUICK, 1, 10) if quick else (SIZES, 2, SIZES[3][-1])
    frictions = {work: [*limits][: 1 if quick else None] for work, (_, limits) in WORKS.items()}
    return {
        "solves": lambda: (row for dim in sizes for n in sizes[dim] for row in solves(n, dim, repeats)),
        "stiffer": lambda: stiffer(16 if quick else cube, repeats),
        "friction": lambda: (row for work in frictions for n in frictions[work] for row in friction(work, n, repeats)),
        "thin": lambda: (row for dim in EPS for eps in EPS[dim][: 2 if quick else None] for row in thin(dim, eps)),
        "ranks": lambda: ranks(cube, repeats),
        "marches": lambda: marches(20 if quick else 100, repeats),
        "first use": first_use,
    }


def draw(record: Record) -> None:
    """Draw unknowns, times and errors of thin layers over width by thickness."""
    panels = {}
    for dim, part in record.load("table.csv").split("part")["thin"].split("dim").items():
        works = part.split("work").items()
        for y in ("unknowns", "seconds", "error"):
            panels[f"{y}, {dim:g}D"] = {work: (1 / of["eps"], np.where(of[y] > 0, of[y], np.nan)) for work, of in works}
    across, styles = "width of S over the layer's thickness", ("o-", "s--", "^-.", "D:", "v-", "P--")
    title, save = "cost of a thin layer, and relative error of the energy", record.path("performance.svg")
    thinlayer.plotting.curves(panels, across, title=title, styles=styles, save=save, log="xy", xlim=(7, 150))


# ---------------------------------------------------------------- works, most of them in a process of their own
def blocks(n: int, dim: int, element: str = "P1", load: LoadInput | None = None) -> Structure:
    """Two blocks under a traction, with n cells along each side."""
    joint = sandwich(1.0, 0.5, 0.5, 1 / n, depth=1.0 if dim == 3 else None, structured=True)
    return top_loaded(joint, load or LOAD[:dim], supports=SUPPORTS, element=element)


def layer(stiffness: float = 1.0, eps: float = 0.01) -> ThinLayer:
    """A layer with the stiffnesses of the springs of `by_hand`, times a factor."""
    return ThinLayer(LinearElastic(stiffness * (K_N - 2 * K_T), stiffness * K_T), eps, at=1.0)


def on_s(n: int, dim: int, stiffness: float, options: dict[str, str]) -> dict[str, float]:
    """Measure a solve from the mesh to the energy, with a law on S, `stiffness` times `by_hand`; 0: bonded bodies."""
    stages = Stages()
    structure = blocks(n, dim)
    stages.end("mesh")
    model = structure.interface(layer(stiffness) if stiffness else Bond())
    stages.end("model")
    state = solve(model, options=options)
    stages.end("solve")
    energies = state.energies()
    stages.end("results")
    return stages.measured(energies["bodies"] + energies["layer"], model.unknowns, dim)


def alone(work: str, n: int, *others: object, ranks: int = 1) -> dict[str, float]:
    """Run a work in new processes, one for each rank, and return its row."""
    words = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    command = [*words, sys.executable, "-c", ALONE, work, json.dumps(n), json.dumps(others)]
    prints = subprocess.check_output(command, text=True, env={"OMP_NUM_THREADS": "1", **os.environ})
    return dict(json.loads(prints.splitlines()[-1]))


# ---------------------------------------------------------------- parts of the table
def solves(n: int, dim: int, repeats: int) -> Iterable[Row]:
    """Rows of a law on S against bonded bodies and other programs, with both solvers; small meshes more often."""
    largest = n == SIZES[dim][-1]
    for kind in SOLVERS if dim == 2 or not largest else ("iterative",):  # its factorisation takes minutes, and 20 GB
        works = {name: partial(alone, "on_s", n, dim, k, SOLVERS[kind]) for name, k in (("law", 1.0), ("bonded", 0.0))}
        for name, (work, most, _) in PROGRAMS.items():
            if n > most.get((dim, kind), 0):
                continue
            if name in MODULES and not find_spec(MODULES[name]):
                logger("study").info("%s is not installed and has no row", name)
                continue
            works[name] = partial(alone, work.__name__, n, dim, *([BY_HAND[kind]] if work is by_hand else []))
        runs = in_turn(works, repeats if largest else 2 * repeats, SECONDS)
        law = runs.pop("law")
        for name, other in runs.items():
            limit = BONDED_LIMITS[kind]
            if name in PROGRAMS:
                limit = PROGRAMS[name][2].get(dim, math.inf) if largest and kind == BEST[dim] else math.inf
            row = compared(f"law on S, {kind}", law, name, other, limit)
            if name == "bonded":
                row["error"] = None
            elif not float(row["error"] or 0.0) <= SAME:
                raise SolveError(f"{name} has the energy {other['energy']!r}, the interface model {law['energy']!r}")
            yield row


def stiffer(n: int, repeats: int) -> Iterable[Row]:
    """Rows of laws on S with growing stiffness against bonded bodies, by multigrid."""
    factors = {ratio: 2 * E * ratio / K_N for ratio in (0.0, *STIFFER)}
    works = {ratio: partial(alone, "on_s", n, 3, k, SOLVERS["iterative"]) for ratio, k in factors.items()}
    runs = in_turn(works, repeats, SECONDS)
    for ratio in STIFFER:
        limit = BONDED_LIMITS["iterative"] if ratio <= STIFF else math.inf
        yield compared(f"K h/E = {ratio:g}, iterative", runs[ratio], "bonded", runs[0.0], limit) | {"error": None}


def thin(dim: int, eps: float) -> Iterable[Row]:
    """Rows of a meshed layer with cells as long as it is thick or as the bodies' cells along S, and of laws on S."""
    depth, h = (0.25, 1 / 8) if dim == 3 else (None, 1 / 16)
    full, interface = Structure.full, Structure.interface
    works: dict[str, tuple[Callable[..., Model], float, int]] = {FINEST: (full, eps, 0), "flat cells": (full, h, 0)}
    works |= {f"law on S of order {order}": (interface, h, order) for order in (0, 1)}
    finest = dict[str, float]()
    for work, (kind, h_S, order) in works.items():
        joint, soft = sandwich(1.0, 0.5, 0.5, h, depth=depth, h_S=min(h_S, h)), replace(layer(eps=eps), order=order)
        took, state = min((timed(partial(solved, kind, soft, joint)) for _ in range(2)), key=FIRST)
        row = {"dim": dim, "unknowns": state.model.unknowns, "eps": eps, "seconds": took}
        row["energy"] = state.energies()["bodies"] + state.energies()["layer"]
        finest = finest or row
        yield compared(work, row, FINEST, finest)


def solved(kind: Callable[..., Model], soft: ThinLayer, joint: Joint) -> State:
    """Make a full or an interface model of two blocks under the load, and return its solution."""
    return solve(kind(top_loaded(joint, LOAD[: joint.dim]), soft))


def ranks(n: int, repeats: int) -> Iterable[Row]:
    """Rows of a cube on several ranks against one rank, by multigrid: time, and memory of a rank."""
    run = partial(alone, "on_s", n, 3, 1.0, SOLVERS["iterative"])
    runs = in_turn({number: partial(run, ranks=number) for number in (1, *RANKS)}, repeats, SECONDS)
    for number, (limit, most) in RANKS.items():
        row = compared(f"{number} ranks", runs[number], "one rank", runs[1], limit)
        yield row
        memory = runs[number]["peak_mb"] / runs[1]["peak_mb"]
        yield row | {"work": f"memory of each of {number} ranks", "ratio": memory, "limit": most}


def marches(n: int, repeats: int) -> Iterable[Row]:
    """Rows of steps of marches, and of an estimate, against a linear solve of the same mesh."""
    flowing, switching = VonMises(K_N - 2 * K_T, K_T, strength=0.3), NonMonotone(*SNAP_LAW_ARGS, mixing=0.4)
    works: dict[str, tuple[str, ThinLayer | SurfaceLaw, float, Sequence[float] | ArcLength | None]] = {
        "step of a march that yields": ("P2", ThinLayer(flowing, 0.01, at=1.0), 1.0, TENTHS),
        "step of a march in contact": ("P1", IncrementalCoulomb(K_N, K_T, friction=0.25), -1.0, TENTHS),
        "step of a path": ("P2", ThinLayer(switching, 0.02, at=1.0), 1.0, ArcLength(end=2.0, first=0.2)),
        "estimate with bounds": ("P2", layer(), 1.0, None),
    }

    for work, (element, law, pull, times) in works.items():
        structure = blocks(n, 2, element, lambda x, t, pull=pull: (t * LOAD[0], t * pull))
        model, soft = structure.interface(law), structure.interface(layer())
        linear, limit = partial(solve, soft, 1.0), math.inf if times else ESTIMATE_LIMIT
        ours: Callable[[], object] = partial(estimate, linear(), goals=[goals.Compliance()])
        ours = partial(march, model, times, keep="last") if times else ours
        (took, result), (reference, _) = timed_in_turn({work: ours, "linear": linear}, repeats).values()
        steps = len(result.t) - 1 if isinstance(result, History) else 1
        row = {"dim": 2, "unknowns": soft.unknowns, "seconds": took / steps}
        yield compared(work, row, "linear solve", {"seconds": reference}, limit)


def first_use() -> Iterable[Row]:
    """Rows of starts of Python, and of the first and second solve of a user without compiled forms."""
    works = {
        "import numpy": (["-c", "import numpy"], math.inf),
        "import thinlayer": (["-c", "import thinlayer"], 0.3),
        "thinlayer list": (["-m", "thinlayer", "list"], 0.3),
        "first solve": (["-c", SOLVED], math.inf),
        "second solve": (["-c", SOLVED], math.inf),
    }
    with tempfile.TemporaryDirectory() as cache:
        for work, (words, limit) in works.items():
            before, begin = compiled(cache), time.perf_counter()
            subprocess.check_output([sys.executable, *words], env={**os.environ, "XDG_CACHE_HOME": cache})
            row = compared(work, {"seconds": time.perf_counter() - begin}, "1 s", {"seconds": 1.0}, limit)
            yield row | {"compiled": compiled(cache) - before}


def compiled(cache: str) -> int:
    """Number of compiled forms in a folder."""
    return len([*Path(cache).rglob("*.so")])
