"""Contact with friction against one linear solve of the same matrix: time, ratio and memory, for the benchmark."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

from petsc4py import PETSc

from forms import HolonomicCoulomb, LinearElastic
from geometry import wall
from studies.problems import sliding_bar
from studies.timing import compared, in_turn, peak, solve_once, timed
from thinlayer import Structure
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.parts.contact_part import ContactPart
from thinlayer.parts.part import TimeStep
from thinlayer.solving.contact.contact_solver import ContactSolver
from thinlayer.solving.contact.methods import SOLVER_OF_METHOD, default_method
from thinlayer.solving.equations import Equations
from thinlayer.solving.linear_solvers import DIRECT_OPTIONS, MULTIGRID_OPTIONS, ORDERING_OPTIONS
from thinlayer.solving.newton import StepSolution
from thinlayer.solving.petsc import faster_products, require_options_read
from thinlayer.solving.solve import Solver
from thinlayer.system.table import Row

TOLERANCE = 1e-10  # relative residual of the iterative reference, as in the contact solver
PREDICTED_LIMIT = 1.15  # limit of ratios in 3D if the contact status is predicted
NETWORK, BRICKS = "friction in 217 bricks", (14, 15, (1.0, 0.5))  # bricks along, courses, size of a brick


def bar(n: int, *, depth: bool = False, structured: bool = True) -> InterfaceModel:
    """A bar or a cube of n cells along each side."""
    joint, setup = sliding_bar(n, depth=depth, structured=structured)
    return Structure(joint, **setup).interface(HolonomicCoulomb.of_layer(15e8, 5e8, friction=1.0))  # N/mm^3


def bricks(n: int) -> InterfaceModel:
    """A dry wall, pressed and pushed along its top, with n cells along the height of a brick."""
    loads, supports = {"TOP": (0.2, -1.0)}, {"BOTTOM": 0.0}
    joint, body = wall(*BRICKS, BRICKS[-1][1] / n, cell="quadrilateral"), LinearElastic.young(50.0, 0.2)
    structure = Structure(joint, body=body, supports=supports, tractions=loads, element="Q1")
    return structure.interface({"BED": HolonomicCoulomb(200.0, 80.0, 0.5), "HEAD": HolonomicCoulomb(100.0, 40.0, 0.3)})


WORKS: dict[str, tuple[Callable[[int], InterfaceModel], dict[int, float]]] = {  # work -> model(n), n -> limit of ratio
    "friction 2D": (bar, {128: 1.4, 256: 1.25, 512: 1.1, 724: 1.1}),
    "friction 2D, unstructured": (partial(bar, structured=False), {128: 1.4, 512: 1.1, 724: 1.1}),
    "friction 3D": (partial(bar, depth=True), {24: 1.3, 32: 1.3, 46: 1.3}),
    "friction 3D, unstructured": (partial(bar, depth=True, structured=False), {24: math.inf, 32: math.inf}),
    NETWORK: (bricks, {4: 20.0, 8: 12.0}),
}


def friction(work: str, n: int, repeats: int) -> list[Row]:
    """Rows of one of `WORKS`; our solver and the reference alternate in one process after a warm-up.

    The reference is the faster of MUMPS (Cholesky) and of conjugate gradients with multigrid, on the matrix with bonded
    springs at S. Times are processor times; all costs after the assembly of the stiffness are counted.
    """
    of, limits = WORKS[work]
    bench = Bench(of(n))
    rows = bench.compare(work, repeats, limits[n])
    bench.close()
    require_options_read("contact", ())
    return rows


class Bench:
    """A model in contact, ready to be solved again and again.

    Attributes:
        equations: equations of the model.
        bonded: stiffness with bonded springs at S, which the reference solves.
    """

    def __init__(self, model: InterfaceModel) -> None:
        self.model, self.dim = model, model.joint.dim
        self.solver = Solver(model, method="newton")
        self.equations: Equations = self.solver.equations
        self.load(1.0)
        self.bonded = self.equations.K.copy()
        for part in self.equations.of_kind(ContactPart):
            springs = part.nodes.stiffness(part.law.bonded(len(part.nodes.upper), self.dim))
            self.bonded.axpy(1.0, springs, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
            springs.destroy()
        self.equations.apply_bcs(self.bonded)
        self.bonded.setOption(PETSc.Mat.Option.SPD, True)
        near = self.equations.near_null
        self.bonded.setNearNullSpace(PETSc.NullSpace().create(vectors=near, comm=self.bonded.comm))

    def load(self, sideways: float) -> None:
        """Set the loads, with their x components times a factor."""
        self.equations.begin(TimeStep(self.solver.rest_state(0.0), 0.0, 0.0, 1.0))
        self.equations.external.array[:: self.dim] *= sideways
        self.equations.loads.array[:: self.dim] *= sideways

    def ours(self, start: PETSc.Vec | None = None) -> tuple[float, PETSc.Vec]:
        """Processor time and displacements of our solver."""

        def work() -> tuple[ContactSolver, StepSolution]:
            finder = SOLVER_OF_METHOD[default_method(self.model)](self.equations, None)
            with faster_products(serial=True):
                return finder, finder.solve_step(start)

        seconds, (finder, solution) = timed(work)
        u = solution.x.copy()
        finder.close()
        return seconds, u

    def linear(self, kind: str) -> float:
        """Processor time of one linear solve; infinite if it does not converge."""
        cholesky = DIRECT_OPTIONS | ORDERING_OPTIONS[self.dim] | {"pc_type": "cholesky"}
        multigrid = MULTIGRID_OPTIONS | {"ksp_type": "cg", "ksp_norm_type": "unpreconditioned"}
        options = cholesky if kind == "cholesky" else multigrid
        options |= {"ksp_rtol": TOLERANCE, "pc_gamg_aggressive_coarsening": self.dim - 1}
        with faster_products(serial=True):
            return solve_once(self.bonded, self.equations.external, options)

    def compare(self, work: str, repeats: int, limit: float) -> list[Row]:
        """Rows of the table: from rest; in 3D also from 0.9 of the load along x, where the contact status differs."""
        unknowns = self.equations.K.getSize()[0]
        large = self.dim == 3 and unknowns > 30_000  # a factorisation is far slower there
        kinds = ("multigrid",) if large else ("cholesky", "multigrid")
        starts: dict[str, tuple[PETSc.Vec | None, float]] = {work: (None, limit)}
        if self.dim == 3:
            self.load(0.9)
            starts[f"{work}, status predicted"] = self.ours()[1], PREDICTED_LIMIT
            self.load(1.0)
        works: dict[str, Callable[[], float]] = {kind: partial(self.linear, kind) for kind in kinds}
        works |= {name: partial(lambda u: self.ours(u)[0], start) for name, (start, _) in starts.items()}
        peaks = {name: peak(call) for name, call in works.items()}  # which also warms up
        of = {"dim": self.dim, "unknowns": unknowns}
        times = {name: of | {"seconds": s, "peak_mb": peaks[name]} for name, s in in_turn(works, repeats).items()}
        best = min(kinds, key=lambda kind: times[kind]["seconds"])
        return [compared(name, times[name], f"bonded, {best}", times[best], most) for name, (_, most) in starts.items()]

    def close(self) -> None:
        """Free the matrices."""
        self.bonded.destroy()
        self.solver.close()
