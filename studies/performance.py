"""Benchmark: a law on S in solves of the same mesh without it, beside a script by hand; friction, ranks, first use."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from mpi4py import MPI

from forms import LinearElastic, VonMises
from geometry import sandwich
from studies.by_hand import CHOLESKY, K_N, K_T, LOAD, MULTIGRID, NU, E, by_hand
from studies.friction_cost import friction
from studies.timing import seconds, status
from thinlayer import Bond, SolveError, Structure, ThinLayer, estimate, goals, march, plotting, solve
from thinlayer.running.record import Record
from thinlayer.system.table import Row, Table

SIZES = {2: (70, 222, 700), 3: (14, 31, 46)}  # dimension -> cells along: about 1e4, 1e5 and 1e6 unknowns, 3e5 in 3D
QUICK = {2: (70,), 3: (10,)}
SOLVERS: dict[str, dict[str, Any]] = {"direct": {"pc_type": "cholesky"}, "iterative": {"pc_type": "gamg"}}
BONDED_LIMITS = {"direct": 1.1, "iterative": 1.3}  # time with a law on S over that of bonded bodies
SCRIPT_LIMITS = {2: 1.0, 3: 1.05}  # time with a law on S over that of the script by hand, for the largest mesh
BEST = {2: "direct", 3: "iterative"}  # dimension -> the faster solver for the largest mesh
STIFFER, STIFF = (
    (1.0, 100.0, 1e4),
    100.0,
)  # stiffness of S times the height of a body over its modulus; limited up to here
ESTIMATE_LIMIT = 1.6  # time of an estimate over that of a solve
EPS = {2: (1 / 16, 1 / 32, 1 / 64, 1 / 128), 3: (1 / 8, 1 / 16, 1 / 32)}  # thickness of the layer over the width of S
SAME = 1e-9  # relative difference of energies of the script and of the interface model
FRICTION = [(n, 2) for n in (128, 256, 512, 724)] + [(n, 3) for n in (24, 32, 46)]  # cells along, dimension
STAGES = ("mesh", "model", "solve", "results")
TIMES = ("seconds", "reference_seconds", "ratio", "limit")
COLUMNS = (
    "part",
    "work",
    "dim",
    "unknowns",
    "eps",
    "reference",
    *TIMES,
    "peak_mb",
    "reference_peak_mb",
    *STAGES,
    "compiled",
)
ALONE = """import json, sys
from studies import performance
print(json.dumps(getattr(performance, sys.argv[1])(*map(json.loads, sys.argv[2:]))))"""
SOLVED = """from studies.performance import blocks, layer
from thinlayer import solve
solve(blocks(2, 4).interface(layer()))"""


def run(record: Record, *, quick: bool = False) -> None:
    """Measure each work in processes of its own, and friction in one; the least of several times counts.

    Two blocks under a traction, displacements of degree 1 on a structured mesh. Times are from the mesh to the energy, by
    the clock: leave the machine alone.

    Args:
        record: where to write.
        quick: the smallest meshes, one repeat.
    """
    sizes, repeats = (QUICK, 1) if quick else (SIZES, 3)
    parts: dict[str, Callable[[], Iterable[Row]]] = {
        "solves": lambda: (row for dim in sizes for n in sizes[dim] for row in solves(dim, n, repeats)),
        "stiffer": lambda: stiffer(24 if quick else 46, repeats),
        "friction": lambda: (row for n, dim in FRICTION[:: 5 if quick else 1] for row in friction(n, dim, repeats + 1)),
        "thin": lambda: (row for dim in EPS for eps in EPS[dim][: 2 if quick else 4] for row in thin(dim, eps)),
        "ranks": lambda: ranks(10 if quick else 46, repeats),
        "marches": lambda: marches(20 if quick else 100, repeats),
        "first use": first_use,
    }
    table = record.table("table.csv")
    for part, rows in parts.items():
        table.extend({**dict.fromkeys(COLUMNS), "part": part, **row} for row in rows())
    for row in () if quick else table.rows:
        if math.isfinite(limit := float(row.get("limit") or math.inf)):
            record.check(f"{row['work']}, {row['unknowns']} unknowns", float(row["ratio"] or math.nan), high=limit)


def draw(record: Record) -> None:
    """Draw the ratios of times, and the unknowns and times of meshed layers over their thickness."""
    parts = record.load("table.csv").split("part")

    def lines(table: Table, x: str, y: str) -> dict[str, tuple[Any, Any]]:
        works = [
            (f"{work}, {dim:g}D", of_work)
            for dim, part in table.split("dim").items()
            for work, of_work in part.split("work").items()
        ]
        return {label: (part[x], part[y]) for label, part in works}

    look: dict[str, Any] = {"styles": ("o-", "s--", "^-.", "D:", "v-", "P--"), "log": "xy"}
    against = parts["solves"].split("reference")
    panels = {f"over {name}": lines(part, "unknowns", "ratio") for name, part in against.items()}
    plotting.curves(
        panels, "unknowns", "ratio of times", title="a law on S", save=record.path("performance_ratios.svg"), **look
    )
    panels = {name: lines(parts["thin"], "eps", name) for name in ("unknowns", "seconds")}
    across, save = "thickness of the layer over the width of S", record.path("performance.svg")
    plotting.curves(panels, across, {name: name for name in panels}, title="cost of a thin layer", save=save, **look)


# ---------------------------------------------------------------- works, each in a process of its own
def blocks(dim: int, n: int, element: str = "P1") -> Structure:
    """Two blocks under a traction, with n cells along each side."""
    joint = sandwich(1.0, 0.5, 0.5, 1 / n, depth=1.0 if dim == 3 else None, structured=True)
    supports: dict[Any, Any] = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    body, load = LinearElastic.young(E=E, nu=NU), {"TOP": LOAD[:dim]}
    return Structure(joint, body=body, supports=supports, tractions=load, element=element)


def layer(stiffness: float = 1.0, eps: float = 0.01) -> ThinLayer:
    """A layer with the stiffnesses of the script's springs, times a factor."""
    return ThinLayer(LinearElastic(stiffness * (K_N - 2 * K_T), stiffness * K_T), eps, at=1.0)


