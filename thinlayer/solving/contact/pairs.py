"""Contact nodes of one rank and their pairs, on all seams: tractions, tangents and sweeps."""

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
from thinlayer.system.compilation import own_library, pointers

C_SOURCE = Path(__file__).with_name("sweeps.c")
NodalLaw = ContactLaw | ContactHomotopy
Scalar = TypeVar("Scalar", bound=np.generic)  # type of the entries of an array
LawValues = Callable[[NodalLaw, Array, Array], npt.NDArray[Scalar]]  # of a law, jumps and slip


class ContactPairs:
    """Pairs of nodes in contact. A node may be the upper or the lower node of several pairs.

    Args:
        parts: the contact laws, each with its pairs.
        is_fixed: (N,) mask of the constrained displacements of this rank.
        first: global number of this rank's first node.
        shared: local numbers of nodes that are left out because pairs of other ranks have them too.

    Attributes:
        nodes: (n,) local numbers of this rank's nodes that are in a pair, ascending; in a result of `subset` they are
            indices of `nodes` of all pairs.
        dofs: (n d,) local numbers of the nodes' displacements.
        free: (n, d) mask of components that are not constrained.
        pair_nodes: (pairs, 2) upper and lower node, as indices of `nodes`; -1: the rigid base, or a node that is left out.
        d: number of dimensions.
        frames: (pairs, d, d) axes of S at the pairs: tangents, then the normal, as rows.
        weights: (pairs,) area of S (length in two dimensions) that belongs to each pair.
        gaps: (pairs, d) initial gap along the normal, in these axes; tangential components are zero.
    """

    def __init__(
        self, parts: Sequence[ContactPart], is_fixed: BoolArray, first: int = 0, shared: Sequence[int] | IntArray = ()
    ) -> None:
        self._parts, self.d = parts, parts[0].nodes.dim
        pairs = np.concatenate([part.nodes.pairs for part in parts]) - first
        pairs[(pairs < 0) | (pairs >= len(is_fixed) // self.d) | np.isin(pairs, shared)] = -1
        self.frames = np.concatenate([part.nodes.frames for part in parts])
        self.weights = np.concatenate([part.nodes.weights for part in parts])
        self.gaps = np.zeros((len(pairs), self.d))
        self.gaps[:, -1] = np.concatenate([part.nodes.gap for part in parts])
        sizes = [len(part.nodes.weights) for part in parts]
        self._part = np.repeat(np.arange(len(parts)), sizes)
        self._of_part = np.concatenate([np.arange(n) for n in sizes])
        self._number_nodes(pairs, ~is_fixed.reshape(-1, self.d))

    def subset(self, chosen: IntArray, weights: Array) -> ContactPairs:
        """Some of the pairs, with their nodes.

        Args:
            chosen: (k,) numbers of the pairs.
            weights: (k,) area of S that belongs to each of them.
        """
        pairs = copy(self)
        pairs.frames, pairs.gaps, pairs.weights = self.frames[chosen], self.gaps[chosen], weights
        pairs._part, pairs._of_part = self._part[chosen], self._of_part[chosen]
        pairs._number_nodes(self.pair_nodes[chosen], self.free)
        return pairs

    def _number_nodes(self, pairs: IntArray, free: BoolArray) -> None:
        """Number the nodes of pairs, and set the matrices between nodes and pairs.

        Args:
            pairs: (pairs, 2) upper and lower node, as indices of `free`; -1: no node.
            free: (nodes, d) mask of the components that are not constrained.
        """
        self.nodes, place = np.unique(np.concatenate([[-1], pairs.ravel()]), return_inverse=True)
        self.nodes = self.nodes[1:]
        self.pair_nodes, self.free = place[1:].reshape(-1, 2) - 1, free[self.nodes]
        self.dofs = (self.nodes[:, None] * self.d + np.arange(self.d)).ravel()
        pair, side = np.nonzero(self.pair_nodes >= 0)
        node, sign = self.pair_nodes[pair, side], np.where(side, -1, 1)
        # (pairs d, n d) matrix from displacements to jumps in the pairs' frames
        blocks, shape = self.frames[pair] * sign[:, None, None], (len(self.pair_nodes) * self.d, len(self.dofs))
        begins = np.searchsorted(pair, np.arange(len(self.pair_nodes) + 1))
        self.jump_matrix = bsr_matrix((blocks, node, begins), shape=shape).tocsr()
        self._to_nodes = self.jump_matrix.T.tocsr()
        # pairs of each node, node after node, in the format of the sweeps in C
        order = np.lexsort((pair, node))
        begins = np.searchsorted(node[order], np.arange(len(self.nodes) + 1))
        columns = pair[order], self.pair_nodes[pair, 1 - side][order], sign[order]
        self._by_node = [column.astype(np.int32) for column in (begins, *columns)]

    def _gather_values(self, values: LawValues[Scalar], w: Array) -> npt.NDArray[Scalar]:
        """Values (pairs, ...) of the function `values` of each pair's law, jump and slip, at jumps w (pairs, d)."""
        parts = [(part, self._part == k) for k, part in enumerate(self._parts)]
        return np.concatenate([values(part.law_now, w[mask], part.slip[self._of_part[mask]]) for part, mask in parts])

    def separation(self, u: Array) -> Array:
        """Jumps plus initial gaps along the normal (pairs, d), in the pairs' frames, at displacements u (n d,)."""
        return np.asarray((self.jump_matrix @ u).reshape(-1, self.d) + self.gaps)

    def forces(self, w: Array) -> Array:
        """Nodal forces (n d,) of the pairs at jumps w (pairs, d); zero at constrained components.

        They are to be added to the internal forces of the bodies.
        """
        return self.on_nodes(self.tractions(w))

    def on_nodes(self, t: Array) -> Array:
        """Nodal forces (n d,) of tractions t (pairs, d); zero at constrained components."""
        return np.where(self.free.ravel(), self._to_nodes @ (t * self.weights[:, None]).ravel(), 0.0)

    def tractions(self, w: Array) -> Array:
        """Tractions (pairs, d) of the laws at jumps w (pairs, d), initial gaps included."""
        return self._gather_values(lambda law, w, slip: law.traction(w, slip), w)

    def tangents(self, w: Array) -> Array:
        """Derivatives (pairs, d, d) of `tractions` by the jumps, at jumps w (pairs, d)."""
        return self._gather_values(lambda law, w, slip: law.tangent(w, slip), w)

    def bonded_tangents(self) -> Array:
        """Tangents (pairs, d, d) of pairs that neither open nor slide."""
        return self._gather_values(lambda law, w, _: law.bonded(*w.shape), self.gaps)

    def status(self, w: Array) -> npt.NDArray[np.int8]:
        """`Status` (pairs,) at jumps w (pairs, d): separated, sticking or sliding."""
        return self._gather_values(lambda law, w, slip: law.status(w, slip), w)

    def bonded(self) -> tuple[csr_matrix, Array]:
        """Stiffness (n d, n d) of pairs as springs that neither open nor slide, and nodal forces (n d,) at rest.

        The forces at rest are due to slip and gaps.
        """
        D = self.bonded_tangents()
        return self.stiffness(D), self.on_nodes(np.einsum("nij,nj->ni", D, self.offsets(self.gaps)))

    def stiffness(self, D: Array) -> csr_matrix:
        """Stiffness (n d, n d) of springs D (pairs, d, d) of the pairs; zero for constrained displacements."""
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

    def offsets(self, w: Array) -> Array:
        """Jumps w (pairs, d) whose tangential components are reduced by the slip at the start of the step."""
        return self._gather_values(lambda law, w, slip: np.column_stack([w[:, :-1] - slip, w[:, -1]]), w)

    def sweep(
        self, K: bsr_matrix, g: Array, u: Array, sweeps: int, gaps: Array | None = None, moves: BoolArray | None = None
    ) -> int:
        """Run Gauss-Seidel sweeps in place: each node moves to the balance of its forces while all others are fixed.

        Constrained components are fixed too.

        Args:
            K: (n, n) blocks (d, d) of the bodies' stiffness.
            g: (n d,) forces on the bodies.
            u: (n d,) displacements.
            sweeps: number of sweeps.
            gaps: (pairs, d) jumps where all u are zero; None: initial gaps.
            moves: (n,) mask of nodes that move; None: all.

        Returns:
            Number of solves of a node that failed; the node then keeps the best u of this solve.
        """
        gaps = self.gaps if gaps is None else gaps
        laws = self._gather_values(lambda law, w, _: np.tile(sweep_parameters(law), (len(w), 1)), gaps)
        pairs = *self._by_node, self.frames, self.weights, laws, self.offsets(gaps)
        free, c = self.free if moves is None else self.free & moves[:, None], own_library(C_SOURCE)
        arrays = pointers(c, K.indptr, K.indices, K.data, g, u, *pairs, free)
        return int(c.lib.sweep_pairs(len(self.nodes), self.d, *arrays, sweeps))


def sweep_parameters(law: NodalLaw) -> tuple[float, ...]:
    """Parameters of a contact law for Gauss-Seidel sweeps: K_N, K_T, friction, cohesion, and the weight of springs.

    A homotopy law is a weighted mean of a contact law and of springs that neither open nor slide. The weight of the
    springs is from 0 to 1; it is 0 for a contact law itself.
    """
    law, share = (law.law, law.share) if isinstance(law, ContactHomotopy) else (law, 0.0)
    assert law.numbers is not None
    return *law.numbers, share
