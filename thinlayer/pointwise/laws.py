"""The compiled laws of a model over a time step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from forms.law import LawError
from forms.symmetry import NOT_SYMMETRIC
from thinlayer.discretisation.model import Model
from thinlayer.pointwise.columns import Switching
from thinlayer.pointwise.compiled_term import CompiledTerm, Response
from thinlayer.pointwise.kernels import Array
from thinlayer.solving.softening import may_soften

ASYMMETRY = 1e-8  # of a tangent, over its size


class PointLaws:
    """All places where compiled laws act. Collective, as all methods are.

    Attributes:
        points: the places, in the order of `Model.quadratures`.
        failed: number of points where a law failed in the last response.
        eased: ease of the laws, 0: themselves.
    """

    def __init__(self, model: Model) -> None:
        self.comm, self._symmetric = model.comm, model.symmetric
        places = [p for p in model.terms if p.law.pointwise]
        self.points = [CompiledTerm(model.V, p, model.origin) for p in places]
        self.failed, self.eased, self._t = 0, 0.0, 0.0
        self._responses: list[Response] = []

    def destroy(self) -> None:
        """Free the matrices."""
        for p in self.points:
            p.destroy()

    # ---------------------------------------------------------------- what the laws are like
    @property
    def can_ease(self) -> bool:
        """Whether laws can be replaced by easier ones."""
        return any(p.term.law.can_ease for p in self.points)

    @property
    def flat(self) -> bool:
        """Whether tangents of laws with an energy may vanish along some strains."""
        return any(p.term.law.flat for p in self.points)

    @property
    def switches(self) -> bool:
        """Whether phases are held in a solve and switched after it."""
        return any(p.switching for p in self.points)

    @property
    def steady(self) -> bool:
        """Whether the tangents of linear laws are the same for steps of all lengths."""
        return all(p.term.law.switches for p in self.points)

    def rest(self) -> list[Array]:
        """Internal values before anything happened."""
        return [p.rest() for p in self.points]

    # ---------------------------------------------------------------- a step
    def at_time(self, t: float) -> None:
        """Take the parameters of a time; raises LawError if one is out of range."""
        self._t = t
        for p in self.points:
            p.at_time(t)

    def ease(self, ease: float) -> None:
        """Replace the laws by ones between themselves (0) and an elastic layer (1)."""
        self.eased = ease
        for p in self.points:
            p.ease(ease)
            p.at_time(self._t)

    def begin(self, u: PETSc.Vec, memory: Sequence[Array], t: float) -> None:
        """Begin a step, at displacements u and internal values, with parameters at the time t where forces balance."""
        self._e_old = [p.strain(u) for p in self.points]
        self._begins = [*memory][: len(self.points)]
        self.at_time(t)

    def respond(self, u: PETSc.Vec, dt: float, theta: float) -> None:
        """The laws' answer to displacements u at the end of the step."""
        self._responses = [
            p.respond(p.strain(u), e_old, q, dt, theta)
            for p, e_old, q in zip(self.points, self._e_old, self._begins, strict=True)
        ]
        self.failed = self.comm.allreduce(sum(r.failed for r in self._responses)) if self.points else 0

    def failure(self) -> str:
        """At how many points laws failed in the last response, and of the first one what and where."""
        own = [p.failure(r) for p, r in zip(self.points, self._responses, strict=True)]
        every = [text for texts in self.comm.allgather(own) for text in texts if text]
        return f"the layer's law failed at {self.failed} points: {every[0]}" if every else ""

    def add_forces(self, forces: PETSc.Vec) -> None:
        """Add the nodal forces of the last response's stresses."""
        for p, r in zip(self.points, self._responses, strict=True):
            forces.axpy(1.0, p.forces(r.stress))

    def stiffness(self, lack: float) -> list[PETSc.Mat]:
        """Matrices of the last response's tangents, see `CompiledTerm.stiffness`; whoever calls destroys them.

        Raises:
            LawError: a law that says it is symmetric, and is not: half of its tangent would be lost.
        """
        if self.points and self._symmetric:
            found = np.array([r.skew for r in self._responses])
            self.comm.Allreduce(MPI.IN_PLACE, found, MPI.MAX)
            for p, skew in zip(self.points, found, strict=True):
                if skew > ASYMMETRY:
                    raise LawError(NOT_SYMMETRIC.format(type(p.term.law).__name__, skew))
        return [p.stiffness(r.tangent, lack) for p, r in zip(self.points, self._responses, strict=True)]

    def softened(self, u: PETSc.Vec) -> tuple[str, int]:
        """Name of a law that says nothing of softening and whose stresses fall at displacements u, the last response's.

        And the number of points; "" and 0 if there is none.
        """
        for p, e_old, q, r in zip(self.points, self._e_old, self._begins, self._responses, strict=True):
            law = p.term.law
            if not may_soften(law):
                continue
            if count := self.comm.allreduce(p.falls(p.strain(u), e_old, q, r)):
                return type(law).__name__, count
        return "", 0

    @property
    def memory(self) -> list[Array]:
        """Internal values of the last response."""
        return [r.memory for r in self._responses]

    @property
    def energies(self) -> Array:
        """Of the last response: stored, dissipated, remainder."""
        none = np.zeros(3)
        return (
            np.asarray(self.comm.allreduce(sum((r.energies for r in self._responses), none))) if self.points else none
        )

    def audit(self, u: PETSc.Vec, change: PETSc.Vec, before: float, t: float, dt: float) -> Array:
        """Of the last response, to displacements u: stored at the end of the step, dissipated, remainder.

        Laws know their own remainder only of parameters that stay the same: where they vary it is what is left of the work.

        Args:
            u, change: displacements at the end of the step, and their change in it.
            before: energy stored at its beginning.
            t, dt: its end and its length.
        """
        energies = self.energies
        if any(p.material.varies for p in self.points):
            if t != self._t:
                energies[0] = self._stored(u, t, dt)
            work = sum(float(p.forces(r.stress).dot(change)) for p, r in zip(self.points, self._responses, strict=True))
            energies[2] = work - (energies[0] - before) - energies[1]
        return energies

    def _stored(self, u: PETSc.Vec, t: float, dt: float) -> float:
        """Energy of the last response with the parameters of a time; the laws keep those that they answer with."""
        answering = self._t
        self.at_time(t)
        stored = sum(p.stored(p.strain(u), r.memory, dt) for p, r in zip(self.points, self._responses, strict=True))
        self.at_time(answering)
        return float(self.comm.allreduce(stored))

    # ---------------------------------------------------------------- phases that are held in a solve
    @property
    def excess(self) -> float:
        """Of the columns whose phases are held, by how much another phase is lower in energy, over C; <= 0: by nothing."""
        return max((s.excess(r.memory) for s, r, _ in self._switching), default=-np.inf)

    def switch(self) -> bool:
        """Let columns change to the phase of lowest energy in the last response; whether any does."""
        changed = False
        for switching, response, k in self._switching:
            new = switching.switched(response.memory, self._begins[k])
            if new is not None:
                self._begins[k], changed = new, True
        return changed

    @property
    def _switching(self) -> list[tuple[Switching, Response, int]]:
        both = zip(self.points, self._responses, strict=True)
        return [(p.switching, r, k) for k, (p, r) in enumerate(both) if p.switching]
