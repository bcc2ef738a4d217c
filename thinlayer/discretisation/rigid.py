"""Rigid motions: at places, in forms and in spaces; supports must prevent them, and multigrid needs them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh

from forms.kinematics import Expr
from forms.planes import LIFTED, Kinematics
from geometry.joint import Joint
from thinlayer.discretisation.boundary import AXES
from thinlayer.discretisation.constraints import Constraints
from thinlayer.errors import ModelError

Array = npt.NDArray[np.float64]
Resistance = Callable[[Sequence[fem.Function]], Array]
AXIAL = {2: ((0, 1, 1.0),), 3: ((1, 2, 1.0), (0, 2, -1.0), (0, 1, 1.0))}  # planes (i, j) that rotations turn, and sense
SMALLEST = 1e-10  # least eigenvalue of the supports' Gram matrix of rigid motions, over its largest one


def count(dim: int) -> int:
    """Number of rigid motions."""
    return dim + len(AXIAL[dim])


def rigid(x: npt.NDArray[Any], about: Array) -> Array:
    """Unit translations and rotations about a point, at places x (n, d): (n, d, k)."""
    n, d = x.shape
    out: Array = np.zeros((n, d, count(d)))
    out[:, np.arange(d), np.arange(d)] = 1.0
    for k, (i, j, sense) in enumerate(AXIAL[d]):
        out[:, i, d + k], out[:, j, d + k] = -sense * (x[:, j] - about[j]), sense * (x[:, i] - about[i])
    return out


def balanced_motions(kinematics: Kinematics, dim: int) -> Array:
    """(k,) 1 for the motions of `rigid` in which forces have a resultant, 0 for those that revolution cancels."""
    found = np.zeros(count(dim))
    found[[*kinematics.translations(dim)]] = 1.0
    found[dim:] = float(kinematics.turns)
    return found


def on_centre(kinematics: Kinematics, x: Array) -> Array:
    """A place (d,), or of bodies of revolution its place on the axis."""
    moved = np.zeros(len(x))
    free = [*kinematics.translations(len(x))]
    moved[free] = x[free]
    return moved


def rigid_expression(mesh: Mesh, about: Array) -> tuple[fem.Constant, Expr]:
    """A constant (k,), and the sum of the motions of `rigid` with these factors as a UFL vector (d,)."""
    x, d = ufl.SpatialCoordinate(mesh), len(about)
    motion = fem.Constant(mesh, np.zeros(count(d)))
    parts = [motion[i] for i in range(d)]
    for k, (i, j, sense) in enumerate(AXIAL[d]):
        parts[i] += -sense * motion[d + k] * (x[j] - float(about[j]))
        parts[j] += sense * motion[d + k] * (x[i] - float(about[i]))
    return motion, ufl.as_vector(parts)


def rigid_values(V: fem.FunctionSpace, about: Array) -> Array:
    """The motions of `rigid` in a space: (n, k) at the displacements of this rank, those of ghosts last. Collective."""
    d = V.dofmap.bs
    try:
        return rigid(V.tabulate_dof_coordinates()[:, :d], about).reshape(-1, count(d))
    except RuntimeError:  # the unknowns are no nodal displacements
        columns = []
        for k in range(count(d)):
            f = fem.Function(V)
            f.interpolate(lambda x, k=k: rigid(x[:d].T, about)[:, :, k].T)
            f.x.scatter_forward()
            columns.append(f.x.array.copy())
        return np.column_stack(columns)


def rigid_motions(V: fem.FunctionSpace, joint: Joint, kinematics: Kinematics = LIFTED) -> dict[str, fem.Function]:
    """Rigid motions of the whole structure by name: translations, then rotations about its centre, scaled to its size.

    In periodic joints a rotation is one only if it does not move one side against the other: about the one period in 3D.
    """
    d, size, one = joint.dim, np.ptp(joint.points, axis=0).max(), np.eye(count(joint.dim))
    shares = {f"translation {AXES[i]}": one[i] for i in kinematics.translations(d)}
    if joint.periods:
        vectors = joint.periods.vectors(joint.points)
        if d == 3 and np.linalg.matrix_rank(vectors) == 1:
            axis = vectors[0] / np.linalg.norm(vectors[0])
            shares[f"rotation about ({', '.join(f'{c:.3g}' for c in axis)})"] = axis @ one[d:] / size
    elif kinematics.turns:
        for k, (i, j, sense) in reversed([*enumerate(AXIAL[d])]):
            shares[f"rotation {AXES[i]}{AXES[j]}"] = one[d + k] * sense / size
    values, motions = rigid_values(V, joint.points.mean(axis=0)), {name: fem.Function(V) for name in shares}
    for name, f in motions.items():
        f.x.array[:] = values @ shares[name]
    return motions


def resisted(motions: Mapping[str, fem.Function], constraints: Constraints, resistances: Sequence[Resistance]) -> Array:
    """How far conditions prevent motions (m, m), and the work of parts against them, scaled. Collective.

    Args:
        motions: of `rigid_motions`.
        constraints: conditions on the displacements.
        resistances: functions of the m motions, see `Addition.resistance`.
    """
    found = constraints.resistance(np.column_stack([f.x.array[: constraints.n] for f in motions.values()]))
    for resistance in resistances:
        work = resistance([*motions.values()])
        size = np.abs(work).max()
        if np.isfinite(size) and size > 0:
            found = found + (work + work.T) / (2 * size)
    return np.asarray(found, float)


def free_translations(motions: Mapping[str, fem.Function], resistance: Array) -> tuple[str, ...]:
    """The axes along which nothing prevents a translation; arguments as in `require_support`."""
    much = {name.split()[1]: r for name, r in zip(motions, np.diag(resistance), strict=True) if "translation" in name}
    return tuple(axis for axis, r in much.items() if r <= SMALLEST * max(*much.values(), 1.0))


def require_support(motions: Mapping[str, fem.Function], resistance: Array) -> None:
    """Raise ModelError if nothing resists one of the `rigid_motions`; resistance (m, m) as of `resisted`."""
    values, vectors = np.linalg.eigh(resistance)
    if values[0] <= SMALLEST * max(values[-1], 1.0):
        free = list(motions)[int(np.argmax(np.abs(vectors[:, 0])))]
        raise ModelError(f"no support against rigid motion of the structure ({free}); add supports")
