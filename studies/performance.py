"""Benchmark: contact with friction against one linear solve of the same matrix; time, ratio and memory."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from petsc4py import PETSc

from forms import HolonomicCoulomb
from studies.problems import sliding_bar
from thinlayer import SolveError, Structure, plotting
from thinlayer.files.progress import track
from thinlayer.files.table import Row
from thinlayer.parts.part import Interval
from thinlayer.running.record import Record
from thinlayer.solving.contact.blocks import faster_products
from thinlayer.solving.contact.problem import ContactProblem
from thinlayer.solving.contact.solver import SCHEMES
from thinlayer.solving.equations import Equations
from thinlayer.solving.linear_solvers import DIRECT, MULTIGRID
from thinlayer.solving.petsc import PREFIX, defaults, require_all_read
from thinlayer.solving.solvers import Solver

STIFFNESS = (15e8, 5e8)  # lmbda, mu per thickness, N/mm^3
FRICTION = 1.0
TOLERANCE = 1e-10  # relative residual of the iterative reference, as of the contact solver
LIMITS = {"2D": {128: 1.40, 256: 1.25, 512: 1.25, 724: 1.25}, "3D": {24: 1.7, 32: 1.7, 46: 1.7}}
PREDICTED_LIMIT = 1.5  # largest ratio in 3D if the contact status is predicted
RELAXED = (32, 64)  # squares along each side for the paper's relaxation


def run(record: Record, *, quick: bool = False) -> None:
    """Alternate our solver and the reference in one process, warm, and keep the least time of each.

    The reference is the faster of MUMPS (Cholesky, AMF ordering) and of conjugate gradients with multigrid, on the matrix
    with bonded springs at S. Times are of the processor; all costs from the assembled stiffness on are counted.

    Args:
        record: where to write.
        quick: the smallest meshes, three repeats.
    """
    repeats = 3 if quick else 5
    record.parameters = {"K": STIFFNESS, "friction": FRICTION, "repeats": repeats}
    cases: list[tuple[str, int]] = [("2D", n) for n in ((128,) if quick else LIMITS["2D"])]
    cases += [("3D", n) for n in ((12,) if quick else LIMITS["3D"])]
    table = record.table("table.csv")
    for name, n in track(cases, "performance", "{}"):
        bench = Bench(n, depth=name == "3D")
        for row in bench.compare(name, repeats if n < 46 else 3):
            table.append(row)
            record.say(row)
        bench.close()
        require_all_read("contact", ())
    for n in RELAXED[:1] if quick else RELAXED:
        bench = Bench(n, depth=False)
        table.append(row := bench.relaxed())
        record.say(row)
        bench.close()
    if quick:
        return
    for row in table.rows:
        work, size = str(row["work"]), int(float(row["cells_along"] or 0))
        if work.startswith("friction"):
            high = PREDICTED_LIMIT if "predicted" in work else LIMITS[f"{row['dim']}D"][size]
            record.check(f"{work}, {size} cells along: ratio", float(row["ratio"] or np.nan), high=high)


def draw(record: Record) -> None:
    """Draw the ratios from table.csv."""
    rows = [row for row in record.load("table.csv").rows if str(row["work"]).startswith("friction")]
    lines = {}
    for work in dict.fromkeys(str(row["work"]) for row in rows):
        own = [(float(row["dofs"] or 0), float(row["ratio"] or 0)) for row in rows if row["work"] == work]
        lines[work] = tuple(np.array(own).T)
    plotting.curves(
        lines,
        xlabel="unknowns",
        ylabel="time over that of one linear solve",
        title="contact with friction",
        styles=dict.fromkeys(lines, "o-"),
        xscale="log",
        save=record.path("ratios.png"),
    )


class Bench:
    """A discretised bar, ready to be solved again and again.

    Attributes:
        problem: its contact problem.
        bonded: its stiffness with bonded springs at S, which the reference solves.
    """

    def __init__(self, n: int, *, depth: bool) -> None:
        joint, setup = sliding_bar(n, depth=depth)
        law = HolonomicCoulomb.of_layer(*STIFFNESS, friction=FRICTION)
        self.n, self.model = n, Structure(joint, **setup).interface(law)
        self.solver = Solver(self.model, method="newton")
        self.equations: Equations = self.solver.equations
        self.problem = ContactProblem(self.equations)
        nodes = self.problem.nodes
        self.dim, self.dofs = joint.dim, self.problem.A.getSize()[0]
        self.load(1.0)
        springs = nodes.stiffness(law.bonded(len(nodes.upper), self.dim))
        self.bonded = self.problem.A.copy()
        self.bonded.axpy(1.0, springs, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        self.bonded.zeroRowsColumns(self.equations.held_rows, self.problem.diagonal)
        for option in (PETSc.Mat.Option.SYMMETRIC, PETSc.Mat.Option.SPD):
            self.bonded.setOption(option, True)
        self.bonded.setNearNullSpace(self.problem.near)
        springs.destroy()

    def load(self, sideways: float) -> None:
        """Set the loads, the one that pushes along x times a factor."""
        self.equations.begin(Interval(self.solver.rest(0.0), 0.0, 0.0, 1.0))
        self.equations.loads.array[:: self.dim] *= sideways
        self.problem.begin()

    @property
    def method(self) -> str:
        """The solver of choice."""
        return "condensed" if self.dim == 2 else "multigrid"

    def ours(self, start: np.ndarray | None = None) -> tuple[float, np.ndarray, int]:
        """Processor time, jumps at the nodes and Newton steps of our solver."""
        begin = time.process_time()
        solver = SCHEMES[self.method](self.problem)
        u, steps, _ = solver.solve(start)
        seconds = time.process_time() - begin
        jumps = self.problem.nodes.jump(u)
        solver.close()
        return seconds, jumps, steps

    def linear(self, kind: str) -> float:
        """Processor time of one linear solve."""
        options = dict(DIRECT) | {"pc_type": "cholesky"} if kind == "cholesky" else MULTIGRID | {"ksp_type": "cg"}
        options |= {"ksp_rtol": TOLERANCE, "pc_gamg_aggressive_coarsening": self.dim - 1}
        x = self.problem.b.duplicate()
        begin = time.process_time()
        with defaults(options), faster_products(serial=True):
            ksp = PETSc.KSP().create(self.model.comm)
            ksp.setOptionsPrefix(PREFIX)
            ksp.setOperators(self.bonded)
            ksp.setFromOptions()
            if kind == "multigrid":
                ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
            ksp.setUp()
            ksp.solve(self.problem.b, x)
        seconds = time.process_time() - begin
        if ksp.getConvergedReason() < 0:
            seconds = float("inf")
        ksp.destroy()
        x.destroy()
        return seconds

    def compare(self, name: str, repeats: int) -> list[Row]:
        """Rows of the table: cold, and in 3D from the jumps under 0.9 of the load along x, whose status is another one."""
        kinds: tuple[str, ...] = ("cholesky", "multigrid")
        if self.dim == 3 and self.n > 32:
            kinds = ("multigrid",)  # factorising falls further behind the larger the cube
        works: dict[str, np.ndarray | None] = {f"friction {name}": None}
        if self.dim == 3:
            self.load(0.9)
            works[f"friction {name}, status predicted"] = self.ours()[1]
            self.load(1.0)
        # each once, which also warms up
        peaks = {kind: peak(lambda kind=kind: self.linear(kind)) for kind in kinds}  # type: ignore[misc]
        ours_peak = peak(self.ours)
        times: dict[str, list[float]] = {key: [] for key in (*kinds, *works)}
        steps = dict.fromkeys(works, 0)
        for _ in range(repeats):
            for kind in kinds:
                times[kind].append(self.linear(kind))
            for work, start in works.items():
                seconds, _, steps[work] = self.ours(start)
                times[work].append(seconds)
        best = min(kinds, key=lambda kind: min(times[kind]))
        reference = min(times[best])
        row = {"dim": self.dim, "dofs": self.dofs, "cells_along": self.n}
        return [
            {"work": work} | row | {
                "seconds": min(times[work]), "reference_seconds": reference, "ratio": min(times[work]) / reference,
                "peak_mb": ours_peak, "reference_peak_mb": peaks[best], "reference": best, "steps": steps[work],
            }
            for work in works
        ]  # fmt: skip

    def relaxed(self) -> Row:
        """Row of the paper's relaxation."""
        reference = min(self.linear("cholesky") for _ in range(3))
        seconds, sweeps = float("nan"), 0

        def solve() -> None:
            nonlocal seconds, sweeps
            begin = time.process_time()
            solver = SCHEMES["relaxation"](self.problem)
            try:
                with defaults({"relaxation_tolerance": 1e-10, "relaxation_omega": 1.7}):
                    _, sweeps, _ = solver.solve(None)
            except SolveError as error:
                sweeps = len(error.residuals)
            seconds = time.process_time() - begin
            solver.close()

        memory = peak(solve)
        return {
            "work": "the paper's relaxation 2D", "dim": 2, "dofs": self.dofs, "cells_along": self.n, "seconds": seconds,
            "reference_seconds": reference, "ratio": seconds / reference, "peak_mb": memory, "reference_peak_mb": None,
            "reference": "cholesky", "steps": sweeps,
        }  # fmt: skip

    def close(self) -> None:
        """Free the matrices."""
        self.bonded.destroy()
        self.problem.destroy()
        self.solver.close()


def peak(work: Callable[[], object]) -> float:
    """Largest memory that this process takes during some work, on top of what it had, MB; Linux only."""
    before = resident()
    Path("/proc/self/clear_refs").write_text("5", encoding="utf-8")  # forget the largest so far
    work()
    return max(_status("VmHWM") - before, 0.0)


def resident() -> float:
    """Memory that this process has, MB; Linux only."""
    ctypes.CDLL(None).malloc_trim(0)  # what was freed goes back to the system
    return _status("VmRSS")


def _status(name: str) -> float:
    for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines():
        if line.startswith(name):
            return int(line.split()[1]) / 1024
    return float("nan")
