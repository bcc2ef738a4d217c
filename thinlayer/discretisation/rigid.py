"""Rigid motions, which supports must prevent and multigrid needs as near-null space."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from forms.planes import LIFTED, Kinematics
from geometry.joint import Joint
from thinlayer.discretisation.axis import AXES
from thinlayer.discretisation.constraints import Constraints
from thinlayer.errors import ModelError

Resistance = Callable[[Sequence[fem.Function]], npt.NDArray[np.float64]]
SMALLEST = 1e-10  # least eigenvalue of the supports' Gram matrix of rigid motions, over its largest one


def rigid_motions(V: fem.FunctionSpace, joint: Joint, kinematics: Kinematics = LIFTED) -> dict[str, fem.Function]:
    """Rigid motions of the whole structure by name: translations, then rotations about its centre, scaled to its size.

    In periodic joints a rotation is one only if it does not move one side against the other: about the one period in 3D.
    """
    d = joint.dim
    centre, size = joint.points.mean(axis=0), np.ptp(joint.points, axis=0).max()
    rows: dict[str, Any] = {}
    for i in kinematics.translations(d):
        rows[f"translation {AXES[i]}"] = lambda x, i=i: np.array([np.full(x.shape[1], float(k == i)) for k in range(d)])
    if joint.periods:
        vectors = joint.periods.vectors(joint.points)
        if d == 3 and np.linalg.matrix_rank(vectors) == 1:
            axis = vectors[0] / np.linalg.norm(vectors[0])
            name = f"rotation about ({', '.join(f'{c:.3g}' for c in axis)})"
            rows[name] = lambda x: np.cross(axis, (x.T - centre) / size).T
    for i in () if joint.periods or not kinematics.turns else range(d):
        for j in range(i + 1, d):
            rows[f"rotation {AXES[i]}{AXES[j]}"] = lambda x, i=i, j=j: _rotation(x, i, j, centre, size)
    motions, places = {}, _places(V)
    for name, motion in rows.items():
        motions[name] = f = fem.Function(V)
        if places is not None:
            f.x.array.reshape(-1, d).T[:] = motion(places)
        else:
            f.interpolate(motion)
            f.x.scatter_forward()
    return motions


def _places(V: fem.FunctionSpace) -> npt.NDArray[np.float64] | None:
    """Places (3, n) of nodal unknowns; None if the unknowns are not nodal displacements."""
    try:
        return np.asarray(V.tabulate_dof_coordinates().T)
    except RuntimeError:
        return None


def _rotation(
    x: npt.NDArray[np.float64], i: int, j: int, centre: npt.NDArray[np.float64], size: float
) -> npt.NDArray[np.float64]:
    out = np.zeros((len(centre), x.shape[1]))
    out[i], out[j] = -(x[j] - centre[j]) / size, (x[i] - centre[i]) / size
    return out


def _resisted(
    motions: list[fem.Function],
    constraints: Constraints,
    resistances: Sequence[Resistance],
) -> npt.NDArray[np.float64]:
    """How far conditions prevent motions (m, m), and the work of parts against them, scaled. Collective."""
    resisted = constraints.resistance(np.column_stack([f.x.array[: constraints.n] for f in motions]))
    for resistance in resistances:
        work = resistance(motions)
        size = np.abs(work).max()
        if np.isfinite(size) and size > 0:
            resisted = resisted + (work + work.T) / (2 * size)
    return np.asarray(resisted, float)


def free_translations(
    V: fem.FunctionSpace,
    joint: Joint,
    constraints: Constraints,
    resistances: Sequence[Resistance],
    kinematics: Kinematics = LIFTED,
) -> tuple[str, ...]:
    """The axes along which nothing prevents a translation. Collective. Arguments as in `require_support`."""
    axes = [AXES[i] for i in kinematics.translations(joint.dim)]
    motions = [*rigid_motions(V, joint, kinematics).values()][: len(axes)]
    resisted = np.diag(_resisted(motions, constraints, resistances))
    return tuple(axis for axis, much in zip(axes, resisted, strict=True) if much <= SMALLEST * max(resisted.max(), 1.0))


def require_support(
    V: fem.FunctionSpace,
    joint: Joint,
    constraints: Constraints,
    resistances: Sequence[Resistance],
    kinematics: Kinematics = LIFTED,
) -> None:
    """Raise ModelError if supports allow a rigid motion and nothing else resists it. Collective.

    Args:
        V, joint, kinematics: attributes of the model.
        constraints: conditions on the displacements.
        resistances: functions of the m rigid motions, see `Addition.resistance`.
    """
    motions = rigid_motions(V, joint, kinematics)
    resisted = _resisted([*motions.values()], constraints, resistances)
    values, vectors = np.linalg.eigh(resisted)
    if values[0] <= SMALLEST * max(values[-1], 1.0):
        free = list(motions)[int(np.argmax(np.abs(vectors[:, 0])))]
        raise ModelError(f"no support against rigid motion of the structure ({free}); add supports")
