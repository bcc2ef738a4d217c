"""Pairs of contact nodes of one rank, on all seams: their tractions, tangents and Gauss-Seidel sweeps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from pathlib import Path
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from scipy.sparse import bsr_matrix, csr_matrix

from forms.base import Array
from forms.contact import ContactHomotopy, ContactLaw
from geometry.topology import BoolArray, IntArray
from thinlayer.parts.contact_part import ContactPart
from thinlayer.system.compilation import c_pointers, load_own_library

C_SOURCE = Path(__file__).with_name("sweeps.c")
NodalLaw = ContactLaw | ContactHomotopy
Scalar = TypeVar("Scalar", bound=np.generic)  # type of the entries of an array
LawFunction = Callable[[NodalLaw, Array, Array], npt.NDArray[Scalar]]  # of a law, jumps and slip


class ContactPairs:
    """Pairs of an upper and a lower node in contact, with their contact laws. A node may belong to several pairs.

    Args:
        parts: the contact laws, each with its pairs.
        is_fixed: (N,) mask of the constrained displacements among the N of this rank.
        offset: global number of this rank's first node.
        shared: local numbers of nodes that are left out because pairs of other ranks contain them too.

    Attributes:
        nodes: (n,) local numbers of this rank's n nodes that are in a pair, ascending. In a result of `subset` they are
            positions in `nodes` of the original pairs.
        dofs: (n d,) local numbers of the displacements of these nodes.
        free: (n, d) mask of the displacement components of these nodes that are not constrained.
        pair_nodes: (pairs, 2) positions in `nodes` of the upper and the lower node of each pair. -1 stands for a rigid
            base, or for a node that is left out.
        d: number of dimensions.
        frames: (pairs, d, d) axes of S at the pairs, as rows: unit tangents, then the unit normal.
        weights: (pairs,) area of S (length in two dimensions) around each pair.
        gaps: (pairs, d) vector in these axes with the initial gap as its normal component, and zeros before it.
    """

    def __init__(
        self, parts: Sequence[ContactPart], is_fixed: BoolArray, offset: int = 0, shared: Sequence[int] | IntArray = ()
    ) -> None:
        self._parts, self.d = parts, parts[0].nodes.dim
        pairs = np.concatenate([part.nodes.global_pairs for part in parts]) - offset
        pairs[(pairs < 0) | (pairs >= len(is_fixed) // self.d) | np.isin(pairs, shared)] = -1
        self.frames = np.concatenate([part.nodes.frames for part in parts])
        self.weights = np.concatenate([part.nodes.weights for part in parts])
        self.gaps = np.zeros((len(pairs), self.d))
        self.gaps[:, -1] = np.concatenate([part.nodes.gap for part in parts])
        pair_counts = [len(part.nodes.weights) for part in parts]
        self._part_of_pair = np.repeat(np.arange(len(parts)), pair_counts)
        self._row_in_part = np.concatenate([np.arange(n) for n in pair_counts])
        self._number_nodes(pairs, ~is_fixed.reshape(-1, self.d))

    def subset(self, chosen: IntArray, weights: Array) -> ContactPairs:
        """Return some of the pairs, with their nodes.

        Args:
            chosen: (k,) numbers of the chosen pairs.
            weights: (k,) area of S (length in two dimensions) that each chosen pair has in the result.
        """
        pairs = copy(self)
        pairs.frames, pairs.gaps, pairs.weights = self.frames[chosen], self.gaps[chosen], weights
        pairs._part_of_pair, pairs._row_in_part = self._part_of_pair[chosen], self._row_in_part[chosen]
        pairs._number_nodes(self.pair_nodes[chosen], self.free)
        return pairs

    def _number_nodes(self, pairs: IntArray, free: BoolArray) -> None:
        """Number the nodes that are in a pair, and build the matrices between their displacements and the jumps.

        Args:
            pairs: (pairs, 2) upper and lower node of each pair, as row numbers of `free`; -1: no node.
            free: (nodes, d) mask of the displacement components that are not constrained, for all candidate nodes.
        """
        self.nodes, position = np.unique(np.concatenate([[-1], pairs.ravel()]), return_inverse=True)
        self.nodes = self.nodes[1:]
        self.pair_nodes, self.free = position[1:].reshape(-1, 2) - 1, free[self.nodes]
        self.dofs = (self.nodes[:, None] * self.d + np.arange(self.d)).ravel()
        pair, side = np.nonzero(self.pair_nodes >= 0)
        node, sign = self.pair_nodes[pair, side], np.where(side, -1, 1)
        # (pairs d, n d) matrix from displacements to jumps in the pairs' frames
        blocks, shape = self.frames[pair] * sign[:, None, None], (len(self.pair_nodes) * self.d, len(self.dofs))
        row_starts = np.searchsorted(pair, np.arange(len(self.pair_nodes) + 1))
        self.jump_matrix = bsr_matrix((blocks, node, row_starts), shape=shape).tocsr()
        self._jump_matrix_T = self.jump_matrix.T.tocsr()
        # pairs of each node, node after node, in the format of the sweeps in C
        order = np.lexsort((pair, node))
        row_starts = np.searchsorted(node[order], np.arange(len(self.nodes) + 1))
        pair_arrays = pair[order], self.pair_nodes[pair, 1 - side][order], sign[order]
        self._pairs_by_node = [array.astype(np.int32) for array in (row_starts, *pair_arrays)]

    def _gather_values(self, func: LawFunction[Scalar], w: Array) -> npt.NDArray[Scalar]:
        """Evaluate a function of a contact law, jumps and slip for all pairs, each with its own law and slip.

        Args:
            func: function of a law, and of the jumps (k, d) and the slip (k, d - 1) of its k pairs. It returns an
                array (k, ...).
            w: (pairs, d) jumps of all pairs in the axes `frames`, in d dimensions.

        Returns:
            Array (pairs, ...) of the function's values.
        """
        parts = [(part, self._part_of_pair == k) for k, part in enumerate(self._parts)]
        return np.concatenate([func(part.law_now, w[mask], part.slip[self._row_in_part[mask]]) for part, mask in parts])

    def jumps_with_gaps(self, u: Array) -> Array:
        """Return the jumps plus initial gaps (pairs, d), in the axes `frames`.

        Args:
            u: (n d,) displacements of the n nodes in d dimensions.
        """
        return np.asarray((self.jump_matrix @ u).reshape(-1, self.d) + self.gaps)

    def forces(self, w: Array) -> Array:
        """Return the nodal forces (n d,) of the contact laws, for n nodes in d dimensions.

        They are zero at constrained components. In the balance of forces they are added to the internal forces of the
        bodies.

        Args:
            w: (pairs, d) jumps in the axes `frames`, initial gaps included.
        """
        return self.nodal_forces(self.tractions(w))

    def nodal_forces(self, t: Array) -> Array:
        """Return the nodal forces (n d,) of given tractions on n nodes in d dimensions; zero at constrained components.

        Args:
            t: (pairs, d) tractions in the axes `frames`.
        """
        return np.where(self.free.ravel(), self._jump_matrix_T @ (t * self.weights[:, None]).ravel(), 0.0)

    def tractions(self, w: Array) -> Array:
        """Return the tractions (pairs, d) of the contact laws in d dimensions, in the axes `frames`.

        Args:
            w: (pairs, d) jumps in the same axes, initial gaps included.
        """
        return self._gather_values(lambda law, w, slip: law.traction(w, slip), w)

    def tangents(self, w: Array) -> Array:
        """Return the derivatives (pairs, d, d) of the tractions by the jumps in d dimensions, in the axes `frames`.

        Args:
            w: (pairs, d) jumps in the same axes, initial gaps included.
        """
        return self._gather_values(lambda law, w, slip: law.tangent(w, slip), w)

    def bonded_tangents(self) -> Array:
        """Return the traction per jump (pairs, d, d) of all pairs, as if none opened or slid, in d dimensions."""
        return self._gather_values(lambda law, w, _: law.bonded(*w.shape), self.gaps)

    def status(self, w: Array) -> npt.NDArray[np.int8]:
        """Return the contact status (pairs,) as integers of `Status`: separated, sticking or sliding.

        Args:
            w: (pairs, d) jumps in the axes `frames`, initial gaps included.
        """
        return self._gather_values(lambda law, w, slip: law.status(w, slip), w)

    def bonded_springs(self) -> tuple[csr_matrix, Array]:
        """Return the stiffness and the nodal forces at rest of pairs as springs that neither open nor slide.

        The stiffness is (n d, n d), the forces are (n d,), for n nodes in d dimensions. The forces at rest are those
        for zero displacements. They are due to initial gaps and to the slip before the time step.
        """
        D = self.bonded_tangents()
        return self.stiffness(D), self.nodal_forces(np.einsum("nij,nj->ni", D, self.elastic_jumps(self.gaps)))

    def stiffness(self, D: Array) -> csr_matrix:
        """Return the stiffness matrix (n d, n d), for n nodes in d dimensions, of springs between the nodes of pairs.

        Rows and columns of constrained displacements are zero.

        Args:
            D: (pairs, d, d) stiffness of the springs, as traction per jump in the axes `frames`.
        """
        d, frames = self.d, self.frames
        ends = self.pair_nodes[:, [0, 1, 0, 1]], self.pair_nodes[:, [0, 1, 1, 0]]
        pair, entry = np.nonzero((ends[0] >= 0) & (ends[1] >= 0))
        row, column = (end[pair, entry] for end in ends)
        pair_stiffness = (frames.transpose(0, 2, 1) * self.weights[:, None, None]) @ D @ frames
        blocks = pair_stiffness[pair] * np.where(entry < 2, 1.0, -1.0)[:, None, None]
        blocks = blocks * self.free[row][:, :, None] * self.free[column][:, None, :]
        rows = (row[:, None, None] * d + np.arange(d)[:, None]).repeat(d, axis=2)
        indices = rows.ravel(), (column[:, None, None] * d + np.arange(d)).repeat(d, axis=1).ravel()
        return csr_matrix((blocks.ravel(), indices), shape=(len(self.dofs),) * 2)

    def elastic_jumps(self, w: Array) -> Array:
        """Return the jumps (pairs, d), less the slip at the start of the time step in tangential components.

        Args:
            w: (pairs, d) jumps in the axes `frames`, in d dimensions.
        """
        return self._gather_values(lambda law, w, slip: np.column_stack([w[:, :-1] - slip, w[:, -1]]), w)

    def sweep(self, K: bsr_matrix, g: Array, u: Array, sweeps: int, gaps: Array | None = None) -> int:
        """Improve the displacements `u` in place by Gauss-Seidel sweeps over the nodes.

        In a sweep one node after another moves until its forces balance, with all other nodes fixed. Constrained
        components do not move.

        Args:
            K: (n d, n d) stiffness of the bodies at n nodes in d dimensions, in blocks (d, d).
            g: (n d,) nodal forces of the loads.
            u: (n d,) displacements; overwritten.
            sweeps: number of sweeps.
            gaps: (pairs, d) jumps in the axes `frames` that belong to u = 0. None: the initial gaps.

        Returns:
            Number of times that the forces of a node could not be balanced. The node then keeps the best displacement
                found.
        """
        gaps = self.gaps if gaps is None else gaps
        law_parameters = self._gather_values(lambda law, w, _: np.tile(sweep_parameters(law), (len(w), 1)), gaps)
        pair_data = *self._pairs_by_node, self.frames, self.weights, law_parameters, self.elastic_jumps(gaps)
        c = load_own_library(C_SOURCE)
        arrays = c_pointers(c, K.indptr, K.indices, K.data, g, u, *pair_data, self.free)
        return int(c.lib.sweep_pairs(len(self.nodes), self.d, *arrays, sweeps))


def sweep_parameters(law: NodalLaw) -> tuple[float, ...]:
    """Return the five numbers that the Gauss-Seidel sweeps need of a contact law.

    They are the stiffnesses K_N and K_T, the friction coefficient, the cohesion, and the weight of bonding springs. A
    homotopy law is the mean of a contact law and of springs that neither open nor slide. In this mean the springs have
    a weight between 0 and 1. For a contact law itself the weight is 0.
    """
    law, spring_weight = (law.law, law.spring_weight) if isinstance(law, ContactHomotopy) else (law, 0.0)
    assert law.numbers is not None
    return *law.numbers, spring_weight
