"""Gauss-Seidel for contact with friction: sweeps over the contact nodes, and the relaxation of the paper over all dofs.

Functions of numpy arrays. In parallel, call `load` first: otherwise every process compiles the C code.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from forms.contact import ContactLaw
from thinlayer.errors import ModelError
from thinlayer.system.shared_library import library

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]

SOURCE = Path(__file__).with_name("sweeps.c")
CHUNK = 256  # number of sweeps between two tests of the increments
PATIENCE = 2048  # least number of sweeps of a relaxation that stagnates
GROWTH = 1e8  # growth of the changes, relative to the largest of the first sweeps, that means divergence
NO_PROGRESS = 0.999  # ratio of the least increments of the later and the earlier half of all sweeps: stagnation


def load(comm: MPI.Intracomm) -> None:
    """Compile the C code of this module, once for all processes. Collective."""
    library(SOURCE, comm)


@dataclass(frozen=True)
class BlockRows:
    """A sparse matrix of n x n blocks, row by row.

    Attributes:
        indptr: (n + 1,) index in `indices` at which each row begins.
        indices: (nnz,) block columns.
        blocks: (nnz, d, d).
    """

    indptr: Indices
    indices: Indices
    blocks: Array


@dataclass(frozen=True)
class Relaxation:
    """The result of `relax`.

    Attributes:
        u: (N,) the last iterate.
        sweeps: number of sweeps over all dofs.
        outer: number of times that fixed thresholds were computed; 1 if thresholds follow the pressure within the sweeps.
        converged: whether the increments, and the thresholds, met their tolerance.
        increments: (sweeps,) Euclidean norm of the change of u in each sweep, relative to that of u.
    """

    u: Array
    sweeps: int
    outer: int
    converged: bool
    increments: Array


def sweep_nodes(
    matrix: Array | BlockRows,
    g: Array,
    u: Array,
    base: Array,
    frames: Array,
    weights: Array,
    numbers: Sequence[float],
    *,
    slip: Array | None = None,
    threshold: Array | None = None,
    moves: npt.NDArray[np.bool_] | None = None,
    sweeps: int = 1,
) -> float:
    """Gauss-Seidel sweeps over n contact nodes, in place: each node solves exactly for its d components.

    Node i solves sum_j A_ij u_j + weights_i frames_i^T t(w_i) = g_i with w_i = frames_i (u_i - base_i). If friction is so
    strong that there are several solutions, a solution without tangential traction is preferred, then one that sticks.

    Args:
        matrix: stiffness of the contact dofs, force per length, (n d, n d) with the d dofs of a node next to each other
            (not copied when C-contiguous), or `BlockRows`. Its diagonal blocks are positive definite.
        g: (n, d) forces on the nodes, in global axes.
        u: (n, d) displacements, in global axes; float64, C-contiguous.
        base: (n, d) displacements of the other side, in global axes.
        frames: (n, d, d) rows are orthonormal axes of S: tangents, then the normal, which points out of the other side.
        weights: (n,) areas (lengths in two dimensions) of the nodes.
        numbers: `ContactLaw.numbers`.
        slip: (n, d - 1) slip at the beginning of the step; None: zero.
        threshold: (n,) thresholds, stress; None: those of the law.
        moves: (n,) whether a node is swept; None: all are.
        sweeps: number of sweeps.

    Returns:
        The largest change of a component of u in the last sweep; NaN if a node had no solution (numbers that are not
        finite, a diagonal block that is not positive definite). Such a node keeps its u.

    Raises:
        ModelError: arrays of the wrong shape; u of another type or not contiguous.
    """
    n, d = _node_shape("u", u)
    if not (u.dtype == np.float64 and u.flags.c_contiguous and u.flags.writeable):
        raise ModelError("u must be a C-contiguous, writeable array of float64: it is changed in place")
    indptr = indices = None
    if isinstance(matrix, BlockRows):
        indptr, indices = _checked_rows(matrix.indptr, matrix.indices, n, n)
        entries = _checked("blocks", matrix.blocks, (len(indices), d, d))
    else:
        entries = _checked("matrix", matrix, (n * d, n * d))
    arrays = (
        _checked("g", g, (n, d)), u, _checked("base", base, (n, d)), _checked("frames", frames, (n, d, d)),
        _checked("weights", weights, (n,)), _checked("numbers", np.asarray(numbers), (4,)), _checked_slip(slip, n, d),
        _checked_threshold(threshold, n), _checked("moves", np.ones(n) if moves is None else moves, (n,), np.uint8),
    )  # fmt: skip
    c = library(SOURCE)
    return float(c.lib.sweep_nodes(n, d, *_pointers(c, entries, indptr, indices, *arrays), sweeps))


def relax(
    indptr: Indices,
    indices: Indices,
    data: Array,
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
    fixed_point: bool = False,
    inner_tolerance: float | None = None,
    max_sweeps: int = 100_000,
    max_outer: int = 200,
) -> Relaxation:
    """The relaxation of section 8 of the paper: over-relaxed Gauss-Seidel, component by component over all N dofs.

    With the diagonal a, the remainder r of the row, the weight b and the threshold rho of a node, its normal component
    becomes r / a if that opens S, else r / (a + b K_N). Its tangential component becomes r / (a + b K_T) if it sticks, else
    (r -+ b rho) / a; in three dimensions both tangential components are found together, on a disc. Unlike in the paper
    omega is 1 at contact nodes: the same omega everywhere fails for many meshes and stiffnesses.

    Args:
        indptr, indices, data: rows of the stiffness matrix; rows of held dofs are those of the identity. Dofs of contact
            nodes are jumps in the axes of S.
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
        fixed_point: True: as in the paper thresholds are fixed until the sweeps converge and then computed from the
            pressures, until their largest change relative to the largest one is within the tolerance. False: thresholds
            follow the pressure within the sweeps.
        inner_tolerance: tolerance of the increments while thresholds are fixed; None: `tolerance`.
        max_sweeps: largest number of sweeps.
        max_outer: largest number of times that fixed thresholds are computed.

    Returns:
        The last iterate, also without convergence: if increments are not finite, grow or stagnate, or at a largest number.

    Raises:
        ModelError: arrays of the wrong shape, indices out of range, a diagonal that is not positive.
        LawError: a law without numbers for compiled code.
    """
    b = _checked("b", b, (len(b),))
    count = len(b)
    matrix = (*_checked_rows(indptr, indices, count, count), _checked("data", data, (len(indices),)))
    _require_positive_diagonal(*matrix)
    n, d = _node_shape("contact", contact)
    dofs = _checked("contact", contact, (n, d), np.int32)
    steps = _steps(dofs, order, count)
    weights, slip = _checked("weights", weights, (n,)), _checked_slip(slip, n, d)
    now = np.zeros(count) if u is None else _checked("u", u, (count,)).copy()
    c = library(SOURCE)

    def thresholds() -> Array:
        return law.threshold(law.pressure(now[dofs]))

    held = _checked("thresholds", thresholds(), (n,)) if fixed_point else None
    given = _pointers(c, *matrix, b, now), _pointers(c, dofs, weights, np.array(law.numbers), slip)
    history: list[Array] = []
    jumps: list[float] = []
    done, outer, converged = 0, 1, False
    while True:
        met = False
        changes: Array = np.empty(0)
        increments: Array = np.empty(0)
        while not met and done < max_sweeps:
            chunk = min(CHUNK, max_sweeps - done)
            change, size = np.empty(chunk), np.empty(chunk)
            limit = tolerance if not fixed_point or inner_tolerance is None else inner_tolerance
            made = c.lib.relax_sweeps(
                len(steps), *_pointers(c, steps), count, *given[0], d, *given[1], *_pointers(c, held), omega, omega_contact,
                chunk, limit, *_pointers(c, change, size),
            )  # fmt: skip
            with np.errstate(divide="ignore", invalid="ignore"):
                relative = np.where(change[:made] > 0, change[:made] / size[:made], change[:made])
            history.append(relative)
            changes, increments = np.append(changes, change[:made]), np.append(increments, relative)
            done += made
            met = bool(increments[-1] <= limit)
            if not met and (_diverges(changes) or _stagnates(increments, PATIENCE)):
                break
        if not met or not fixed_point:
            converged = met
            break
        assert held is not None
        new = thresholds()
        jumps.append(float(np.abs(new - held).max(initial=0.0)))
        if jumps[-1] <= tolerance * np.abs(new).max(initial=0.0):
            converged = True
            break
        if outer == max_outer or _stagnates(np.array(jumps), max_outer // 4):
            break
        held = new
        outer += 1
    return Relaxation(now, done, outer, converged, np.concatenate(history) if history else np.empty(0))


def _diverges(changes: Array) -> bool:
    """Whether changes are not finite or have grown to GROWTH times the first ones."""
    return not np.isfinite(changes[-1]) or bool(changes[-1] > GROWTH * changes[:10].max())


def _stagnates(values: Array, patience: int) -> bool:
    """Whether the later half of the values has no smaller minimum than the earlier half."""
    half = len(values) // 2
    return len(values) >= patience and bool(values[half:].min() > NO_PROGRESS * values[:half].min())


def _node_shape(name: str, array: npt.NDArray[Any]) -> tuple[int, int]:
    if array.ndim != 2 or array.shape[1] not in (2, 3):
        raise ModelError(f"{name} has the shape {array.shape}; it must be (n, 2) or (n, 3)")
    return array.shape[0], array.shape[1]


def _checked(name: str, array: npt.NDArray[Any], shape: tuple[int, ...], kind: Any = np.float64) -> npt.NDArray[Any]:
    """The array as C reads it: contiguous and of a type."""
    if array.shape != shape:
        raise ModelError(f"{name} has the shape {array.shape}; it must be {shape}")
    return np.ascontiguousarray(array, kind)


def _checked_slip(slip: Array | None, n: int, d: int) -> Array | None:
    return None if slip is None else _checked("slip", slip, (n, d - 1))


def _checked_threshold(threshold: Array | None, n: int) -> Array | None:
    return None if threshold is None else _checked("threshold", threshold, (n,))


def _checked_rows(indptr: Indices, indices: Indices, rows: int, columns: int) -> tuple[Indices, Indices]:
    """The arrays `indptr` and `indices` of a sparse matrix, checked, as C does not check them."""
    begins = _checked("indptr", indptr, (rows + 1,), np.int32)
    entries = _checked("indices", indices, (len(indices),), np.int32)
    if begins[0] != 0 or begins[-1] != len(entries) or (np.diff(begins) < 0).any():
        raise ModelError(f"indptr must grow from 0 to the number of indices, {len(entries)}")
    if len(entries) and not 0 <= entries.min() <= entries.max() < columns:
        raise ModelError(f"indices must be from 0 to {columns - 1}; found {entries.min()} to {entries.max()}")
    return begins, entries


def _require_positive_diagonal(indptr: Indices, indices: Indices, data: Array) -> None:
    rows = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
    here = rows == indices
    diagonal = np.bincount(rows[here], data[here], len(indptr) - 1)
    if not (diagonal > 0).all():
        raise ModelError(f"the diagonal of row {int(np.argmin(diagonal > 0))} is {diagonal.min()}; it must be > 0")


def _steps(contact: Indices, order: Indices | None, count: int) -> Indices:
    """The steps of a sweep, coded as sweeps.c reads them."""
    if contact.size and not 0 <= contact.min() <= contact.max() < count:
        raise ModelError(f"contact must have dofs from 0 to {count - 1}; found {contact.min()} to {contact.max()}")
    if len(np.unique(contact)) != contact.size:
        raise ModelError("contact must have each dof once")
    if order is not None:
        order = _checked("order", order, (count,), np.int32)
        if not np.array_equal(np.sort(order), np.arange(count)):
            raise ModelError(f"order must have each of the {count} dofs once")
    place = np.arange(count) if order is None else np.argsort(order)
    normal, tangential = place[contact[:, -1]].astype(float), place[contact[:, :-1]].min(axis=1).astype(float)
    if order is None:
        normal, tangential = (np.minimum(normal, tangential) + shift for shift in (0.0, 0.5))
    others = np.setdiff1d(np.arange(count), contact)
    nodes = np.arange(len(contact))
    codes = np.concatenate([others, -1 - 2 * nodes, -2 - 2 * nodes]).astype(np.int32)
    return codes[np.argsort(np.concatenate([place[others], normal, tangential]), kind="stable")]


def _pointers(c: Any, *arrays: npt.NDArray[Any] | None) -> list[Any]:
    """Pointers for C; None becomes NULL."""
    kinds = {"i": "int32_t[]", "B": "uint8_t[]", "d": "double[]"}  # dtype.name would take five times as long
    return [c.ffi.NULL if a is None else c.ffi.from_buffer(kinds[a.dtype.char], a) for a in arrays]
