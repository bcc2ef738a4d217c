"""All pairs of nodes in contact of several seams, as one list: tractions and tangents for nodal displacements."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import scipy.sparse

from forms.base import Array
from forms.contact import ContactLaw, EasedContact
from geometry.topology import BoolArray
from thinlayer.parts.contact_part import ContactPart
from thinlayer.solving.contact.gauss_seidel import pointers
from thinlayer.system.compilation import own_library

SOURCE = Path(__file__).with_name("sweep_pairs.c")
Law = ContactLaw | EasedContact


class PairNodes:
    """The nodes that are in contact with others, on one rank. A node may be in several pairs, as their upper or lower one.

    Args:
        parts: the contact laws, each with its pairs.
        held: (N,) displacements, all of the model's, that supports prescribe.

    Attributes:
        nodes: (n,) nodes of the model's displacements that are in a pair, ascending.
        free: (n, d) components that are not held.
        d: dimension.
    """

    def __init__(self, parts: Sequence[ContactPart], held: BoolArray) -> None:
        self._parts, self.d = parts, parts[0].nodes.dim
        pairs = np.concatenate([part.nodes.pairs for part in parts])
        self.nodes, place = np.unique(np.concatenate([[-1], pairs.ravel()]), return_inverse=True)
        self.nodes = self.nodes[1:]
        self._ends = place[1:].reshape(-1, 2) - 1  # -1: the rigid base
        self._frames = np.concatenate([part.nodes.frames for part in parts])
        self._weights = np.concatenate([part.nodes.weights for part in parts])
        self._gaps = np.concatenate([part.nodes.gap for part in parts])
        self._of_part = np.split(np.arange(len(pairs)), np.cumsum([len(part.nodes.upper) for part in parts])[:-1])
        self.free = ~held.reshape(-1, self.d)[self.nodes]
        self._jumps = self._jump_matrix()
        self._sorted_by_node()
        own_library(SOURCE)

    def _jump_matrix(self) -> scipy.sparse.csr_matrix:
        """(pairs d, n d) from displacements to jumps in the pairs' frames."""
        d, count = self.d, len(self._ends)
        pair, side = np.nonzero(self._ends >= 0)
        sign = np.where(side, -1.0, 1.0)
        blocks = self._frames[pair] * sign[:, None, None]
        rows = (pair[:, None, None] * d + np.arange(d)[:, None]).repeat(d, axis=2)
        columns = (self._ends[pair, side][:, None, None] * d + np.arange(d)).repeat(d, axis=1)
        shape = (count * d, len(self.nodes) * d)
        return scipy.sparse.csr_matrix((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=shape)

    def _sorted_by_node(self) -> None:
        """The pairs of each node, one node after the other, as the sweeps read them."""
        pair, side = np.nonzero(self._ends >= 0)
        node = self._ends[pair, side]
        order = np.lexsort((pair, node))
        self._begins = np.searchsorted(node[order], np.arange(len(self.nodes) + 1)).astype(np.int32)
        self._pair = pair[order].astype(np.int32)
        self._other = self._ends[pair, 1 - side][order].astype(np.int32)
        self._sign = np.where(side, -1, 1)[order].astype(np.int32)

    def _gathered(self, of_part: Callable[[Law, Array, Array], Array], w: Array) -> Array:
        """(pairs, ...) values of each part's law at the jumps (pairs, d)."""
        parts = zip(self._parts, self._of_part, strict=True)
        return np.concatenate([of_part(part.now, w[own], part.slip) for part, own in parts])

    def apart(self, u: Array) -> Array:
        """(pairs, d) jumps, and initial gaps along the normal, in the pairs' frames at displacements (n d,)."""
        w = (self._jumps @ u).reshape(-1, self.d)
        w[:, -1] += self._gaps
        return np.asarray(w)

    def forces(self, u: Array) -> Array:
        """(n d,) forces of the pairs, to be added to those of the bodies; zero at held displacements."""
        t = self._gathered(lambda law, w, slip: law.traction(w, slip), self.apart(u))
        out = self._jumps.T @ (t * self._weights[:, None]).ravel()
        return np.where(self.free.ravel(), out, 0.0)

    def tangent(self, u: Array) -> scipy.sparse.csr_matrix:
        """(n d, n d) derivative of `forces`."""
        return self._stiffness(self._gathered(lambda law, w, slip: law.tangent(w, slip), self.apart(u)))

    def bonded(self) -> tuple[scipy.sparse.csr_matrix, Array]:
        """Stiffness of springs that neither open nor slide, and their forces on nodes at rest, by slip and gaps."""
        rest = np.zeros((len(self._weights), self.d))
        rest[:, :-1] = -np.concatenate([part.slip for part in self._parts])
        rest[:, -1] = self._gaps
        D = self._gathered(lambda law, w, _: law.bonded(*w.shape), rest)
        t = np.einsum("nij,nj->ni", D, rest) * self._weights[:, None]
        return self._stiffness(D), np.where(self.free.ravel(), self._jumps.T @ t.ravel(), 0.0)

    @property
    def pattern(self) -> scipy.sparse.csr_matrix:
        """A matrix with all entries that `tangent` and `bonded` may have."""
        n, d = len(self._ends), self.d
        pair, side = np.nonzero(self._ends >= 0)
        ends = scipy.sparse.csr_matrix((np.ones(len(pair)), (pair, self._ends[pair, side])), shape=(n, len(self.nodes)))
        return scipy.sparse.kron(ends.T @ ends, np.ones((d, d)), format="csr")

    def _stiffness(self, D: Array) -> scipy.sparse.csr_matrix:
        count, d = len(self._weights), self.d
        begins, columns = np.arange(count + 1), np.arange(count)
        blocks = scipy.sparse.bsr_matrix((D * self._weights[:, None, None], columns, begins), shape=(count * d,) * 2)
        free = scipy.sparse.diags(self.free.ravel().astype(float))
        jumps = self._jumps @ free
        return (jumps.T @ (blocks @ jumps)).tocsr()

    def sweep(self, stiffness: scipy.sparse.bsr_matrix, g: Array, u: Array, sweeps: int) -> None:
        """Gauss-Seidel sweeps, in place: each node finds the balance of its forces while all others rest.

        Nodes with a held component rest too.

        Args:
            stiffness: (n, n) blocks of the bodies' stiffness.
            g: (n d,) forces.
            u: (n d,) displacements.
            sweeps: number of sweeps.
        """
        numbers = self._gathered(lambda law, w, _: np.tile(_numbers(law), (len(w), 1)), self.apart(u))
        numbers = np.column_stack([numbers, self._gaps])
        slip = np.concatenate([part.slip for part in self._parts])
        moves = self.free.all(axis=1)
        arrays = (
            stiffness.indptr, stiffness.indices, stiffness.data, g, u, self._begins, self._pair, self._other, self._sign,
            self._frames, self._weights, numbers, slip, moves,
        )  # fmt: skip
        c, contiguous = own_library(SOURCE), map(np.ascontiguousarray, arrays)
        c.lib.sweep_pairs(len(self.nodes), self.d, *pointers(c, *contiguous), sweeps)


def _numbers(law: Law) -> tuple[float, ...]:
    """Parameters of a law for the sweeps: K_N, K_T, friction, cohesion, and the share of bonded springs."""
    law, share = (law.law, law.share) if isinstance(law, EasedContact) else (law, 0.0)
    assert law.numbers is not None
    return *law.numbers, share
