"""What must hold of a layer, and of its free ends, for the stresses inside to be known."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from forms.base import InputError
from forms.ends.end_fields import EndFields, end_fields
from forms.inside import FaceValues, Inside
from geometry.ends import StraightEnd, straight_ends
from geometry.refusals import place, unknown
from geometry.seam import S
from geometry.sheet import Rim
from geometry.topology import IntArray
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import SeamLayer, real_law
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.side_loads import SideLoad
from thinlayer.discretisation.state import State
from thinlayer.errors import Refused
from thinlayer.surface.surface_mesh import SurfaceMesh
from thinlayer.system.ranks import on_all, require_same

Array = npt.NDArray[np.float64]
NEAR = 3.0  # distance from a free end, over the thickness, within which stresses are not those of a layer without end
TAKEN = np.array([2.0, 4.0])  # distances, over the thickness, at which pressures are taken for free ends
NEARLY = 0.4999  # Poisson's ratio that stands for larger ones: its fields within NEAR differ by less than 1e-3
DIGITS = 12  # of Poisson's ratio


@dataclass(frozen=True)
class Faces:
    """How both sides of S are displaced at n places of it, the same on all ranks; between facets, means of theirs.

    Attributes:
        x, n: (n, d) the places, and unit normals of S.
        u: (2, n, d) displacements of the lower and the upper side; zero of a rigid base.
        gradient: (2, n, d, d) their gradients, [..., j] along x_j.
    """

    x: Array
    n: Array
    u: Array
    gradient: Array


@dataclass(frozen=True, eq=False)
class Zoomable:
    """A layer whose stresses inside are known.

    Attributes:
        state: of an interface model.
        model: the model.
        one: the layer.
        inside: what gives its stresses.
    """

    state: State
    model: Model
    one: SeamLayer
    inside: Inside

    @classmethod
    def of(cls, state: State, seam: str) -> Zoomable:
        """The layer of a seam.

        Raises:
            InputError: there is none, or its stresses inside are not known.
        """
        if not isinstance(state, State) or not isinstance(state.model, InterfaceModel):
            given = state.model if isinstance(state, State) else state
            raise InputError(f"a zoom takes a state of an interface model, as solve returns it, not {given!r:.80}")
        model, names = state.model, [*state.model.joint.seams]
        name = names[0] if seam == S and len(names) == 1 else seam
        if name not in names:
            raise InputError(unknown("seam", seam, names))
        if name not in model.layers:
            raise InputError(f"the seam {name!r} is open: no layer is there")
        one = model.layers[name]
        model.reductions[name].require("inside", f"zoom into {one}: ")
        if model.forces.weighs(name):
            raise InputError(f"zoom into {one}: a body force in the layer is not in the fields inside")
        return cls(state, model, one, real_law(one.layer, model.kinematics).inside())

    @property
    def eps(self) -> float:
        """Thickness; where it varies the one that its profile multiplies."""
        assert self.one.thin
        return float(self.one.thin.eps)

    def thickness(self, x: Array) -> Array:
        """(n,) thickness at places (n, d)."""
        assert self.one.thin
        profile = self.one.thin.profile
        relative = np.ones(len(x)) if profile is None else np.asarray(profile(x.T), float)
        return np.asarray(self.eps * np.broadcast_to(relative, (len(x),)))

    @cached_property
    def surface(self) -> SurfaceMesh:
        """The layer's seam."""
        return SurfaceMesh(self.model, self.one.name)

    def faces(self, x: Any) -> Faces:
        """The faces at places. Collective.

        Raises:
            InputError: places that are not on the seam.
        """
        surface, u, comm = self.surface, self.state.u, self.model.comm
        with on_all(comm):
            located, at = surface.at(x)
        require_same(comm, places=located.x)

        def means(both: Array) -> Array:
            return np.stack([located.mean(np.moveaxis(side[..., 0], -1, 0)) for side in both])

        n = located.mean(at.n[..., 0].T)
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        u, gradient = (means(of(u, self.model, at)) for of in (surface.sides, surface.gradients))
        return Faces(located.x, n, u, gradient)

    def pressure(self, x: Array) -> tuple[Array, Array]:
        """Pressures (n,) of the layer and their slopes (n, d) along S, at places (n, d). Collective."""
        located, at = self.surface.at(x)
        p = self.surface.corner_values(self.state.fields[self.one.pressure_key], self.model)[at.rows]
        return located.mean(np.einsum("fa,fqa->f", p, at.shapes)), located.mean(np.einsum("fa,fqad->fd", p, at.slopes))

    def face_values(self, faces: Faces) -> FaceValues:
        """What the interface law knows of the faces: at order 0 the jump alone."""
        assert self.one.thin
        n, d = faces.x.shape
        lifted = _lifted(faces.n), _lifted(faces.u[1] - faces.u[0])
        along_s = np.eye(d) - faces.n[:, :, None] * faces.n[:, None]
        pressure: Array = np.zeros(n)
        slope: Array = np.zeros((n, d))
        if self.one.law.traits.constrained:
            pressure, gradient = self.pressure(faces.x)
            slope = np.asarray(np.einsum("nij,nj->ni", along_s, gradient))
            self._take_ends(faces.x, pressure, slope)
        if self.one.thin.order == 0:
            nothing = np.zeros((n, 3, 3))
            return FaceValues(*lifted, nothing, nothing, pressure, np.zeros((n, 3)))
        gradient, hoops = faces.gradient @ along_s, faces.u[..., 0] / self.model.kinematics.radius(faces.x)
        strains = np.zeros((2, n, 3, 3))
        strains[..., :d, :d] = (gradient + np.swapaxes(gradient, 2, 3)) / 2
        strains[..., 2, 2] += hoops
        lower, upper = strains
        return FaceValues(*lifted, (lower + upper) / 2, upper - lower, pressure, _lifted(slope))

    def _take_ends(self, x: Array, pressure: Array, slope: Array) -> None:
        """Replace pressures (n,) near free ends, where they fall to zero, by those without the fields of the ends.

        The fields of the stresses on an end have that fall. They belong to a pressure that is linear in the distance, which
        is found from the pressures of S at two distances where the rest of the fields has gone.
        """
        if not self.inside.flows:
            return
        for end, distance in self.near(x):
            at = np.flatnonzero(np.isfinite(distance))
            fields = self.fields.stresses(TAKEN, 0 * TAKEN)
            known = [self.pressure(x[at] + (distance[at] - one * self.eps)[:, None] * end.m)[0] for one in TAKEN]
            responses = np.stack([1 + fields[0, :, 1], TAKEN - fields[3, :, 1]], axis=1)
            start, growth = np.linalg.solve(responses, np.array(known))
            pressure[at] = start + growth * distance[at] / self.eps
            slope[at] = -growth[:, None] / self.eps * end.m

    # ---------------------------------------------------------------- ends
    @cached_property
    def rim(self) -> Rim:
        """Where S has free ends."""
        return self.model.reductions[self.one.name].free

    @cached_property
    def why_no_ends(self) -> Refused | None:
        """Why stresses at free ends are not known; None: they are."""
        for load in SideLoad.of(self.model, self.one):
            return Refused("loaded side", f"the {load.what} acts on the layer's side")
        return self.model.reductions[self.one.name].why_not("ends inside")

    def _require_ends(self) -> None:
        if self.why_no_ends:
            raise self.why_no_ends.error(f"zoom into {self.one} at its free ends: ")

    @property
    def nu(self) -> float:
        """Poisson's ratio of a layer of one law, in plane strain."""
        assert self.inside.moduli
        lmbda, mu = self.inside.moduli
        return round(1 / (1 + mu / lmbda) / 2, DIGITS) if lmbda else 0.0

    @property
    def fields(self) -> EndFields:
        """The fields of the free ends."""
        self._require_ends()
        return end_fields(min(self.nu, NEARLY))

    @cached_property
    def _ends(self) -> list[StraightEnd]:
        self._require_ends()
        return straight_ends(self.rim, self.one.sheet)

    @property
    def places_of_ends(self) -> list[tuple[StraightEnd, Array]]:
        """Each free end and places (n, d) on it far from others, vertices of the mesh in their order along it."""
        joint, found = self.model.joint, []
        for end in self._ends:
            x = joint.points[np.unique(self.rim.vertices)]
            x = x[end.has(x)]
            x = x[self._ends_near(x) == 1]
            found.append((end, x[np.argsort(x @ end.along)]))
        return found

    def near(self, x: Array) -> list[tuple[StraightEnd, Array]]:
        """Free ends and the distances (n,) of places (n, d) that lie beside them, others inf; ends with such places.

        Raises:
            InputError: a place is near an end whose fields are not known, or near two that meet.
        """
        if not len(self.rim.vertices):
            return []
        if self.why_no_ends:
            close = self.rim.distance(self.model.joint.points, x) < NEAR * self.thickness(x)
            if close.any():
                at = f"zoom into {self.one} at {place(x[close.argmax()])}, within {NEAR:g} thicknesses of a free end: "
                raise self.why_no_ends.error(at)
            return []
        reach = NEAR * self.eps if self.inside.flows else np.inf  # of the fields beside the pressure of S
        found = []
        for end in self._ends:
            distance = np.where(end.beside(x), np.maximum(end.distance(x), 0.0), np.inf)
            distance = np.where(distance <= reach, distance, np.inf)
            if np.isfinite(distance).any():
                found.append((end, distance))
        ends = self._ends_near(x)
        wrong = (ends > 1) | ((ends == 0) & (self.rim.distance(self.model.joint.points, x) < NEAR * self.eps))
        if wrong.any():
            raise InputError(
                f"zoom into {self.one} at {place(x[wrong.argmax()])}, within {NEAR:g} thicknesses of where two free ends "
                "meet, or of both: the fields of an end are those far from others"
            )
        return found

    def _ends_near(self, x: Array) -> IntArray:
        """(n,) how many free ends are near places (n, d) beside them."""
        near = [end.beside(x) & (end.distance(x) <= NEAR * self.eps) for end in self._ends]
        return np.asarray(np.sum(near, axis=0), np.int64)


def _lifted(v: Array) -> Array:
    return np.pad(v, ((0, 0), (0, 3 - v.shape[1])))
