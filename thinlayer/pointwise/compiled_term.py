"""A compiled law at the quadrature points of a layer: strains, stresses and their nodal forces."""

from __future__ import annotations

from dataclasses import dataclass

import dolfinx.fem.petsc
import dolfinx.mesh
import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from forms.kinematics import MANDEL, ROOT2
from forms.law import LawError
from forms.work import Term
from thinlayer.pointwise.columns import Switching
from thinlayer.pointwise.kernels import Array
from thinlayer.pointwise.material import Material
from thinlayer.pointwise.quadrature import Origin, Quadrature

ROUNDED = np.finfo(float).tiny / np.finfo(float).eps ** 2  # tangents below may come of numbers that have lost digits
FALLING = 1e-3  # of a tangent's size, or of changes: that much below zero is no rounding
MOMENT = np.finfo(float).eps  # part of a step in which nothing happens
LEAST_STIFFNESS, MOST_STIFFNESS = 1e-6, 1e-3  # parts of the tangent at rest that are added to one that may vanish


@dataclass(frozen=True)
class Response:
    """What a law answers at the points of this rank.

    Attributes:
        stress: (points, m), at t + theta dt.
        tangent: (points, m, m).
        memory: (points, values) internal values at the end of the step.
        energies: stored, dissipated, remainder, integrated over this rank's points; NaN if the law declares no energy.
        failed: number of points of this rank where the law failed.
    """

    stress: Array
    tangent: Array
    memory: Array
    energies: Array
    failed: int

    @property
    def skew(self) -> float:
        """Largest difference between the tangent at a point of this rank and its transpose, over its size."""
        C = self.tangent
        apart, size = np.abs(C - C.swapaxes(1, 2)).max(axis=(1, 2)), np.abs(C).max(axis=(1, 2))
        regular = np.isfinite(apart) & (size > ROUNDED)
        return float((apart[regular] / size[regular]).max(initial=0.0))


