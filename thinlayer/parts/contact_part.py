"""Forces of a contact law at the nodes of S, as a part of the balance of forces."""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from forms.base import Array, require
from forms.contact import ContactHomotopy, ContactLaw
from geometry.topology import Indices
from thinlayer.discretisation.contact_nodes import NO_DOFS, ContactNodes, ContactSurface
from thinlayer.discretisation.key import CONTACT_KIND
from thinlayer.parts.part import Block, FileOrder, Part, PartTraits, StepOutcome, TimeStep

MIN_SPRING_WEIGHT = 1e-8  # limit of the springs' share in the homotopy law as its continuation parameter tends to zero


class ContactPart(Part):
    """Forces, tangent, energies and memory of one contact law; the memory is the slip at the nodes of this rank.

    Args:
        law: the contact law.
        surface: the facets of S where the law acts.
        bc_dofs: local numbers of this rank's displacement components that supports prescribe. Gauss-Seidel sweeps of
            the contact solver leave them unchanged.
        key: name of the part in states and files.

    Attributes:
        law: the contact law.
        nodes: the n nodes of S on this rank.
        law_now: the law that forces are computed with: `law`, or a stiffer one that `set_homotopy` has chosen.
        slip: (n, d - 1) tangential slip at the beginning of the step, a length; d: number of dimensions.
    """

    def __init__(
        self, law: ContactLaw, surface: ContactSurface, bc_dofs: Indices = NO_DOFS, key: str = CONTACT_KIND
    ) -> None:
        require(isinstance(law, ContactLaw), "law", law, "it must be a contact law")
        law.check_threshold()
        law_traits = {name: getattr(law.traits, name) for name in ("remembers", "softens")}
        self.traits = PartTraits(nonlinear=True, releases=True, has_homotopy=True, **law_traits)
        self.key, self.law, self.nodes = key, law, ContactNodes(surface, bc_dofs, gap=law.gaps)
        self.law_now: ContactLaw | ContactHomotopy = law
        self.slip = self.rest()
        law.check_dimension(self.nodes.dim)
        self.distance = self.nodes.comm.allreduce(float(np.abs(self.nodes.gap).max(initial=0.0)), max)
        if self.nodes.lower_matrix is not None:
            squared_areas = self.nodes.comm.allreduce(float((self.nodes.weights**2).sum()))
            self.cancelling = float(max(law.K_N, law.K_T) * np.sqrt(squared_areas))

    def law_traits(self) -> dict[str, PartTraits]:
        return {type(self.law).__name__: self.traits}

    def rest(self) -> Array:
        return np.zeros((len(self.nodes.upper), self.nodes.dim - 1))

    def begin(self, interval: TimeStep) -> None:
        super().begin(interval)
        self.slip = interval.old.memory[self.key]

    def set_homotopy(self, parameter: float) -> None:
        self.law_now = self.law.homotopy(MIN_SPRING_WEIGHT ** (1 - parameter)) if parameter else self.law

    def evaluate(self, u: fem.Function, mid: fem.Function) -> None:
        self._u, self._w = u, self.nodes.separation(u.x.petsc_vec)

    def add_forces(self, out: PETSc.Vec) -> float:
        self.nodes.add_forces(self.law_now.traction(self._w, self.slip), out)
        return 0.0

    def tangents(self, relative_residual: float) -> list[Block]:
        """Return the tangent matrix at the displacements of the last call of `evaluate`, in a list with one block.

        While all jumps are zero, the law has no unique tangent. The matrix is then that of springs between the sides of
        S, which resist opening and slip.

        Args:
            relative_residual: norm of the last residual over the reference force; not used.
        """
        C = self.law_now.tangent(self._w, self.slip) if self._jumped else self.law.bonded(len(self._w), self.nodes.dim)
        return [Block(self.nodes.stiffness(C))]

    def reliable_tangents(self, relative_residual: float, rounding: PETSc.Vec) -> list[Block]:
        """Return the tangent matrix without the contact forces that are as small as rounding error.

        Solvers use it to find bodies that no contact holds. A node resists opening only if its pressure force exceeds
        the rounding error. It resists slip only if its friction limit exceeds the rounding error. While all jumps are
        zero, all nodes resist both.

        Args:
            relative_residual: norm of the last residual over the reference force.
            rounding: rounding error of each component of the nodal forces.
        """
        if not self._jumped:
            return self.tangents(relative_residual)
        nodes, p, C = self.nodes, self.law.pressure(self._w), self.law_now.tangent(self._w, self.slip)
        upper_error = rounding.array_r[nodes.dim * nodes.upper]
        lower_error = np.where(nodes.global_pairs[:, 1] >= 0, nodes.lower_side(rounding)[:, 0], np.inf)
        min_error = np.minimum(upper_error, lower_error)  # the force is as accurate as on the more accurate side
        C[nodes.weights * p <= min_error, -1] = 0.0
        C[nodes.weights * self.law.threshold(p) <= min_error, :-1] = 0.0
        return [Block(nodes.stiffness(C))]

    @property
    def _jumped(self) -> bool:
        return bool(self.nodes.comm.allreduce(int(self.nodes.jump(self._u.x.petsc_vec).any())))

    def commit(self) -> StepOutcome:
        w, law, nodes, old = self._w, self.law, self.nodes, self.interval.old
        stored, dissipated = law.energies(w, self.slip)
        t, jump_change = law.traction(w, self.slip), w - nodes.separation(old.u.x.petsc_vec)
        gap_work = t[:, -1] * nodes.gap * old.at_rest  # an interference is applied in the first step
        work_done = (t * jump_change).sum(axis=1) + gap_work
        sums = nodes.comm.allreduce(np.array([nodes.weights @ e for e in (stored, dissipated, work_done, gap_work)]))
        after, lost, work = map(float, sums[:3] if law.traits.has_energy else np.full(3, np.nan))
        before, memory = old.stored.get(self.key, 0.0), law.slip_after(w, self.slip)
        return StepOutcome(before, after, lost, work - (after - before) - lost, memory, supplied=float(sums[3]))

    def error_measure(self, u: fem.Function) -> Array:
        weighted: Array = self.nodes.jump(u.x.petsc_vec) * np.sqrt(self.nodes.weights)[:, None]
        return weighted.ravel()

    def unit_jump_measure(self) -> float:
        return float(self.nodes.comm.allreduce(float(self.nodes.weights.sum())))

    @property
    def file_order(self) -> FileOrder:
        node_numbers = self.nodes.node_ids
        return FileOrder(node_numbers, np.arange(len(node_numbers))[:, None])

    def destroy(self) -> None:
        self.nodes.destroy()
