"""A contact law at the nodes of S, as a part of the balance of forces."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from forms.contact import ContactLaw
from thinlayer.contact.nodes import Array, ContactNodes
from thinlayer.discretisation.model import Model


class ContactSprings:
    """The springs of a contact law: forces, tangent, energies. Collective.

    Attributes:
        law: the law.
        nodes: where it acts.
    """

    def __init__(self, model: Model, law: ContactLaw, held: npt.NDArray[np.int32]) -> None:
        self.law, self.nodes = law, ContactNodes(model, held)

    def rest(self) -> Array:
        """Slip before anything happened, (n, d - 1)."""
        return np.zeros((len(self.nodes.upper), self.nodes.dim - 1))

    def add_forces(self, u: PETSc.Vec, slip: Array, out: PETSc.Vec) -> None:
        """Add the nodal forces at displacements u."""
        self.nodes.add_forces(self.law.traction(self.nodes.jump(u), slip), out)

    def stiffness(self, u: PETSc.Vec, slip: Array) -> PETSc.Mat:
        """Tangent at displacements u; at rest, where the law has none, that of bonded springs."""
        w = self.nodes.jump(u)
        moved = self.nodes.comm.allreduce(int(w.any()))
        return self.nodes.stiffness(self.law.tangent(w, slip) if moved else self.law.bonded(len(w), self.nodes.dim))

    @property
    def cancelling(self) -> float:
        """Stiffness, as a norm of its diagonal, of springs that see the difference of two bodies' displacements."""
        if self.nodes.lower is None:
            return 0.0
        areas = self.nodes.comm.allreduce(float((self.nodes.weights**2).sum()))
        return float(max(self.law.K_N, self.law.K_T) * np.sqrt(areas))

    def audit(self, u: PETSc.Vec, old: PETSc.Vec, slip: Array) -> tuple[Array, Array]:
        """Energy stored, dissipated in the step, work of the tractions in it; slip at its end. NaN without an energy."""
        w, law = self.nodes.jump(u), self.law
        stored, dissipated = law.energies(w, slip)
        worked = (law.traction(w, slip) * (w - self.nodes.jump(old))).sum(axis=1)
        sums = self.nodes.comm.allreduce(np.array([self.nodes.weights @ e for e in (stored, dissipated, worked)]))
        return (sums if law.traits.has_energy else np.full(3, np.nan)), law.slip_after(w, slip)

    def destroy(self) -> None:
        """Free the matrices."""
        self.nodes.destroy()
