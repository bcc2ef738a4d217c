"""Places in a meshed layer, from places of S and heights."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from geometry.topology import lagrange
from thinlayer.discretisation.full_model import FullModel
from thinlayer.discretisation.model import Model
from thinlayer.errors import ModelError
from thinlayer.surface.locating import SIDES, Located

Array = npt.NDArray[np.float64]


def meshed_places(model: Model, x: Any, height: Any, seam: str) -> Array:
    """Places (n, d) in the mesh of a full model: at heights between the faces that places of S have become.

    Args:
        model: a full model, of whose joint S is.
        x: places on S, (n, d).
        height: from -1/2 at the lower to 1/2 at the upper face, one or (n,).
        seam: its name; it lies between bodies.

    Raises:
        ModelError: another model, a seam on a rigid base, places off the seam.
    """
    if not isinstance(model, FullModel):
        raise ModelError(f"places in a meshed layer need a full model, not {model!r:.80}")
    joint = model.joint
    if seam in joint.base_seams:
        raise ModelError(f"the seam {seam!r} stands on a rigid base: one of its faces is not in the mesh")
    located, faces = Located.of(joint, x).on_seam(seam), []
    for name in SIDES:
        side = located.on_side(name, seam)
        shapes = lagrange(joint.cell_type, joint.degree).tabulate(0, side.X)[0, :, :, 0]
        places = np.einsum("mn,mnd->md", shapes, model.domain.joint.cell_points[side.cell])
        faces.append(places[np.searchsorted(side.point, np.arange(len(located.x)))])
    lower, upper = faces
    return np.asarray(lower + (np.asarray(height, float)[..., None] + 0.5) * (upper - lower))
