"""SurfaceFunction: values on S as a function of place and time, by which results of one model are data of another."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from forms.base import Array, InputError, require
from forms.tensors import Expr
from geometry.topology import IntArray
from thinlayer.discretisation.time_functions import FieldInTime, PiecewiseLinear
from thinlayer.system.fingerprint import describe

if TYPE_CHECKING:
    from thinlayer.discretisation.coefficient import Coordinates
    from thinlayer.surface.surface_mesh import SurfaceMesh


class SurfaceFunction:
    """A scalar on S, linear between nodes and in time, as `SurfaceMesh.function` makes it.

    It can be a parameter of a layer's law, a source in a layer, or the temperature of a layer. It can be called as a
    numpy function of places on S and, optionally, the time.

    Args:
        surface: the surface.
        values: (m,) nodal values, or (rows, m) at several times.
        times: (rows,) the times; None: values do not depend on time.
    """

    def __init__(self, surface: SurfaceMesh, values: Array, times: Array | None) -> None:
        self._surface, self._values, self._times = surface, np.atleast_2d(values), times
        self._table = None if times is None else PiecewiseLinear(times, self._values)
        self._located: tuple[Array, IntArray, Array] | None = None

    def __call__(self, x: Array, t: float = 0.0) -> Array:
        """Return the values (n,) at n places x (d, n) of S, and at the time t.

        Raises:
            InputError: a place is not on S, or the time is outside the times of the values.
        """
        nodal = self._values[0] if self._table is None else self._table.values_at(t)
        if not np.isfinite(nodal).all():
            raise InputError(f"values on S are unknown at t = {t:g}; times are {self._times}")
        if not np.size(x):  # on ranks without facets of S
            return np.zeros(0)
        if self._located is None or not np.array_equal(self._located[0], x):
            located, at = self._surface.at(np.asarray(x).T)
            first = np.unique(located.point, return_index=True)[1]  # a place on an edge is on several facets
            self._located = np.array(x), self._surface.nodes[at.rows[first]], np.asarray(at.shapes[first, 0])
        _, nodes, shapes = self._located
        return np.asarray((nodal[nodes] * shapes).sum(axis=1))

    def identity(self) -> dict[str, object]:
        """Return the data that identify the function, as JSON."""
        return {"values on S": describe([self._values, self._times]), "seam": self._surface.seam}

    def field_on(self, at: Coordinates) -> Expr:
        """Return the function as UFL on the mesh of a model, where it is zero at vertices that are not on S.

        Raises:
            InputError: it is data of bodies or their sides; the model has another joint.
        """
        require(at.in_layers, "data of a body or its side", self, "values on S are data of layers")
        joint = at.domain.joint
        drawn_joint = self._surface.model.joint
        is_same = np.array_equal((joint.band.drawn_joint if joint.band else joint).points, drawn_joint.points)
        require(is_same, "joint of the model", joint, f"values on S are of {drawn_joint!r}")
        at_vertices: Array = np.zeros((len(self._values), len(drawn_joint.points)))
        at_vertices[:, self._surface.vertices] = self._values
        corners = joint.corners
        if joint.band:  # vertices of layers come from those of S that have the same place
            on_s = {tuple(drawn_joint.points[k]): k for k in self._surface.vertices}
            source = [on_s.get(tuple(place), -1) for place in joint.reference]
            at_vertices = np.hstack([at_vertices, np.zeros((len(at_vertices), 1))])[:, source]
        fields = [at.domain.cellwise_function(("Lagrange", 1), row[corners][..., None]) for row in at_vertices]
        return fields[0] if self._times is None else FieldInTime(fields, self._times, at.clock)
