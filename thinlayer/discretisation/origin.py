"""Origin of a mesh: numbers, places and columns in the joint, for compiled laws."""

from __future__ import annotations

from functools import partial

import numpy as np
import numpy.typing as npt

from geometry.domain import Domain
from geometry.inflating.parting import points_on_middle, to_middle
from geometry.joint import Joint
from thinlayer.discretisation.given import Coordinates
from thinlayer.discretisation.joint_fields import cellwise
from thinlayer.pointwise.quadrature import Origin

Array = npt.NDArray[np.float64]


def origin_of(domain: Domain) -> Origin:
    """The joint that a domain was made from."""
    joint, x = domain.joint, Coordinates.of(domain).x
    columns = partial(column_numbers, joint)
    if joint.parted is None:
        return Origin(domain.comm, x, domain.numbers, columns)
    on_s = x + cellwise(domain, ("DG", joint.degree, (joint.dim,)), to_middle(joint))
    return Origin(domain.comm, x, domain.numbers, columns, on_s, points_on_middle(joint))


def column_numbers(joint: Joint) -> tuple[npt.NDArray[np.int64], Array]:
    """The column of every cell of an inflated joint (-1 outside the layer), or of every facet; and their centres.

    Returns:
        Numbers (cells or facets,), and the centres (columns, d) of the facets of S in the joint before inflating.
    """
    if joint.band is None:
        rows = joint.surface_rows
        numbers = np.full(len(joint.table.vertices), -1, np.int64)
        numbers[rows] = np.arange(len(rows))
        return numbers, joint.points[joint.table.vertices[rows]].mean(axis=1)
    regions = [joint.regions.index(name) for name in joint.band.regions]
    layer = np.flatnonzero(np.isin(joint.region, regions))
    places, place = np.unique(joint.reference, axis=0, return_inverse=True)
    below = np.sort(place.ravel()[joint.corners[layer]], axis=1)  # the facet's vertices, some of them twice
    below[:, 1:][below[:, 1:] == below[:, :-1]] = -1
    facets, column = np.unique(np.sort(below, axis=1), axis=0, return_inverse=True)
    numbers = np.full(len(joint.cells), -1, np.int64)
    numbers[layer] = column.ravel()
    vertices = (facets >= 0)[:, :, None]
    return numbers, (places[facets] * vertices).sum(axis=1) / vertices.sum(axis=1)
