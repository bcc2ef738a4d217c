"""Conditions direction . u = value at nodes, solved for the unknowns that they hold."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[Any]
Sparse = Any  # scipy.sparse.csr_matrix, which has no types
INDEPENDENT = 1e-6  # least singular value of directions at a node that are independent of each other


class Resolution:
    """The unknowns y, u = Q y, that conditions hold, and the forces that hold them.

    At a node whose conditions are along the axes y = u. At others the components in the space of the directions come first.

    Args:
        direction: (k, d) unit direction of each condition.
        blocks: (k,) its node.
        d: number of components at a node.
        size: number of displacements.

    Attributes:
        held: (n,) numbers of the held entries of y, increasing.
        solve: (n, k) sparse, values of the conditions -> held entries.
        same: (k, k) sparse, values of the conditions -> values that agree with each other; the same ones if they do.
        share: (k, size) sparse, nodal forces -> force along the direction of each condition: at each node the least ones.
    """

    def __init__(self, direction: Array, blocks: Numbers, d: int, size: int) -> None:
        count = len(direction)
        axis = np.abs(direction).argmax(axis=1) if count else np.empty(0, np.int64)
        along = (np.abs(direction) == 1.0).any(axis=1)
        sense = np.sign(direction[np.arange(count), axis])  # of a condition along an axis
        turned = np.isin(blocks, blocks[~along])
        plain = np.flatnonzero(~turned)
        dofs, first, inverse, times = np.unique(
            blocks[plain] * d + axis[plain], return_index=True, return_inverse=True, return_counts=True
        )
        held: list[Numbers] = [dofs]
        value = [
            scipy.sparse.csr_matrix((sense[plain[first]], (np.arange(len(dofs)), plain[first])), (len(dofs), count))
        ]
        # entries of three matrices: what the values at a node say of each value, and shares of forces
        same: list[tuple[Numbers, Numbers, Numbers]] = [
            (plain, plain[first][inverse], sense[plain] * sense[plain[first][inverse]])
        ]
        share: list[tuple[Numbers, Numbers, Numbers]] = [(plain, dofs[inverse], sense[plain] / times[inverse])]
        frame: list[tuple[Numbers, Array]] = []
        others = np.flatnonzero(turned)
        others = others[np.argsort(blocks[others], kind="stable")]
        ends = np.flatnonzero(np.diff(blocks[others])) + 1
        for rows in np.split(others, ends) if len(others) else []:
            block = blocks[rows[0]]
            N = direction[rows]
            _, sizes, right = np.linalg.svd(N)
            rank = int((sizes > INDEPENDENT).sum())
            if rank == d:
                right = np.eye(d)
            from_values = np.linalg.pinv(
                N @ right[:rank].T, rcond=INDEPENDENT
            )  # values of the conditions -> held unknowns
            own = block * d + np.arange(d)
            held.append(own[:rank])
            value.append(_at(from_values, np.arange(rank), rows, (rank, count)))
            same.append(_triplets(N @ right[:rank].T @ from_values, rows, rows))
            share.append(_triplets(np.linalg.pinv(N.T, rcond=INDEPENDENT), rows, own))
            if rank < d:
                frame.append((own, right))
        dofs, order = np.unique(np.concatenate(held), return_index=True)
        self.held = dofs.astype(np.int32)
        self.solve = scipy.sparse.vstack(value).tocsr()[order]
        self.same, self.share = _sum_of(same, (count, count)), _sum_of(share, (count, size))
        self._frame, self._size = frame, size

    @property
    def turned(self) -> bool:
        """Whether y has other directions than the displacements."""
        return bool(self._frame)

    @property
    def frames(self) -> Sparse:
        """Q: at each turned node the columns are the directions of y."""
        others = np.ones(self._size, bool)
        for own, _ in self._frame:
            others[own] = False
        same = np.flatnonzero(others)
        return _sum_of(
            [(same, same, np.ones(len(same))), *(_triplets(B.T, own, own) for own, B in self._frame)], (self._size,) * 2
        )


def _triplets(block: Numbers, rows: Numbers, columns: Numbers) -> tuple[Numbers, Numbers, Numbers]:
    """A dense block as (rows, columns, values)."""
    i, j = np.meshgrid(rows, columns, indexing="ij")
    return i.ravel(), j.ravel(), np.asarray(block).ravel()


def _at(block: Array, rows: Numbers, columns: Numbers, shape: tuple[int, int]) -> Sparse:
    return _sum_of([_triplets(block, rows, columns)], shape)


def _sum_of(triplets: list[tuple[Numbers, Numbers, Numbers]], shape: tuple[int, int]) -> Sparse:
    rows, columns, values = (np.concatenate(some) for some in zip(*triplets, strict=True))
    return scipy.sparse.csr_matrix((values, (rows.astype(np.int64), columns.astype(np.int64))), shape)
