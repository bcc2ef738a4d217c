"""The class `StepProblem`: balance of forces of a time step in a user's script, for the user's own PETSc SNES."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from forms.base import Array, InputError, require
from forms.tensors import Expr
from forms.work import Term, work
from geometry.topology import Indices
from thinlayer.discretisation.form_compilation import compiled_terms
from thinlayer.discretisation.state import Configuration
from thinlayer.errors import SolveError
from thinlayer.parts.compiled_part import CompiledPart
from thinlayer.parts.form_part import FormPart
from thinlayer.parts.part import DISPLACEMENT_KEY, FieldPart, Part, TimeStep
from thinlayer.parts.ufl_part import multilinear
from thinlayer.pointwise.columns import EXCESS_TOLERANCE
from thinlayer.pointwise.compiled_term import CompiledTerm
from thinlayer.solving.part_sum import ForceScale, PartSum, TangentMatrix, UnknownLayout
from thinlayer.system.compat import belongs_to
from thinlayer.system.ranks import communicator, destroy, errors_on_all


class StepProblem(PartSum):
    """Balance of forces of a time step, in a user's script, for the user's own PETSc SNES.

    It sums a UFL form, integrals of laws of layers and bodies, and further parts, under Dirichlet conditions. It
    provides the residual and the Jacobian of the SNES. The user chooses the solvers and line searches::

        problem = StepProblem(R, u, bcs, terms)
        problem.attach(snes)
        for t in times:
            problem.begin(dt)                       # from the last accepted state
            snes.solve(None, u.x.petsc_vec)
            problem.accept()                        # keep the internal variables of the laws

    Args:
        form: UFL form of u, linear in a test function: the virtual work of all stresses that are not in `terms` or
            `parts`, minus the work of the loads.
        u: displacements of all bodies; their values at construction are the first state.
        bcs: Dirichlet conditions; their values are read in every evaluation of the residual.
        terms: integrals of the virtual work of laws, on any UFL measure: of a layer (`BrokenMesh.layer`) or a body
            (`forms.work.body`). Laws with memory or rate are compiled and evaluated at quadrature points; the others
            are added to the form.
        parts: further parts of the balance, such as a `ContactPart` or a user-defined `thinlayer.parts.part.Part`, each
            with its own key. The constructor evaluates their tangents in a step of length 0, for the nonzero pattern;
            `destroy` destroys the parts too.

    Attributes:
        state: displacements, time, memory and stored energies at the end of the last accepted step. Memory and energies
            have the keys of terms with compiled laws: "layer", or "layer 1", "layer 2", ... in the order of `terms`,
            and for bodies "body", or "body 1", ...
        energies: key of a compiled term or further part -> (3,) its energies at the end of the last accepted step. They
            are the stored energy, the energy dissipated in all steps, and the error of the time scheme in the energy
            balance of all steps. NaN if a law declares no energy.
        parts: the parts whose forces are summed; the first part is the form.
        traits: properties of all parts together: a flag is set if one part has it.
        failed: number of points where laws failed in the last evaluation.

    Raises:
        InputError: a law that needs its own pressure field; a form that is not linear in one test function; conditions
            on another space; a measure without tags; a space without jumps across S; an entry of `parts` that is not a
            Part, has unknowns of its own, or has the key of another part.
    """

    bc_dofs: Indices = np.empty(0, np.int32)  # empty: here the residual contains the Dirichlet conditions

    def __init__(
        self,
        form: Expr,
        u: fem.Function,
        bcs: Sequence[fem.DirichletBC] = (),
        terms: Iterable[Term] = (),
        parts: Iterable[Part] = (),
    ) -> None:
        V, terms, parts = u.function_space, list(terms), list(parts)
        if not isinstance(form, ufl.Form) or not multilinear(form) or len(form.arguments()) != bool(form.integrals()):
            raise InputError(f"the form is {str(form)[:80]}; it must be linear in one test function")
        if not all(belongs_to(bc, V) for bc in bcs):
            raise InputError("a condition of bcs is of another space than u; make it on u.function_space or its sub(i)")
        for term in terms:
            if term.law.traits.constrained:
                raise InputError(f"{type(term.law).__name__} needs a pressure of its own; use it in a Model")
            if term.bubble_strain is not None:
                raise InputError("order=2 has an unknown of its own on S; use it in a Model")
            _require_jumps(V, term)
        terms = [replace(term, law=term.law.compiled_copy()) if term.law.fields else term for term in terms]
        compiled = compiled_terms(terms)
        _check_parts(parts, {"forms", *compiled})
        form_terms = [term for term in terms if not term.law.traits.compiled]
        form_part = FormPart("forms", u, F=form + work(form_terms, u, ufl.TestFunction(V)) if form_terms else form)
        super().__init__([form_part, *(CompiledPart(key, V, term) for key, term in compiled.items()), *parts])
        self.comm, self._u, self._bcs = communicator(V.mesh), u, list(bcs)
        with errors_on_all(self.comm):
            for part in self.of_kind(CompiledPart):
                part.law.check_at(part.points.joint_x)
        self.state = Configuration(u.copy(), 0.0, self.memory_at_rest, stresses=self.stresses_at_rest, at_rest=True)
        self.energies = {part.key: np.zeros(3) for part in self.parts[1:]}
        layout = UnknownLayout(self.comm, {DISPLACEMENT_KEY: u})
        dofs = np.unique(np.concatenate([np.empty(0, np.int32), *(bc.dof_indices()[0] for bc in self._bcs)]))
        self._constrained_dofs = dofs[dofs < layout.sizes[DISPLACEMENT_KEY]]
        self._constrained_rows = layout.global_rows(self._constrained_dofs)
        self._forces, self._part_forces = layout.create_vector(), layout.create_vector()
        self._matrix = TangentMatrix(self.comm, layout.sizes)
        self.begin(0.0)
        self.forces(u, u, self._forces)
        self._tangent, self.scale, self._bc_stiffness = self._first_tangent()
        self._interval: TimeStep | None = None

    def _first_tangent(self) -> tuple[PETSc.Mat, ForceScale, float]:
        """Compute the tangent at the first state, and what is derived from the form's stiffness.

        Returns:
            The tangent, the reference forces for residuals, and the stiffness on the diagonal of constrained rows.
        """
        part_blocks = [part.tangents(0.0) for part in self.parts]
        form_diagonal = TangentMatrix(self.comm, self._matrix.sizes).fill(part_blocks[0]).getDiagonal()
        tangent = self._matrix.fill([block for blocks in part_blocks for block in blocks])
        k_form, k_all = (float(diag.norm(PETSc.NormType.INFINITY)) for diag in (form_diagonal, tangent.getDiagonal()))
        return tangent, ForceScale(float(form_diagonal.norm())), k_form or k_all

    @property
    def t(self) -> float:
        """Time at the end of the last accepted step."""
        return self.state.t

    @property
    def compiled(self) -> dict[str, CompiledTerm]:
        """Terms whose laws are compiled, by their keys.

        Each has methods `strain`, `respond`, `forces` and `stiffness`, which evaluate the law at its quadrature points.
        """
        return {part.key: part.points for part in self.of_kind(CompiledPart)}

    # ---------------------------------------------------------------- a step
    def attach(self, snes: PETSc.SNES) -> None:
        """Set the functions of an SNES that compute the residual and the Jacobian."""
        snes.setFunction(self.residual, self._forces.duplicate())
        snes.setJacobian(self.jacobian, self._tangent)

    def begin(self, dt: float) -> None:
        """Begin a time step from the last accepted state.

        After a step that failed, set u back to `state.u` and call `begin` again.

        Args:
            dt: length of the step, >= 0; 0: the loads change suddenly.
        """
        require(dt >= 0, "the length of a step", dt, "allowed: >= 0")
        self._interval = TimeStep(self.state, self.t + float(dt), float(dt), 1.0)
        self.begin_parts(self._interval)

    def residual(self, snes: PETSc.SNES | None, x: PETSc.Vec, out: PETSc.Vec) -> None:
        """Write the residual at displacements `x` into `out`: internal forces minus loads. It is NaN if a law fails.

        At a constrained dof the residual is the difference of `x` from the prescribed value, times a stiffness. This is
        the largest diagonal entry of the form's tangent. Such residuals are comparable with forces, so that line
        searches can add both.

        Args:
            snes: not used; PETSc passes it.
            x: the displacements.
            out: the residual; overwritten.
        """
        if x.handle != self._u.x.petsc_vec.handle:
            self._u.x.array[: x.getLocalSize()] = x.array_r
        self._u.x.scatter_forward()
        self._evaluate(out)
        dofs = self._constrained_dofs
        out.array[dofs] = self._bc_stiffness * (self._u.x.array[dofs] - self._bc_values())
        if self.failed:
            out.set(np.nan)

    def jacobian(self, snes: PETSc.SNES | None, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
        """Write the derivative of the residual into `P`, at the displacements where the residual was last evaluated.

        A row of a constrained dof has a stiffness on its diagonal and zeros elsewhere. A Newton step then reaches the
        prescribed value. As columns are not changed, the matrix is not symmetric.

        Args:
            snes: not used; PETSc passes it.
            x: not used; PETSc passes it.
            A: PETSc's Jacobian, which is usually the same matrix as `P`.
            P: matrix from which the preconditioner is built; overwritten.
        """
        self._matrix.fill(self.blocks()).zeroRows(self._constrained_rows, self._bc_stiffness)
        if P.handle != self._tangent.handle:
            self._tangent.copy(P)
        if A.handle != P.handle:
            A.assemble()

    def accept(self) -> None:
        """End the time step at the displacements u, and keep the internal variables there for the next step.

        Raises:
            SolveError: more than 1e-6 of the forces is out of balance, a law fails at u, or phases of a layer must
                change, see `switch`.
        """
        x, max_u = self._u.x.petsc_vec, float(self.state.u.x.petsc_vec.norm(PETSc.NormType.INFINITY))
        self.residual(None, x, self._forces)
        assert self._interval is not None
        self.scale.begin(0.0, self.comm.allreduce(float(np.abs(self._bc_values()).max(initial=0.0)), max), max_u)
        self.scale.update_stresses(max(self._force_norms))
        if self.residual_norms(self._forces) > self.scale.allowed_residual:
            # forces of the form may be larger than their sum, as thermal stresses are that balance each other
            tangent = TangentMatrix(self.comm, self._matrix.sizes).fill(self.parts[0].tangents(0.0))
            form_force_norm = float((tangent * x).norm())
            self.scale.update_stresses(max(*self._force_norms, form_force_norm))
        self.require_equilibrium(self._forces)
        if self.max_phase_gain > EXCESS_TOLERANCE:
            raise SolveError("columns of the layer must change phase: call switch() and solve until it returns False")
        outcomes, self.state = self.end_parts(self._u, self._interval.t)
        for key, old in self.energies.items():
            outcome = outcomes[key]
            self.energies[key] = np.array([outcome.after, old[1] + outcome.dissipated, old[2] + outcome.remainder])
        self._interval = None

    def switch(self) -> bool:
        """Change the phases of layers to those of lowest energy, facet by facet of S; return whether any changes.

        A phase is a branch of a law whose stress is not monotone. If any changes, solve the step again.
        """
        self._evaluate(self._forces)
        return super().switch()

    def destroy(self) -> None:
        """Free the matrices and destroy the parts."""
        destroy(*self.parts, self._matrix)

    # ---------------------------------------------------------------- within a step
    def _evaluate(self, out: PETSc.Vec) -> None:
        """Write internal forces minus loads at displacements u into `out`.

        At constrained dofs they are the reactions of the supports.
        """
        if self._interval is None:
            if self.state.memory:
                raise InputError("no step has begun: call begin(dt) before each solve")
            self.begin(0.0)
        self._force_norms = self.forces(self._u, self._u, out, self._part_forces)
        self._force_norms.append(float(out.norm()))

    def _bc_values(self) -> Array:
        """Return the prescribed values (n,) of the n constrained displacements of this rank."""
        prescribed = np.zeros(len(self._u.x.array))
        for bc in self._bcs:
            bc.set(prescribed)
        return np.asarray(prescribed[self._constrained_dofs])


def _require_jumps(V: fem.FunctionSpace, term: Term) -> None:
    """Raise InputError if displacements in the space `V` cannot jump across the facets of `term`. Collective.

    Only terms on interior facets are tested.
    """
    if term.measure.integral_type() != "interior_facet":
        return
    sides = np.concatenate([np.empty(0, np.int64), *(rows for _, rows in term.measure.subdomain_data())]).reshape(-1, 4)
    shared = [len(np.intersect1d(V.dofmap.cell_dofs(lower), V.dofmap.cell_dofs(upper))) for lower, _, upper, _ in sides]
    n_facet_nodes = len(V.dofmap.dof_layout.entity_closure_dofs(V.mesh.topology.dim - 1, 0))
    if communicator(V.mesh).allreduce(max(shared, default=0), max) >= n_facet_nodes:
        raise InputError("displacements do not jump across S in the space of u; make it by `BrokenMesh.space`")


def _check_parts(parts: Sequence[Part], used_keys: set[str]) -> None:
    """Raise InputError unless all `parts` are of the class `Part`, have no own unknowns, and have different keys.

    Args:
        parts: what the user has passed as parts.
        used_keys: keys that are already taken; the keys of the parts are added.
    """
    for part in parts:
        require(isinstance(part, Part), "one of parts", part, "allowed: what derives from thinlayer.parts.part.Part")
        if isinstance(part, FieldPart):
            raise InputError(f"the part {part.key!r} has unknowns of its own; use it in a Model")
        if part.key in used_keys:
            raise InputError(f"two parts are called {part.key!r}; give one of them another key")
        used_keys.add(part.key)
