"""Zoom: stresses inside a layer that an interface law stands for, through its thickness and at its free ends."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from forms.base import InputError
from forms.ends.end_fields import EVEN, EndFields
from forms.kinematics import MANDEL
from forms.law import BulkLaw
from forms.temperature import finite
from geometry.ends import StraightEnd
from geometry.refusals import place
from thinlayer.discretisation.state import State
from thinlayer.output.zoomable import Faces, Zoomable

Array = npt.NDArray[np.float64]
AT_CORNER = 1e-6  # distance from a corner, over the thickness, where stresses count as infinite


@dataclass(frozen=True)
class CornerStrengths:
    """The singular stresses at the two corners of a free end of a layer, at places along it.

    On the body's face at the distance r from a corner the traction across it is H r^(exponent - 1) in the limit r -> 0; the
    traction along S, away from the end, is `shear` times that. A criterion of crack initiation compares H with what a
    test of the same layer and exponent has found.

    Attributes:
        x: (n, d) places along the end, farther than 3 thicknesses from others; in 2D one.
        m: (d,) unit normal of the end, in S, outward.
        exponent: lambda, from 1 at nu = 0 to 0.595 at nu = 0.5.
        shear: of the traction along S; at the upper corner with the other sign.
        lower, upper: H, (n,), at the corners on the lower and on the upper face, stress times length^(1 - exponent); nan
            for nu < 0.01, where nothing grows.
    """

    x: Array
    m: Array
    exponent: float
    shear: float
    lower: Array
    upper: Array


class Zoom:
    """Stresses inside a layer, from a solved interface model, without a mesh of the layer. Methods are collective.

    For isotropic linear elastic layers, a `Stack` of them, `Rubber` and `Incompressible`. Away from free ends the error of
    the stresses is that of the state: O(eps) for a layer of order 0, O(eps^2) of order 1 (`forms.inside`). At straight free
    ends of a layer of one law fields are added that take the stresses off the end, those between rigid faces
    (`forms.ends.end_fields`); the error there is O(eps), the layer's stiffness over the bodies'.

    Args:
        state: of an interface model, as `solve` returns it, or `history.at(t)`.
        seam: name of a seam; "S" of a joint that has one.

    Raises:
        InputError: no such state or seam; a layer whose stresses inside are not known, with the reason.
    """

    def __init__(self, state: State, seam: str = "S") -> None:
        self._known = Zoomable.of(state, seam)
        self.state, self.seam = state, self._known.one.name

    @property
    def eps(self) -> float:
        """The layer's thickness; where it varies the one that its profile multiplies."""
        return self._known.eps

    @property
    def law(self) -> BulkLaw:
        """The layer's law with real parameters, in a plane that of its kinematics."""
        return self._known.model.reductions[self.seam].law

    # ---------------------------------------------------------------- stresses
    def stress(self, x: Any, height: Any = 0.0) -> Array:
        """Stresses (n, 3, 3) at places x (n, d) of S and heights, or (3, 3) at one place.

        Args:
            x: places on S, in the mesh's coordinates.
            height: over the thickness, from -1/2 at the lower to 1/2 at the upper face, one or (n,). Between two sublayers
                stresses along S jump: there they are those of the lower one.

        Raises:
            InputError: places off the seam; heights out of range; corners of free ends; places within 3 thicknesses of a
                free end whose fields are not known, with the reason, or of two ends that meet.
        """
        faces = self._known.faces(x)
        y = self._heights(height, len(faces.x))
        found = self._inside(faces, y)
        near = self._known.near(faces.x)
        for end, distance in near:
            at = np.flatnonzero(np.isfinite(distance))
            self._require_no_corner(faces.x[at], distance[at], y[at])
            foot = self._known.faces(faces.x[at] + distance[at, None] * end.m)
            fields = self._fields.stresses(np.asarray(distance[at] / self.eps), y[at])
            found[at] += self._turned(end, np.einsum("kn,knc->nc", self._amplitudes(end, foot), fields))
        return found if np.ndim(x) > 1 else found[0]

    def through(self, x: Any, n: int = 41) -> tuple[Array, Array]:
        """Heights (n,), from -1/2 to 1/2, and the stresses (n, 3, 3) there, at one place x (d,) of S."""
        heights = np.asarray(np.linspace(-0.5, 0.5, n), np.float64)
        return heights, self.stress(np.tile(np.asarray(x, float), (n, 1)), heights)

    def _require_no_corner(self, x: Array, distance: Array, y: Array) -> None:
        """Raise InputError for places at a corner, where stresses are infinite."""
        near = (distance < AT_CORNER * self.eps) & (np.abs(y) > 0.5 - AT_CORNER)
        if near.any() and self._fields.corner.exponent < 1:
            raise InputError(
                f"the stresses at the corner at {place(x[near.argmax()])}, height {y[near.argmax()]:g}, are infinite; "
                "their exponents and strengths are in `ends`"
            )

    def _heights(self, height: Any, n: int) -> Array:
        if (y := finite(height, (), (n,))) is None or not (np.abs(y) <= 0.5).all():
            raise InputError(
                f"heights are {height!r:.80}; allowed: one number or {n}, from -1/2 to 1/2 of the thickness"
            )
        return np.broadcast_to(y, (n,))

    def _inside(self, faces: Faces, y: Array) -> Array:
        """Stresses (n, 3, 3) as if the layer had no end."""
        known = self._known
        values = known.face_values(faces)
        stresses = known.inside.stress(values, known.thickness(faces.x), y)
        return stresses * self._there_is

    @cached_property
    def _there_is(self) -> Array:
        """(3, 3) 1 for the stresses that the kinematics have."""
        model = self.state.model
        mask = np.zeros((3, 3))
        for slot in model.kinematics.stressed(model.joint.dim):
            i, j = MANDEL[slot]
            mask[i, j] = mask[j, i] = 1.0
        return mask

    # ---------------------------------------------------------------- ends
    def axes_of_end(self, end: int) -> Array:
        """(2, 3) unit vectors at one of `ends`: inward along S, and the normal of S.

        Raises:
            InputError: as of `ends`; no end of this number.
        """
        known = [one for one, x in self._known.places_of_ends if len(x)]
        if end not in range(len(known)):
            raise InputError(f"end {end!r}: there are {len(known)}, numbered from 0")
        return self._axes(known[end])

    @property
    def _fields(self) -> EndFields:
        return self._known.fields

    def _amplitudes(self, end: StraightEnd, feet: Faces) -> Array:
        """(4, n) stresses 11 and 12 that an end without its fields would have, and their growth with the height."""
        upper, lower = (self._in_end(end, self._inside(feet, np.full(len(feet.x), y))) for y in (0.5, -0.5))
        mean, growth = (upper + lower) / 2, upper - lower
        return np.stack([mean[:, 0], mean[:, 1], growth[:, 0], growth[:, 1]])

    def _axes(self, end: StraightEnd) -> Array:
        """(2, 3) the axes of an end: inward along S, and the normal of S."""
        return np.stack([np.pad(one, (0, 3 - len(one))) for one in (-end.m, end.n)])

    def _in_end(self, end: StraightEnd, stress: Array) -> Array:
        """Components 11 and 12 (n, 2) of stresses in the axes of an end."""
        inward, n = self._axes(end)
        return np.stack([np.einsum("i,nij,j->n", inward, stress, one) for one in (inward, n)], axis=1)

    def _turned(self, end: StraightEnd, stress: Array) -> Array:
        """Stresses (n, 3, 3) from the components 11, 22, 12 (n, 3) in the axes of an end; plane strain across them."""
        inward, n = self._axes(end)
        along = np.cross(inward, n)
        s11, s22, s12 = stress.T[:, :, None, None]
        third = self._fields.nu * (s11 + s22) * np.outer(along, along)
        both = np.outer(inward, n)
        found = s11 * np.outer(inward, inward) + s22 * np.outer(n, n) + s12 * (both + both.T) + third
        return np.asarray(found * self._there_is)

    @cached_property
    def ends(self) -> list[CornerStrengths]:
        """The singular stresses at the straight free ends of S. Collective.

        Raises:
            InputError: ends whose fields are not known, with the reason.
        """
        found = []
        corner = self._fields.corner
        for end, x in self._known.places_of_ends:
            if not len(x):
                continue
            amplitudes = self._amplitudes(end, self._known.faces(x))
            size = self.eps ** (1 - corner.exponent)
            lower, upper = (size * (self._fields.strengths * sign) @ amplitudes for sign in (1.0, EVEN))
            found.append(CornerStrengths(x, end.m, corner.exponent, corner.shear, lower, upper))
        return found
