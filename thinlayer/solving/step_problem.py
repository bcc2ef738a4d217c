"""StepProblem: the balance of forces of a time step in a user's own script, for the user's own PETSc SNES."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import dolfinx.fem.petsc
import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from forms.kinematics import Expr
from forms.law import LawError
from forms.work import Term, work
from thinlayer.errors import ModelError, SolveError
from thinlayer.pointwise.columns import TIE
from thinlayer.pointwise.compiled_term import CompiledTerm, Response
from thinlayer.pointwise.kernels import Array
from thinlayer.solving.force_scale import ALLOWED

DIFFERENT, SUBSET = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN


@dataclass
class _Remembering:
    """A compiled term with its last response, and its strains and memory at the beginning of the step."""

    term: CompiledTerm
    strain: Array
    memory: Array
    response: Response


class StepProblem:
    """The balance of forces of a time step: a UFL form, terms of layers and bodies, and prescribed displacements.

    It gives a PETSc SNES its function and its Jacobian. The user chooses the solvers and line searches:

        problem = StepProblem(R, u, bcs, terms)
        problem.attach(snes)
        for t in times:
            problem.begin(dt)                       # from the state that was accepted last
            snes.solve(None, u.x.petsc_vec)
            problem.accept()                        # keep the laws' internal values

    Args:
        form: virtual work of the other stresses less that of the loads, a UFL form of u, linear in a test function.
        u: displacements of all bodies; their values when the problem is made are the first state.
        bcs: Dirichlet conditions; their values are read at every residual.
        terms: terms of laws on any UFL measure: of a layer (`BrokenMesh.layer`) or a body (`forms.work.body`). Laws with
            memory or rate are compiled and run at quadrature points; the others are added to the form.

    Attributes:
        t: time at the end of the last accepted step.
        compiled: the compiled terms, with their `strain`, `respond`, `forces` and `stiffness`.
        memory: internal variables (points, values) of each compiled term on this rank, at the last accepted state.
        energies: of the compiled terms at the last accepted state: stored; dissipated in all steps; the time scheme's error
            of the balance of energy in all steps. NaN if a law declares no energy.

    Raises:
        LawError: a law that needs its own pressure field.
        ModelError: a measure without tags.
    """

    def __init__(
        self, form: Expr, u: fem.Function, bcs: Sequence[fem.DirichletBC] = (), terms: Iterable[Term] = ()
    ) -> None:
        V, terms = u.function_space, list(terms)
        for term in terms:
            if term.law.traits.constrained:
                raise LawError(f"{type(term.law).__name__} needs a pressure of its own; use it in a Model")
        ufl_terms = [term for term in terms if not term.law.traits.compiled]
        residual = form + work(ufl_terms, u, ufl.TestFunction(V)) if ufl_terms else form
        self._u, self._bcs = u, list(bcs)
        self._R = _compiled(residual)
        self._J = _compiled(ufl.derivative(residual, u, ufl.TrialFunction(V)))
        self.t, self._dt, self.energies = 0.0, np.nan, np.zeros(3)
        self._remembering = [self._at_rest(CompiledTerm(V, term)) for term in terms if term.law.traits.compiled]
        size = V.dofmap.index_map.size_local * V.dofmap.index_map_bs
        held = np.unique(np.concatenate([np.empty(0, np.int32), *(bc.dof_indices()[0] for bc in self._bcs)]))
        self._held = held[held < size]
        self._held_rows = (self._held + V.dofmap.index_map.local_range[0] * V.dofmap.index_map_bs).astype(PETSc.IntType)
        self._forces = PETSc.Vec().createMPI((size, None), comm=V.mesh.comm)
        self._matrix = dolfinx.fem.petsc.assemble_matrix(self._J[0])
        self._matrix.assemble()
        for form in self._J[1:]:
            self._add(dolfinx.fem.petsc.assemble_matrix(form), self._matrix, DIFFERENT)
        self._stiffness = float(self._matrix.getDiagonal().norm(PETSc.NormType.INFINITY))
        for one in self._remembering:
            self._add(one.term.stiffness(one.response.tangent), self._matrix, DIFFERENT)
        self._stiffness = self._stiffness or float(self._matrix.getDiagonal().norm(PETSc.NormType.INFINITY))
        self._matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        merged, self._matrix = self._matrix, self._matrix.copy()
        merged.destroy()

    def _at_rest(self, term: CompiledTerm) -> _Remembering:
        e, rest = term.strain(self._u.x.petsc_vec), term.rest()
        term.at_time(0.0)
        return _Remembering(term, e, rest, term.respond(e, e, rest, 0.0, 1.0))

    @property
    def compiled(self) -> list[CompiledTerm]:
        """The compiled terms."""
        return [one.term for one in self._remembering]

    @property
    def memory(self) -> list[Array]:
        """Internal variables of each compiled term on this rank, (points, values)."""
        return [one.memory for one in self._remembering]

    # ---------------------------------------------------------------- a step
    def attach(self, snes: PETSc.SNES) -> None:
        """Give an SNES the residual and the Jacobian."""
        snes.setFunction(self.residual, self._forces.duplicate())
        snes.setJacobian(self.jacobian, self._matrix)

    def begin(self, dt: float) -> None:
        """Begin a step of length dt >= 0 from the last accepted state; 0 is a sudden load.

        After a step that failed, set u back to the last accepted state and call `begin` again.
        """
        if not dt >= 0:
            raise ModelError(f"the length of a step is {dt}; allowed: >= 0")
        self._dt = float(dt)
        for one in self._remembering:
            one.term.at_time(self.t + self._dt)

    def residual(self, snes: PETSc.SNES | None, x: PETSc.Vec, out: PETSc.Vec) -> None:
        """Residual at displacements x: internal forces less loads; all NaN if a law fails.

        For prescribed displacements it is the difference of x from them, times a stiffness of the form: line searches add
        both kinds up.
        """
        self._put(x)
        self._balance(out)
        out.array[self._held] = self._stiffness * self._support_errors()
        if self._failures():
            out.set(np.nan)

    def jacobian(self, snes: PETSc.SNES | None, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
        """Derivative of the residual at the displacements of its last call.

        The rows of prescribed displacements are those of the identity times a stiffness, so that a Newton step meets the
        prescribed values: the matrix is not symmetric.
        """
        P.zeroEntries()
        for form in self._J:
            dolfinx.fem.petsc.assemble_matrix(P, form)
        P.assemble()
        for one in self._remembering:
            self._add(one.term.stiffness(one.response.tangent), P, SUBSET)
        P.zeroRows(self._held_rows, self._stiffness)
        if A.handle != P.handle:
            A.assemble()

    def accept(self) -> None:
        """End the step at the displacements u: the next step begins with the internal variables there.

        Raises:
            SolveError: more than 1e-6 of the forces is out of balance, a law fails at u, or a column must change phase, see
                `switch`.
        """
        out = self._forces
        self._put(self._u.x.petsc_vec)
        size = self._balance(out)
        if failed := self._failures():
            first = next(filter(None, self._gathered([one.term.failure(one.response) for one in self._remembering])))
            raise SolveError(f"laws fail at {failed} points: {first}")
        out.array[self._held] = self._stiffness * self._support_errors()
        if (unbalanced := float(out.norm())) > ALLOWED * size:
            share = unbalanced / max(size, unbalanced)
            raise SolveError(f"u is no equilibrium: {share:.3g} of the forces are out of balance")
        columns = [(one.term.switching, one.response) for one in self._remembering if one.term.switching]
        if any(switching.excess(response.memory) > TIE for switching, response in columns if switching):
            raise SolveError(
                "columns of the layer must change phase: call switch() and solve again until it returns False"
            )
        found = sum((one.response.energies for one in self._remembering), np.zeros(3))
        stored, dissipated, remainder = self._comm_sum(found)
        self.energies = np.array([stored, self.energies[1] + dissipated, self.energies[2] + remainder])
        for one in self._remembering:
            one.strain, one.memory = one.term.strain(self._u.x.petsc_vec), one.response.memory
        self.t, self._dt = self.t + self._dt, np.nan

    def switch(self) -> bool:
        """Change columns of laws with phases to the phase of lowest energy. True if any changes: solve the step again."""
        changed = False
        self._respond()
        for one in self._remembering:
            new = one.term.switching.switched(one.response.memory, one.memory) if one.term.switching else None
            if new is not None:
                one.memory, changed = new, True
        return changed

    def destroy(self) -> None:
        """Free the matrices."""
        for thing in (self._matrix, self._forces, *self.compiled):
            thing.destroy()

    # ---------------------------------------------------------------- within a step
    def _put(self, x: PETSc.Vec) -> None:
        if x.handle != self._u.x.petsc_vec.handle:
            self._u.x.array[: x.getLocalSize()] = x.array_r
        self._u.x.scatter_forward()

    def _balance(self, out: PETSc.Vec) -> float:
        """Write internal forces less loads, reactions included; returns the largest of their norm and the terms' norms."""
        out.set(0.0)
        for form in self._R:
            b = dolfinx.fem.petsc.assemble_vector(form)
            b.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
            out.array[:] += b.array_r
            b.destroy()
        self._respond()
        size = 0.0
        for one in self._remembering:
            forces = one.term.forces(one.response.stress)
            size = max(size, float(forces.norm()))
            out.axpy(1.0, forces)
        return max(size, float(out.norm()))

    def _support_errors(self) -> Array:
        """Displacements u less prescribed values, at the held displacements."""
        prescribed = np.zeros(len(self._u.x.array))
        for bc in self._bcs:
            bc.set(prescribed)
        return np.asarray(self._u.x.array[self._held] - prescribed[self._held])

    def _respond(self) -> None:
        if self._remembering and np.isnan(self._dt):
            raise ModelError("no step has begun: call begin(dt) before each solve")
        for one in self._remembering:
            e = one.term.strain(self._u.x.petsc_vec)
            one.response = one.term.respond(e, one.strain, one.memory, self._dt, 1.0)

    @staticmethod
    def _add(K: PETSc.Mat, A: PETSc.Mat, pattern: PETSc.Mat.Structure) -> None:
        K.assemble()
        A.axpy(1.0, K, pattern)
        K.destroy()

    def _failures(self) -> int:
        return int(self._comm_sum(np.array([sum(one.response.failed for one in self._remembering)]))[0])

    def _comm_sum(self, values: Array) -> Array:
        return np.asarray(self._remembering[0].term.comm.allreduce(values)) if self._remembering else values

    def _gathered(self, texts: list[str]) -> list[str]:
        return [text for every in self._remembering[0].term.comm.allgather(texts) for text in every]


def _compiled(form: ufl.Form) -> list[fem.Form]:
    """Compiled forms whose sum is the form; each has one set of tags per type of integral, as DOLFINx requires."""
    groups: list[list[ufl.Integral]] = []
    for integral in form.integrals():
        kind, tags = integral.integral_type(), integral.subdomain_data()
        for group in groups:
            if all(other.subdomain_data() is tags for other in group if other.integral_type() == kind):
                group.append(integral)
                break
        else:
            groups.append([integral])
    return [fem.form(ufl.Form(group)) for group in groups]