def on_s(dim: int, n: int, stiffness: float, options: dict[str, Any]) -> dict[str, Any]:
    """From the mesh to the energy, with a law on S, `stiffness` times that of the script; 0: with bonded bodies."""
    for cells in (6, n):  # the first compiles
        stages, begin = {}, time.perf_counter()
        structure = blocks(dim, cells)
        stages["mesh"], begin = time.perf_counter() - begin, time.perf_counter()
        model = structure.interface(layer(stiffness) if stiffness else Bond())
        stages["model"], begin = time.perf_counter() - begin, time.perf_counter()
        state = solve(model, options=options)
        stages["solve"], begin = time.perf_counter() - begin, time.perf_counter()
        energies = state.energies()
        stages["results"] = time.perf_counter() - begin
    return measured(energies["bodies"] + energies["layer"], stages, model.unknowns)


def script(dim: int, n: int, options: dict[str, Any]) -> dict[str, Any]:
    """The same by hand."""
    by_hand(4, dim, options)
    return measured(*by_hand(n, dim, options), 0)


def measured(energy: float, stages: dict[str, float], unknowns: int) -> dict[str, Any]:
    """What a work returns: energy, seconds, and the largest memory of its ranks, MB."""
    peak = MPI.COMM_WORLD.allreduce(status("VmHWM"), MPI.MAX)
    return {"energy": energy, "unknowns": unknowns, "seconds": sum(stages.values()), "stages": stages, "peak_mb": peak}


def alone(work: str, *arguments: Any, ranks: int = 1, repeats: int = 1) -> dict[str, Any]:
    """The quickest of several runs of a work on some ranks of their own."""
    words = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    command = [*words, sys.executable, "-c", ALONE, work, *map(json.dumps, arguments)]
    environment = {"OMP_NUM_THREADS": "1", **os.environ}
    prints = [subprocess.check_output(command, text=True, env=environment) for _ in range(repeats)]
    return min((json.loads(text.splitlines()[-1]) for text in prints), key=lambda one: float(one["seconds"]))


# ---------------------------------------------------------------- parts of the table
def compared(work: str, dim: int, ours: dict[str, Any], against: str, other: dict[str, Any], limit: float) -> Row:
    """A row: a work, what it is compared with, and the ratio of their times."""
    row = {"work": work, "dim": dim, "unknowns": ours["unknowns"], "reference": against, "limit": limit}
    row |= {
        "seconds": ours["seconds"],
        "reference_seconds": other["seconds"],
        "ratio": ours["seconds"] / other["seconds"],
    }
    return row | {"peak_mb": ours["peak_mb"], "reference_peak_mb": other["peak_mb"], **ours["stages"]}


def solves(dim: int, n: int, repeats: int) -> Iterable[Row]:
    """A law on S against bonded bodies and against the script, with both kinds of solvers."""
    for kind, options in SOLVERS.items():
        if dim == 3 and n > 31 and kind == "direct":
            continue  # minutes, and 20 GB
        law, bonded = (alone("on_s", dim, n, stiffness, options, repeats=repeats) for stiffness in (1.0, 0.0))
        hand = alone("script", dim, n, CHOLESKY if kind == "direct" else MULTIGRID, repeats=repeats)
        if not math.isclose(law["energy"], hand["energy"], rel_tol=SAME):
            raise SolveError(f"the script has the energy {hand['energy']!r}, the interface model {law['energy']!r}")
        yield compared(f"law on S, {kind}", dim, law, "bonded", bonded, BONDED_LIMITS[kind])
        limit = SCRIPT_LIMITS[dim] if n == SIZES[dim][-1] and kind == BEST[dim] else math.inf
        yield compared(f"law on S, {kind}", dim, law, "script by hand", hand, limit)


