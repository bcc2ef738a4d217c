"""The balance of forces of a model over a time step, as PETSc vectors and matrices."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import dolfinx.fem.petsc
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from petsc4py import PETSc
from ufl.algorithms.check_arities import ArityMismatch

from forms.elastic import LinearElastic
from forms.law import LawError
from forms.symmetry import require_declared_stress, require_symmetric_tangent
from forms.trace import named, stress_key
from forms.work import energy, work
from thinlayer.contact.springs import ContactSprings
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import Audit, State
from thinlayer.errors import ModelError
from thinlayer.pointwise.constraint import Constraint
from thinlayer.pointwise.laws import PointLaws
from thinlayer.solving.balance import free_norm, require_equilibrium
from thinlayer.solving.uniqueness import RigidMotions

SAME, SUBSET, DIFFERENT = (
    PETSc.Mat.Structure.SAME_NONZERO_PATTERN,
    PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN,
    PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN,
)

STRAIGHT, BETWEEN = 1e-9, (0.21, 0.5, 0.83)  # of what is linear in time: its rounding; where it is looked at
ROUNDING = 1e-8  # times 1e-6, the largest residual: stiffness times displacement is rounded to 1e-14


@dataclass(frozen=True)
class Interval:
    """A time step: from a state to the time t = old.t + dt, with the balance of forces at old.t + theta dt."""

    old: State
    t: float
    dt: float
    theta: float

    @property
    def balanced(self) -> float:
        """The time old.t + theta dt; for theta = 1 the end itself, not rounded."""
        return self.t - (1 - self.theta) * self.dt


class Equations:
    """Residual and tangent of a model. The unknowns are displacements, then the pressures of an incompressible layer.

    The stresses that are linear in the displacements make one matrix, assembled once; compiled laws at points add to it.
    Collective, as all methods are.

    Attributes:
        laws: the compiled laws that act at points.
        constraint: the pressures of an incompressible layer.
        pressure: the unknown pressures, over the constraint's unit.
        contact: the springs at the nodes of S under a contact law.
        loads: nodal forces of the loads in the balance of the present step.
        scale: size of the forces in the last residual: of the bodies' stresses, of the loads, of what was out of balance at
            the start of the step, or of what rounding leaves of the stresses of stiff bodies that supports move.
        unbalanced: forces out of balance at the start of the step, if `start` was asked; they may be all the forces there
            are, as where an eigenstrain ends in a state without stress.
        least_residual: what rounding leaves of the forces of stiff bodies that supports move.
    """

    def __init__(self, model: Model) -> None:
        self.model, self.comm = model, model.comm
        V = model.V
        self.u, self.mid = fem.Function(V), fem.Function(V)
        forms = [p for p in model.terms if not p.law.traits.compiled]
        for p in forms:
            computed = stress_key(p.law, None if p.n is None else p.n.ufl_shape[0])
            require_declared_stress(p.law, computed)
            require_symmetric_tangent(p.law, computed)
        proportional = [p.proportional for p in forms]
        linear = [p for p, yes in zip(forms, proportional, strict=True) if yes]
        self._curved = [p for p, yes in zip(forms, proportional, strict=True) if not yes]
        trial, test = ufl.TrialFunction(V), ufl.TestFunction(V)
        pattern = linear or [replace(p, law=LinearElastic(0.0, 1.0)) for p in model.bodies]
        try:
            stiffness = fem.form(work(pattern, trial, test))
        except ArityMismatch as error:
            names = " or ".join(sorted({type(p.law).__name__ for p in linear if named(p.law) is None}))
            raise LawError(
                f"{names} says linear = True, but is not, or not in a way that UFL sees: {error}; "
                "write linear = False in the class"
            ) from error
        self.K = dolfinx.fem.petsc.assemble_matrix(stiffness)
        self.K.assemble()
        if not linear:
            self.K.zeroEntries()
        if self._curved:
            residual = work(self._curved, self.mid, test)
            self._F, self._J = fem.form(residual), fem.form(ufl.derivative(residual, self.mid, trial))
        self._L = fem.form(model.external_work(test))
        self.laws = PointLaws(model)
        self.contact = ContactSprings(model, model.contact, self.held) if model.contact else None
        self._matrix: PETSc.Mat | None = None
        self._forces, self._product = self.K.createVecLeft(), self.K.createVecLeft()
        self.loads = self.K.getDiagonal()
        self._stiffness = float(self.loads.norm())
        constrained = [p for p in model.terms if p.law.traits.constrained]
        self.constraint = Constraint(V, constrained[0]) if constrained else None
        if self.constraint:
            self.constraint.weigh(float(self.loads.max()[1]))
        self.pressure = fem.Function(self.constraint.space) if self.constraint else None

    @property
    def curved_laws(self) -> str:
        """Names of the laws that are parts of forms and not linear."""
        return " or ".join(sorted({type(p.law).__name__ for p in self._curved}))

    # ---------------------------------------------------------------- unknowns
    @cached_property
    def n_displacements(self) -> int:
        """Number of displacements of this rank."""
        dofmap = self.model.V.dofmap
        return int(dofmap.index_map.size_local * dofmap.index_map_bs)

    @cached_property
    def n_pressures(self) -> int:
        """Number of pressures of this rank."""
        return int(self.constraint.space.dofmap.index_map.size_local) if self.constraint else 0

    def vector(self) -> PETSc.Vec:
        """A vector of unknowns, zero."""
        return PETSc.Vec().createMPI((self.n_displacements + self.n_pressures, None), comm=self.comm)

    def put(self, x: PETSc.Vec) -> None:
        """Take over unknowns, ghosts included."""
        self.u.x.array[: self.n_displacements] = x.array_r[: self.n_displacements]
        self.u.x.scatter_forward()
        if self.pressure is not None:
            self.pressure.x.array[: self.n_pressures] = x.array_r[self.n_displacements :]
            self.pressure.x.scatter_forward()

    @cached_property
    def held(self) -> npt.NDArray[np.int32]:
        """Displacements of this rank that supports prescribe."""
        dofs = [bc.dof_indices()[0] for bc in self.model.conditions.bcs]
        held = np.unique(np.concatenate([np.empty(0, np.int32), *dofs]))
        return held[held < self.n_displacements].astype(np.int32)

    @cached_property
    def _rigid(self) -> RigidMotions:
        return RigidMotions(self.model, self.held, self._stiffness)

    def require_unique(self) -> None:
        """Raise SolveError if a piece of a body can move freely: by the last tangent, or by the springs of contact.

        Not asked where a law depends on the rate, bounds stresses or has a tangent that may vanish.
        """
        laws = [p.law for p in self.model.layer_terms]
        if (
            any(law.traits.rate or law.traits.bounded or law.traits.singular or law.traits.softens for law in laws)
            or self.constraint
        ):
            return
        if self.contact:
            springs = self.contact.stiffness(self.u.x.petsc_vec, self._slip)
            self._rigid.require_resisted(springs)
            springs.destroy()
        elif self._matrix is not None:
            self._rigid.require_resisted(self._matrix)

    @property
    def held_rows(self) -> npt.NDArray[PETSc.IntType]:
        """Their global numbers among the unknowns."""
        n = self.n_displacements + self.n_pressures
        first = self.comm.scan(n) - n
        return (first + self.held).astype(PETSc.IntType)

    def rest(self) -> tuple[npt.NDArray[np.float64], ...]:
        """Internal values before anything happened."""
        memory = self.laws.rest()
        if self.contact:
            memory.append(self.contact.rest())
        return tuple(memory)

    # ---------------------------------------------------------------- a step
    def begin(self, interval: Interval) -> None:
        """Set the step that the residual is of.

        Raises:
            ModelError: loads or supports that are not finite at its time.
        """
        self.interval, old = interval, interval.old
        self.old = old.u.x.petsc_vec
        self.loads.set(0.0)
        for t, share in ((interval.t, interval.theta), (old.t, 1 - interval.theta)):
            if share:
                b = self.loads_at(t)
                self.loads.axpy(share, b)
                b.destroy()
        self.prescribed = self._prescribed_at(interval.t)
        farthest = self.comm.allreduce(float(np.abs(self.prescribed).max(initial=0.0)), max)
        moved = float(self.old.norm(PETSc.NormType.INFINITY))  # forces may end at zero where loads do
        self._rounding = ROUNDING * self._stiffness * max(farthest, moved)
        self.least_residual = np.finfo(float).eps * self._stiffness * farthest
        self.unbalanced = 0.0
        self.laws.begin(self.old, old.memory, interval.balanced)

    def rounding_at(self, x: PETSc.Vec) -> float:
        """What rounding leaves of the forces at unknowns x, about."""
        stiffness = max(self._stiffness, self.contact.cancelling if self.contact else 0.0)
        return float(np.finfo(float).eps * stiffness * x.norm(PETSc.NormType.INFINITY))

    @property
    def least_scale(self) -> float:
        """Size of the loads, of what a step has to balance, or of what rounding leaves where supports move stiff bodies."""
        return max(float(self.loads.norm()), self.unbalanced, self._rounding)

    def check_times(self, times: list[float]) -> None:
        """Raise ModelError if loads or supports, LawError if a law's parameters, are out of range at one of these times."""
        for t in times:
            self.loads_at(t).destroy()
            self._prescribed_at(t)
            self.laws.at_time(t)

    def straight(self, start: float, end: float) -> bool:
        """Whether loads, supports and parameters of laws are linear in time between two times. Seen at a few of them."""
        first, last = self._given_at(start), self._given_at(end)
        for share in BETWEEN:
            now = self._given_at(start + share * (end - start))
            for a, b, c in zip(first, last, now, strict=True):
                apart = np.abs((1 - share) * a + share * b - c).max(initial=0.0)
                size = np.abs([a, b, c]).max(initial=0.0)
                if self.comm.allreduce(float(apart), max) > STRAIGHT * self.comm.allreduce(float(size), max):
                    return False
        return True

    def _given_at(self, t: float) -> list[npt.NDArray[np.float64]]:
        """Loads, prescribed displacements and parameters that vary, on this rank."""
        loads = self.loads_at(t)
        given = [loads.array_r.copy(), self._prescribed_at(t)]
        loads.destroy()
        self.laws.at_time(t)
        return given + [p.material.parameters for p in self.laws.points if p.material.varies]

    def loads_at(self, t: float) -> PETSc.Vec:
        """Nodal forces of the loads at a time."""
        self.model.coordinates.t.value = t
        b = dolfinx.fem.petsc.assemble_vector(self._L)
        b.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
        if not np.isfinite(b.norm()):
            names = self.model.forces.not_finite()
            raise ModelError(": ".join([f"the loads are not finite at t = {t:g}", *names]))
        return b

    def _prescribed_at(self, t: float) -> npt.NDArray[np.float64]:
        self.model.coordinates.t.value = t
        self.model.conditions.update()
        values = np.zeros(len(self.u.x.array))
        for bc in self.model.conditions.bcs:
            bc.set(values, None, 1.0)
        prescribed = values[self.held]
        if self.comm.allreduce(int(not np.isfinite(prescribed).all())):
            raise ModelError(f"a prescribed displacement is not finite at t = {t:g}")
        return np.asarray(prescribed)

    def start(self, x: PETSc.Vec, out: PETSc.Vec) -> None:
        """The residual at the displacements before the step, to which `unbalanced` is set."""
        self.residual(x, out)
        size = free_norm(self, out)
        self.unbalanced = size if math.isfinite(size) else 0.0

    def residual(self, x: PETSc.Vec, out: PETSc.Vec) -> None:
        """Internal forces less loads; pressures: the layer's change of volume. NaN where a law failed."""
        self.put(x)
        now, theta = self.u.x.petsc_vec, self.interval.theta
        mid, forces = self.mid.x.petsc_vec, self._forces
        now.copy(mid)
        mid.scale(theta)
        mid.axpy(1 - theta, self.old)
        self.mid.x.scatter_forward()
        self.K.mult(mid, forces)
        self.scale = max(float(forces.norm()), self.least_scale)
        if self._curved:
            b = self._curved_forces()
            self.scale = max(self.scale, float(b.norm()))
            forces.axpy(1.0, b)
            b.destroy()
        self.laws.respond(now, self.interval.dt, theta)
        self.laws.add_forces(forces)
        if self.constraint and self.pressure is not None:
            self.constraint.G.multTranspose(self.pressure.x.petsc_vec, self._product)
            forces.axpy(1.0, self._product)
            self.constraint.G.mult(now, self.constraint.volume)
            out.array[self.n_displacements :] = self.constraint.volume.array_r
        if self.contact:
            self.contact.add_forces(now, self._slip, forces)
        forces.axpy(-1.0, self.loads)
        out.array[: self.n_displacements] = np.nan if self.laws.failed else forces.array_r
        self._lack = free_norm(self, out) / max(self.scale, 1e-300) if self.laws.flat else 0.0

    @property
    def _slip(self) -> npt.NDArray[np.float64]:
        """Slip at the nodes of S under contact at the beginning of the step."""
        return self.interval.old.memory[-1]

    def tangent(self) -> PETSc.Mat:
        """Tangent at the last residual's unknowns, supports not yet taken in. The same matrix is filled each time.

        Raises:
            LawError: a law that says it is symmetric, and is not.
        """
        theta = self.interval.theta
        parts = self.laws.stiffness(self._lack)
        if self.contact:
            parts.append(self.contact.stiffness(self.u.x.petsc_vec, self._slip))
        if self._curved:
            J = dolfinx.fem.petsc.assemble_matrix(self._J)
            J.assemble()
            J.scale(theta)
            parts.append(J)
        if self._matrix is None or self.constraint:
            A = self.K.copy()
            A.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
            A.scale(theta)
            pattern = DIFFERENT
        else:
            A, pattern = self._matrix, SUBSET
            A.zeroEntries()
            A.axpy(theta, self.K, SUBSET)
        for part in parts:
            A.axpy(1.0, part, pattern)
            part.destroy()
        A = self._saddle(A) if self.constraint else A
        if self._matrix is None:
            self._matrix = A
        elif A is not self._matrix:
            A.copy(self._matrix, SAME)
            A.destroy()
        return self._matrix

    def _saddle(self, A: PETSc.Mat) -> PETSc.Mat:
        assert self.constraint is not None
        G = self.constraint.G
        turned = PETSc.Mat()
        G.transpose(turned)
        rows = G.getSizes()[0]
        first, n = G.getOwnershipRange()[0], rows[0]
        places = np.arange(n + 1, dtype=PETSc.IntType)
        csr = (places, (first + places[:-1]).astype(PETSc.IntType), np.zeros(n))
        diagonal = PETSc.Mat().createAIJ((rows, rows), csr=csr, comm=self.comm)  # zeros: rows need a diagonal entry
        nest = PETSc.Mat().createNest([[A, turned], [G, diagonal]], comm=self.comm)
        whole = nest.convert("aij", PETSc.Mat())
        whole.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        for thing in (nest, turned, A, diagonal):
            thing.destroy()
        return whole

    # ---------------------------------------------------------------- an accepted step
    def audit(self, x: PETSc.Vec) -> tuple[tuple[npt.NDArray[np.float64], ...], Audit]:
        """Internal values and energy balance at the end of the step, for its solution x.

        Raises:
            SolveError: x is no equilibrium, whatever the solver said.
        """
        out, change = self.vector(), self._product
        self.residual(x, out)
        require_equilibrium(self, x, out)
        r, now = out.array_r[: self.n_displacements], self.u.x.petsc_vec
        now.copy(change)
        change.axpy(-1.0, self.old)
        at_supports = self.comm.allreduce(float(r[self.held] @ change.array_r[self.held]))
        supplied = self.loads.dot(change) + at_supports
        curved = self._curved_work(change)
        stored_now, stored_old, of_change = (self._elastic(v) for v in (now, self.old, change))
        stored, dissipated, total = stored_now - stored_old, 0.0, stored_now
        remainder = (2 * self.interval.theta - 1) * of_change
        if self._curved:
            first, last = (self._curved_energy(v) for v in (self.old, now))
            stored += last - first
            total += last
            remainder += curved - (last - first)
        before = self.interval.old.audit.layer
        layer = self.laws.audit(now, change, before, self.interval.t, self.interval.dt)
        if self.laws.points:
            stored += layer[0] - before
            total += layer[0]
            dissipated += layer[1]
            remainder += layer[2]
        memory = self.laws.memory
        if self.contact:
            self.require_unique()
            layer, slip = self.contact.audit(now, self.old, self._slip)
            memory.append(slip)
            change_of_layer = layer[0] - before
            stored += change_of_layer
            total += layer[0]
            dissipated += layer[1]
            remainder += layer[2] - change_of_layer - layer[1]
        out.destroy()
        audit = Audit(*map(float, (supplied, stored, dissipated, remainder, layer[0], total)))
        return tuple(memory), audit

    def _elastic(self, u: PETSc.Vec) -> float:
        self.K.mult(u, self._forces)
        return float(u.dot(self._forces)) / 2

    def _curved_forces(self) -> PETSc.Vec:
        """Nodal forces of the stresses that are not linear in the displacements."""
        b = dolfinx.fem.petsc.assemble_vector(self._F)
        b.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
        return b

    def body_forces(self, u: PETSc.Vec) -> npt.NDArray[np.float64]:
        """Nodal forces on this rank of the stresses that no compiled law answers for, those of the bodies."""
        self.K.mult(u, self._forces)
        if self._curved:
            u.copy(self.mid.x.petsc_vec)
            self.mid.x.scatter_forward()
            b = self._curved_forces()
            self._forces.axpy(1.0, b)
            b.destroy()
        return np.array(self._forces.array_r)

    def _curved_work(self, change: PETSc.Vec) -> float:
        """Their work, at the last residual's displacements."""
        if not self._curved:
            return 0.0
        b = self._curved_forces()
        found = float(b.dot(change))
        b.destroy()
        return found

    def _curved_energy(self, u: PETSc.Vec) -> float:
        if not all(p.law.traits.has_energy for p in self._curved):
            return float("nan")
        u.copy(self.mid.x.petsc_vec)
        self.mid.x.scatter_forward()
        return float(self.comm.allreduce(fem.assemble_scalar(fem.form(energy(self._curved, self.mid)))))

    def destroy(self) -> None:
        """Free the matrices."""
        self.laws.destroy()
        for thing in (self.K, self._matrix, self.constraint, self.contact, self._forces, self._product, self.loads):
            if thing is not None:
                thing.destroy()

    def collect(self) -> None:
        """Free what Python has dropped: PETSc keeps the objects of several ranks until all ranks are asked together."""
        if self.comm.size > 1:
            V = self.model.V
            comms = [
                self.comm,
                V.mesh.comm,
                V.dofmap.index_map.comm,
                *(p.B.getComm().tompi4py() for p in self.laws.points),
            ]
            for comm in comms:
                PETSc.garbage_cleanup(comm)
