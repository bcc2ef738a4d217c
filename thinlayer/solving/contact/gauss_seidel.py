"""Gauss-Seidel for contact with friction: sweeps over the contact nodes, and the relaxation of the paper over all dofs.

Functions of numpy arrays, which C reads unchecked. In parallel, call `load` first: otherwise every process compiles it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse
from mpi4py import MPI

from forms.base import Array
from forms.contact import ContactLaw, Status
from geometry.topology import BoolArray, Indices
from thinlayer.system.compilation import library, own_library

Sliding = tuple[npt.NDArray[np.int8], Array]  # status of nodes (n,), and their tangential jumps less slip (n, d - 1)

SOURCE = Path(__file__).with_name("sweeps.c")
CHUNK = 256  # number of sweeps between two tests of the increments
PATIENCE = 2048  # least number of sweeps of a relaxation that stagnates
GROWTH = 1e8  # growth of the changes, relative to the largest of the first sweeps, that means divergence
NO_PROGRESS = 0.999  # ratio of the least increments of the later and the earlier half of all sweeps: stagnation
KINDS = {"i": "int32_t[]", "B": "uint8_t[]", "?": "uint8_t[]", "d": "double[]"}  # dtype.name would take 5 times as long


def load(comm: MPI.Intracomm) -> None:
    """Compile the C code of this module, once for all processes. Collective."""
    library(SOURCE, comm)


def pointers(c: Any, *arrays: npt.NDArray[Any] | None) -> list[Any]:
    """Pointers to contiguous arrays for C; None becomes NULL."""
    return [c.ffi.NULL if a is None else c.ffi.from_buffer(KINDS[a.dtype.char], a) for a in arrays]


def sorted_blocks(A: scipy.sparse.csr_matrix, d: int) -> scipy.sparse.bsr_matrix:
    """A matrix of nodes in blocks of d x d, as sweeps read it."""
    blocks = A.tobsr((d, d))
    blocks.sort_indices()
    return blocks


def sweep_nodes(
    matrix: Array | scipy.sparse.bsr_matrix,
    g: Array,
    u: Array,
    base: Array,
    frames: Array,
    weights: Array,
    numbers: Sequence[float],
    *,
    slip: Array | None = None,
    moves: BoolArray | None = None,
    sweeps: int = 1,
) -> float:
    """Gauss-Seidel sweeps over n contact nodes, in place: each node solves exactly for its d components.

    Node i solves sum_j A_ij u_j + weights_i frames_i^T t(w_i) = g_i with w_i = frames_i (u_i - base_i). If friction is so
    strong that there are several solutions, a solution without tangential traction is preferred, then one that sticks.
    All arrays are C-contiguous, of float64.

    Args:
        matrix: stiffness of the contact dofs, force per length, (n d, n d) with the d dofs of a node next to each other,
            or its blocks. Its diagonal blocks are positive definite.
        g: (n, d) forces on the nodes, in global axes.
        u: (n, d) displacements, in global axes.
        base: (n, d) displacements of the other side, in global axes.
        frames: (n, d, d) rows are orthonormal axes of S: tangents, then the normal, which points out of the other side.
        weights: (n,) areas (lengths in two dimensions) of the nodes.
        numbers: `ContactLaw.numbers`.
        slip: (n, d - 1) slip at the beginning of the step; None: zero.
        moves: (n,) whether a node is swept; None: all are.
        sweeps: number of sweeps.

    Returns:
        The largest change of a component of u in the last sweep; NaN if a node had no solution (numbers that are not
        finite, a diagonal block that is not positive definite). Such a node keeps its u.
    """
    n, d = u.shape
    rows = (matrix, None, None) if isinstance(matrix, np.ndarray) else (matrix.data, matrix.indptr, matrix.indices)
    moves = np.ones(n, bool) if moves is None else moves
    c = own_library(SOURCE)
    arrays = (*rows, g, u, base, frames, weights, np.array(numbers), slip, None, moves)
    return float(c.lib.sweep_nodes(n, d, *pointers(c, *arrays), sweeps))


# ---------------------------------------------------------------- nodes whose slip has reversed
def sliding(law: ContactLaw, w: Array, slip: Array) -> Sliding:
    """Sliding state at jumps (n, d), for a later `turned`."""
    return law.status(w, slip), w[:, :-1] - slip


def turned(law: ContactLaw, w: Array, slip: Array, at: Sliding | None) -> Array:
    """Changes (n, d) of the jumps that make nodes stick whose slip direction has reversed since the last tangents.

    A sliding node has no stiffness of its own along its slip. If it should stick, Newton's method can move it to and fro
    for ever, and sweeps do not stop that.
    """
    out = np.zeros_like(w)
    if at is None:
        return out
    (status, old), (new_status, now) = at, sliding(law, w, slip)
    back = (status == Status.SLIDING) & (new_status == Status.SLIDING) & ((old * now).sum(axis=1) < 0)
    way = old[back] - now[back]
    part = -(now[back] * way).sum(axis=1) / (way**2).sum(axis=1)
    out[back, :-1] = part[:, None] * way
    return out


# ---------------------------------------------------------------- the relaxation of the paper
@dataclass(frozen=True)
class Relaxation:
    """The result of `relax`.

    Attributes:
        u: (N,) the last iterate.
        converged: whether the increments met their tolerance.
        increments: (sweeps,) Euclidean norm of the change of u in each sweep, relative to that of u.
    """

    u: Array
    converged: bool
    increments: Array


def relax(
    A: scipy.sparse.csr_matrix,
    b: Array,
    contact: Indices,
    weights: Array,
    law: ContactLaw,
    *,
    u: Array | None = None,
    slip: Array | None = None,
    order: Indices | None = None,
    omega: float = 1.0,
    omega_contact: float = 1.0,
    tolerance: float = 1e-8,
    max_sweeps: int = 100_000,
) -> Relaxation:
    """The relaxation of section 8 of the paper: over-relaxed Gauss-Seidel, component by component over all N dofs.

    With the diagonal a, the remainder r of the row, the weight b and the threshold rho of a node, its normal component
    becomes r / a if that opens S, else r / (a + b K_N). Its tangential component becomes r / (a + b K_T) if it sticks, else
    (r -+ b rho) / a; in three dimensions both tangential components are found together, on a disc. Unlike in the paper
    thresholds follow the pressure within the sweeps, and omega is 1 at contact nodes: the same omega everywhere fails for
    many meshes and stiffnesses.

    Args:
        A: stiffness; rows of held dofs are those of the identity. Dofs of contact nodes are jumps in the axes of S.
        b: (N,) forces.
        contact: (n, d) dofs of the contact nodes: tangential ones, then the normal one, positive if S opens.
        weights: (n,) areas (lengths in two dimensions) of the nodes.
        law: the law.
        u: (N,) first iterate, not changed; None: zero.
        slip: (n, d - 1) slip at the beginning of the step; None: zero.
        order: (N,) dofs in the order of a sweep; both tangential dofs of a node are swept at the place of the first of
            them. None: in the order of the numbers, but at contact nodes the normal component first.
        omega: relaxation factor of the other dofs.
        omega_contact: relaxation factor of the contact dofs.
        tolerance: of the increment of a sweep, as in `Relaxation.increments`.
        max_sweeps: largest number of sweeps.

    Returns:
        The last iterate, also without convergence: if increments are not finite, grow or stagnate, or at `max_sweeps`.
    """
    c, count, d = own_library(SOURCE), len(b), contact.shape[1]
    now, dofs = np.zeros(count) if u is None else u.copy(), np.ascontiguousarray(contact, np.int32)
    steps = _steps(dofs, order, count)
    begins, columns = (np.asarray(a, np.int32) for a in (A.indptr, A.indices))
    rows = pointers(c, begins, columns, A.data, b, now)
    of_law = pointers(c, dofs, weights, np.array(law.numbers), slip, None)
    changes: Array = np.empty(0)
    increments: Array = np.empty(0)
    converged = False
    while not converged and len(increments) < max_sweeps:
        chunk = min(CHUNK, max_sweeps - len(increments))
        new: tuple[Array, Array] = np.empty(chunk), np.empty(chunk)
        made = c.lib.relax_sweeps(
            len(steps), *pointers(c, steps), count, *rows, d, *of_law, omega, omega_contact, chunk, tolerance,
            *pointers(c, *new),
        )  # fmt: skip
        change, size = (one[:made] for one in new)
        with np.errstate(divide="ignore", invalid="ignore"):
            increments = np.append(increments, np.where(change > 0, change / size, change))
        changes = np.append(changes, change)
        converged = bool(increments[-1] <= tolerance)
        if _diverges(changes) or _stagnates(increments):
            break
    return Relaxation(now, converged, increments)


def _diverges(changes: Array) -> bool:
    """Whether changes are not finite or have grown to GROWTH times the first ones."""
    return not np.isfinite(changes[-1]) or bool(changes[-1] > GROWTH * changes[:10].max())


def _stagnates(values: Array) -> bool:
    """Whether the later half of the values has no smaller minimum than the earlier half."""
    half = len(values) // 2
    return len(values) >= PATIENCE and bool(values[half:].min() > NO_PROGRESS * values[:half].min())


def _steps(contact: Indices, order: Indices | None, count: int) -> Indices:
    """The steps of a sweep, coded as sweeps.c reads them."""
    place = np.arange(count) if order is None else np.argsort(order)
    normal, tangential = place[contact[:, -1]].astype(float), place[contact[:, :-1]].min(axis=1).astype(float)
    if order is None:
        normal, tangential = (np.minimum(normal, tangential) + shift for shift in (0.0, 0.5))
    others = np.setdiff1d(np.arange(count), contact)
    nodes = np.arange(len(contact))
    codes = np.concatenate([others, -1 - 2 * nodes, -2 - 2 * nodes]).astype(np.int32)
    return codes[np.argsort(np.concatenate([place[others], normal, tangential]), kind="stable")]