def stiffer(n: int, repeats: int) -> Iterable[Row]:
    """Stiffer and stiffer laws on S, by multigrid."""
    bonded = alone("on_s", 3, n, 0.0, SOLVERS["iterative"], repeats=repeats)
    for ratio in STIFFER:
        law = alone("on_s", 3, n, 2 * E * ratio / K_N, SOLVERS["iterative"], repeats=repeats)
        limit = BONDED_LIMITS["iterative"] if ratio <= STIFF else math.inf
        yield compared(f"K h/E = {ratio:g}, iterative", 3, law, "bonded", bonded, limit)


def thin(dim: int, eps: float) -> Iterable[Row]:
    """A meshed layer with cells as long as it is thick, one with cells of the bodies along S, and a law on S."""
    depth, h = (0.25, 1 / 8) if dim == 3 else (None, 1 / 16)
    for work, h_S in {"cells as long as thick": eps, "flat cells": h, "law on S": h}.items():
        joint = sandwich(1.0, 0.5, 0.5, h, depth=depth, h_S=min(h_S, h))
        body, soft = LinearElastic.young(E=E, nu=NU), layer(eps=eps)
        structure = Structure(joint, body=body, supports={"BOTTOM": 0}, tractions={"TOP": LOAD[:dim]})
        begin = time.process_time()
        model = structure.interface(soft) if work == "law on S" else structure.full(soft)
        solve(model)
        yield {"work": work, "dim": dim, "unknowns": model.unknowns, "eps": eps, "seconds": time.process_time() - begin}


def ranks(n: int, repeats: int) -> Iterable[Row]:
    """A cube on several ranks, by multigrid, against one."""
    one = alone("on_s", 3, n, 1.0, SOLVERS["iterative"], repeats=repeats)
    for number in (2, 4):
        several = alone("on_s", 3, n, 1.0, SOLVERS["iterative"], ranks=number, repeats=repeats)
        limit = 1 / 1.6 if number == 2 else math.inf  # there may be fewer cores than ranks
        yield compared(f"{number} ranks", 3, several, "one rank", one, limit)


def marches(n: int, repeats: int) -> Iterable[Row]:
    """Steps of marches, and an estimate, in linear solves of the same mesh."""
    structure, soft = blocks(2, n, "P2"), layer()
    flowing = ThinLayer(VonMises(K_N - 2 * K_T, K_T, strength=0.3), 0.01, at=1.0)

    def spent(work: Callable[[], Any]) -> float:
        return min(seconds(work) for _ in range(repeats + 1))

    linear, state = spent(lambda: solve(structure.interface(soft))), solve(structure.interface(soft))
    works = {
        "step of a march that yields": (
            lambda: march(structure.interface(flowing), [k / 10 for k in range(1, 11)]),
            10,
        ),
        "estimate with bounds": (lambda: estimate(state, goals=[goals.Compliance()]), 1),
    }
    for work, (call, steps) in works.items():
        took, limit = spent(call) / steps, ESTIMATE_LIMIT if steps == 1 else math.inf
        row: Row = {
            "work": work,
            "dim": 2,
            "unknowns": state.model.unknowns,
            "reference": "linear solve",
            "limit": limit,
        }
        yield row | {"seconds": took, "reference_seconds": linear, "ratio": took / linear}


def first_use() -> Iterable[Row]:
    """Starts of Python, and the first and second solve of a user with no compiled forms."""
    with tempfile.TemporaryDirectory() as cache:
        commands = {
            "import numpy": (["-c", "import numpy"], math.inf),
            "import thinlayer": (["-c", "import thinlayer"], 0.3),
            "thinlayer list": (["-m", "thinlayer", "list"], 0.3),
            "first solve": (["-c", SOLVED], math.inf),
            "second solve": (["-c", SOLVED], math.inf),
        }
        for work, (words, limit) in commands.items():
            before, begin = compiled(cache), time.perf_counter()
            environment = {**os.environ, "XDG_CACHE_HOME": cache}
            subprocess.check_output([sys.executable, *words], env=environment)
            took = time.perf_counter() - begin
            row: Row = {"work": work, "reference": "1 s", "seconds": took, "ratio": took, "limit": limit}
            yield row | {"compiled": compiled(cache) - before}


def compiled(cache: str) -> int:
    """Number of compiled forms in a folder."""
    return len([*Path(cache).rglob("*.so")])
