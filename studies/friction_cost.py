"""Contact with friction against one linear solve of the same matrix: time, ratio and memory, for the benchmark."""

from __future__ import annotations

import math
from functools import partial

from petsc4py import PETSc

from forms import HolonomicCoulomb
from studies.problems import sliding_bar
from studies.timing import in_turn, peak, solve_once, timed
from thinlayer import Structure
from thinlayer.parts.contact_part import ContactPart
from thinlayer.parts.part import Interval
from thinlayer.solving.contact.finder import ContactFinder
from thinlayer.solving.contact.methods import FINDERS
from thinlayer.solving.equations import Equations
from thinlayer.solving.equilibrium import Found
from thinlayer.solving.linear_solvers import DIRECT, MULTIGRID
from thinlayer.solving.petsc import faster_products, require_all_read
from thinlayer.solving.solvers import Solver
from thinlayer.system.table import Row

STIFFNESS = (15e8, 5e8)  # lmbda, mu per thickness, N/mm^3
FRICTION = 1.0
TOLERANCE = 1e-10  # relative residual of the iterative reference, as of the contact solver
LIMITS = {"2D": {128: 1.4, 256: 1.25, 512: 1.1, 724: 1.1}, "3D": {24: 1.3, 32: 1.3, 46: 1.3}}  # of ratios
PREDICTED_LIMIT = 1.15  # of ratios in 3D if the contact status is predicted


def friction(n: int, dim: int, repeats: int) -> list[Row]:
    """Rows of a bar or a cube of n cells along each side; our solver and the reference alternate in one process, warm.

    The reference is the faster of MUMPS (Cholesky, AMF ordering) and of conjugate gradients with multigrid, on the matrix
    with bonded springs at S. Times are of the processor; all costs from the assembled stiffness on are counted.
    """
    bench = Bench(n, depth=dim == 3)
    rows = bench.compare(f"{dim}D", repeats)
    bench.close()
    require_all_read("contact", ())
    return rows


class Bench:
    """A discretised bar, ready to be solved again and again.

    Attributes:
        equations: its equations.
        bonded: its stiffness with bonded springs at S, which the reference solves.
    """

    def __init__(self, n: int, *, depth: bool) -> None:
        joint, setup = sliding_bar(n, depth=depth)
        law = HolonomicCoulomb.of_layer(*STIFFNESS, friction=FRICTION)
        self.n, self.model = n, Structure(joint, **setup).interface(law)
        self.solver = Solver(self.model, method="newton")
        self.equations: Equations = self.solver.equations
        (part,) = self.equations.of_kind(ContactPart)
        self.dim, self.dofs = joint.dim, self.equations.K.getSize()[0]
        self.load(1.0)
        springs = part.nodes.stiffness(law.bonded(len(part.nodes.upper), self.dim))
        self.bonded = self.equations.K.copy()
        self.bonded.axpy(1.0, springs, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        self.equations.hold(self.bonded)
        for option in (PETSc.Mat.Option.SYMMETRIC, PETSc.Mat.Option.SPD):
            self.bonded.setOption(option, True)
        near = self.equations.near_null
        self.bonded.setNearNullSpace(PETSc.NullSpace().create(vectors=near, comm=self.bonded.comm))
        springs.destroy()

    def load(self, sideways: float) -> None:
        """Set the loads, the one that pushes along x times a factor."""
        self.equations.begin(Interval(self.solver.rest(0.0), 0.0, 0.0, 1.0))
        self.equations.external.array[:: self.dim] *= sideways
        self.equations.loads.array[:: self.dim] *= sideways

    @property
    def method(self) -> str:
        """The solver of choice."""
        return "condensed" if self.dim == 2 else "multigrid"

    def ours(self, start: PETSc.Vec | None = None) -> tuple[float, PETSc.Vec, int]:
        """Processor time, displacements and Newton steps of our solver."""

        def work() -> tuple[ContactFinder, Found]:
            finder = FINDERS[self.method](self.equations, None)
            with faster_products(serial=True):
                return finder, finder.find(start)

        seconds, (finder, found) = timed(work)
        u = found.x.copy()
        finder.close()
        return seconds, u, found.iterations

    def linear(self, kind: str) -> float:
        """Processor time of one linear solve; infinite where it does not converge."""
        options = dict(DIRECT) | {"pc_type": "cholesky"} if kind == "cholesky" else MULTIGRID | {"ksp_type": "cg"}
        options |= {"ksp_rtol": TOLERANCE, "pc_gamg_aggressive_coarsening": self.dim - 1}
        if kind == "multigrid":
            options |= {"ksp_norm_type": "unpreconditioned"}
        with faster_products(serial=True):
            return solve_once(self.bonded, self.equations.external, options)

    def compare(self, name: str, repeats: int) -> list[Row]:
        """Rows of the table: cold, and in 3D from the state under 0.9 of the load along x, whose status is another one."""
        kinds: tuple[str, ...] = ("cholesky", "multigrid")
        if self.dim == 3 and self.n > 32:
            kinds = ("multigrid",)  # factorising falls further behind the larger the cube
        starts: dict[str, PETSc.Vec | None] = {f"friction {name}": None}
        if self.dim == 3:
            self.load(0.9)
            starts[f"friction {name}, status predicted"] = self.ours()[1]
            self.load(1.0)
        steps: dict[str, int] = {}

        def ours(work: str) -> float:
            seconds, _, steps[work] = self.ours(starts[work])
            return seconds

        works = {kind: partial(self.linear, kind) for kind in kinds} | {work: partial(ours, work) for work in starts}
        peaks = {kind: peak(works[kind]) for kind in (*kinds, f"friction {name}")}  # which also warms up
        times = in_turn(works, repeats)
        best = min(kinds, key=times.__getitem__)
        row = {"dim": self.dim, "unknowns": self.dofs, "reference": f"bonded, {best}"}
        row |= {
            "reference_seconds": times[best],
            "reference_peak_mb": peaks[best],
            "peak_mb": peaks[f"friction {name}"],
        }
        limits = LIMITS[name].get(self.n, math.inf), PREDICTED_LIMIT
        return [
            {"work": work, **row, "seconds": times[work], "ratio": times[work] / times[best], "limit": limit}
            for work, limit in zip(starts, limits, strict=False)
        ]

    def close(self) -> None:
        """Free the matrices."""
        self.bonded.destroy()
        self.solver.close()