class CompiledTerm(Quadrature):
    """Points where one compiled law acts. Collective.

    Attributes:
        material: the compiled law.
        switching: of a law whose phases are held in a solve and switched after it; else None.
    """

    def __init__(self, V: fem.FunctionSpace, term: Term, origin: Origin | None = None) -> None:
        super().__init__(V, term, origin)
        self.slots = [k for k, (_, j) in enumerate(MANDEL) if j < self.dim]
        self._strain_matrix(V)
        self.B.diagonalScale(L=self._vector(np.repeat(1 / self._integrals, len(self.slots))))
        self.material = Material(self.comm, term.law)
        self.switching = Switching(term.law, self.columns) if term.law.traits.switches else None
        self._at_rest = self._tangent_at_rest() if term.law.traits.singular else None

    def _strain_matrix(self, V: fem.FunctionSpace) -> None:
        """B: displacements -> strains at the points (m rows each); assembled once, as strains are linear."""
        W = self._space((len(self.slots),))
        du, q = ufl.TrialFunction(V), self.region.side(ufl.TestFunction(W))
        e = self.term.strain(du)
        rows = [e[i, j] * (1.0 if i == j else ROOT2) for i, j in (MANDEL[k] for k in self.slots)]
        form = fem.form(ufl.inner(ufl.as_vector(rows), q) * self._measure, entity_maps=self.region.maps)
        self.B = dolfinx.fem.petsc.assemble_matrix(form)
        self.B.assemble()
        self._strain, self._forces = self.B.createVecLeft(), self.B.createVecRight()

    def _vector(self, values: Array) -> PETSc.Vec:
        """A vector over the rows of B."""
        out = self.B.createVecLeft()
        out.array[:] = values
        return out

    def strain(self, u: PETSc.Vec) -> Array:
        """Strains (points, m) of a displacement vector. Collective."""
        self.B.mult(u, self._strain)
        return self._strain.array_r.reshape(self.count, len(self.slots)).copy()

    def respond(self, e: Array, e_old: Array, memory: Array, dt: float, theta: float) -> Response:
        """The law's answer to strains e after e_old and the internal values `memory`."""
        s, C, new, energies, failed = self.material.update(self.slots, e, e_old, memory, self.n, dt, theta)
        total = self.weights @ energies if self.term.law.traits.has_energy else np.full(3, np.nan)
        return Response(s, C, new, total, failed)

    def stored(self, e: Array, memory: Array, dt: float) -> float:
        """Energy of strains e and internal values after a step of length dt, over this rank's points; NaN if undeclared."""
        energies = self.material.update(self.slots, e, e, memory, self.n, MOMENT * dt, 1.0, held=True)[3]
        return float(self.weights @ energies[:, 0]) if self.term.law.traits.has_energy else np.nan

    def failure(self, response: Response) -> str:
        """What is not finite at the first point of this rank where the law failed, and where that is; "" if it did not."""
        at = np.flatnonzero(np.isnan(response.stress[:, 0]))[:1]
        if not len(at):
            return ""
        k, name = int(at[0]), type(self.term.law).__name__
        what = "stress" if np.isfinite(response.tangent[k]).all() else "tangent (the slope of the stress)"
        return f"the {what} of {name} is not finite at x = ({', '.join(f'{c:g}' for c in self.x[k])})"

    def falls(self, e: Array, e_old: Array, memory: Array, response: Response) -> int:
        """Number of this rank's points where stresses fall as the layer opens or slips, at strains e or since e_old.

        Jumps v make the strains sym(v (x) n): stresses fall where the tangent's form is negative for one of them, or, of a
        law that remembers nothing, where the work of the change of stress on the change of strain is.
        """
        law, m = self.term.law, len(self.slots)
        v = np.eye(3)[: self.dim]
        jumps = v[None, :, :, None] * self.n[:, None, None, :]
        jumps = (jumps + jumps.swapaxes(2, 3)) / 2
        rows = [jumps[..., i, j] * (1.0 if i == j else ROOT2) for i, j in (MANDEL[k] for k in self.slots)]
        N = np.stack(rows, axis=-1).reshape(self.count, len(v), m)
        A = N @ response.tangent @ N.swapaxes(1, 2)
        size = np.abs(A).max(axis=(1, 2), initial=0.0)
        known = np.isfinite(size) & (size > ROUNDED)
        down = np.zeros(self.count, bool)
        down[known] = np.linalg.eigvalsh((A + A.swapaxes(1, 2))[known] / 2)[:, 0] < -FALLING * size[known]
        if not (law.internal or law.traits.varies):
            change = e - e_old
            of_stress = response.stress - self.respond(e_old, e_old, memory, 0.0, 1.0).stress
            sizes = np.linalg.norm(change, axis=1) * np.linalg.norm(of_stress, axis=1)
            down |= np.sum(change * of_stress, axis=1) < -FALLING * sizes
        return int(np.count_nonzero(down))

    def ease(self, ease: float) -> None:
        """Let the law answer from now on with an ease, see `BulkLaw.eased`; 0: the law itself."""
        self.material.take(self.term.law.eased(ease) if ease else self.term.law)

    def at_time(self, t: float) -> None:
        """Let the law answer from now on with its parameters at a time. Collective.

        Raises:
            LawError: parameters out of range, on all ranks.
        """
        if not self.material.varies:
            return
        places, problem = self.joint_x, None
        try:
            self.material.take_at(places, t)
        except LawError as error:
            problem = str(error)
        if problem := next(filter(None, self.comm.allgather(problem)), None):
            raise LawError(problem)

    def _tangent_at_rest(self) -> Array:
        """Tangents (points, m, m) before anything happened; collective where parameters vary."""
        none = np.zeros((self.count, len(self.slots)))
        self.at_time(0.0)
        return self.respond(none, none, self.rest(), 0.0, 1.0).tangent

    def _regular(self, tangent: Array, lack: float) -> Array:
        """The tangents, with a small part of that at rest added where they have changed."""
        if self._at_rest is None:
            return tangent
        part = min(max(lack, LEAST_STIFFNESS), MOST_STIFFNESS)
        change, size = (np.abs(a).max(axis=(1, 2), initial=0.0) for a in (tangent - self._at_rest, self._at_rest))
        return tangent + part * self._at_rest * (change > 1e-9 * size)[:, None, None]

    def rest(self) -> Array:
        """Internal values before anything happened."""
        return np.zeros((self.count, self.material.memory))

    def forces(self, stress: Array) -> PETSc.Vec:
        """Nodal forces of stresses: int stress : e(v). The vector is overwritten by the next call. Collective."""
        weighted = self._vector((stress * self.weights[:, None]).ravel())
        self.B.multTranspose(weighted, self._forces)
        weighted.destroy()
        return self._forces

    def stiffness(self, tangent: Array, lack: float = 0.0) -> PETSc.Mat:
        """Matrix of int e(v) : tangent : e(du), for Newton's method. Collective.

        A tangent that may vanish (`Traits.singular`) gets a small part of that at rest, the more the larger the residual
        over the forces, `lack` (Levenberg and Marquardt): cells through the meshed layer that share a strain in any way
        they like would leave the matrix singular. What is found is the law's own equilibrium.
        """
        m, rows = len(self.slots), self.count * len(self.slots)
        first = self.B.getOwnershipRange()[0]
        indptr = np.arange(0, rows * m + 1, m, dtype=PETSc.IntType)
        blocks = np.arange(rows, dtype=PETSc.IntType).reshape(self.count, 1, m)
        indices = (first + np.broadcast_to(blocks, (self.count, m, m))).astype(PETSc.IntType).ravel()
        values = (self._regular(tangent, lack) * self.weights[:, None, None]).ravel()
        size = (self.B.getSizes()[0], self.B.getSizes()[0])
        D = PETSc.Mat().createAIJ(size, csr=(indptr, indices, values), comm=self.comm)
        A = D.ptap(self.B)
        D.destroy()
        return A

    def destroy(self) -> None:
        """Free the matrices."""
        for thing in (self.B, self._strain, self._forces):
            thing.destroy()
