"""Periodic joints: cells that repeat in space, whose opposite sides are identified with each other."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain

import numpy as np
import scipy.spatial

from forms.base import InputError, require
from geometry.identified_sides import CUT_ADVICE, DISTANCE_TOLERANCE, Periods
from geometry.joint import Joint
from geometry.refusals import place_text, refuse, require_known
from geometry.topology import IntArray


def periodic(joint: Joint, *sides: tuple[str, str]) -> Joint:
    """Return the joint as a periodic cell, where displacements are equal on both sides of each pair of sides.

    S may cross the sides, and continues at the opposite side; it must not lie in them.

    Args:
        joint: the cell; its outer boundary cuts through bodies, not along S.
        sides: pairs of names of outer facet sets, such as ("LEFT", "RIGHT"). A translation maps the facets of the first
            set onto the facets of the second. Sides that are not named stay ordinary outer boundary.

    Raises:
        InputError: an unknown name; sides that do not match (the message names the place); less than three cells
            between two sides; a seam on a periodic side; a joint whose layer is meshed.

    Example:
        >>> from geometry import periodic, sandwich
        >>> plates = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> joint = periodic(plates, ("LEFT", "RIGHT"))
        >>> sorted(joint.facets)
        ['BOTTOM', 'LEFT', 'RIGHT', 'S', 'TOP']
    """
    require(isinstance(joint, Joint), "joint", joint, "it must be a Joint")
    if joint.band is not None:
        raise InputError("the joint's layer is meshed already; make the joint periodic first, then mesh the layer")
    all_sides = (joint.periods.sides if joint.periods else ()) + sides
    names = [*chain(*all_sides)]
    for name in (name for name in names if names.count(name) > 1):
        raise InputError(f"{name!r} is in two pairs of periodic sides; a side belongs to one pair")
    return with_sides(joint, all_sides)


def with_sides(joint: Joint, sides: tuple[tuple[str, str], ...]) -> Joint:
    """Return a joint, which may have meshed layers, as a periodic cell with these pairs of identified sides."""
    return replace(joint, periods=Periods(sides, tuple(_match_nodes(joint, *pair) for pair in sides)))


def _match_nodes(joint: Joint, first: str, second: str) -> IntArray:
    """Return the pairs of nodes on two sides that a translation of one side onto the other brings together.

    Args:
        joint: the joint.
        first, second: names of the outer facet sets that are the two sides.

    Returns:
        (n, 2) number of each node on the first side, and of the node on the second side that matches it.

    Raises:
        InputError: nodes or facets of the two sides do not match.
    """
    side_rows = [_outer_rows(joint, name) for name in (first, second)]
    nodes = [np.unique(joint.table.nodes(row, joint.cells, joint.cell_type)) for row in side_rows]
    x = [joint.points[node] for node in nodes]
    vector, size = x[1].min(axis=0) - x[0].min(axis=0), joint.size
    mismatch, remedy = f"the sides {first!r} and {second!r} do not match", "mesh both alike"
    directions = [(x[0], x[1], vector, first, second), (x[1], x[0], -vector, second, first)]
    partners = []
    for places, others, move, name, other in directions:
        distance, at = scipy.spatial.cKDTree(others).query(places + move)
        partners.append(at)
        if distance.max() > DISTANCE_TOLERANCE * size:
            alone = places[distance.argmax()]
            text = f"{name!r} has a node at {place_text(alone)}, and {other!r} has none at {place_text(alone + move)}"
            raise InputError(f"{mismatch}: {text}; {remedy}")
    partner = np.full(len(joint.points), -1)
    partner[nodes[0]] = nodes[1][partners[0]]
    facets = joint.table.vertices[side_rows[0]]
    is_wrong = ~np.isin(joint.table.index(partner[facets]), side_rows[1]) | (len(side_rows[0]) != len(side_rows[1]))
    refuse(is_wrong, joint.points[facets], f"{mismatch}: their nodes do, but not their facets, as at {{at}}; {remedy}")
    return np.column_stack([nodes[0], partner[nodes[0]]])


def _outer_rows(joint: Joint, name: str) -> IntArray:
    """Return the row numbers in `joint.table` of the facets in the outer facet set `name`.

    Raises:
        InputError: the set is unknown, is a seam or has facets inside.
    """
    if name in joint.seams:
        raise InputError(f"the seam {name!r} cannot be a periodic side: {CUT_ADVICE}")
    require_known("side", name, joint.facets.keys() - joint.seams.keys())
    rows = np.unique(joint.table.index(joint.facets[name]))
    is_inner, x = joint.table.cells[rows, 1] >= 0, joint.points[joint.table.vertices[rows]]
    refuse(is_inner, x, f"{name!r} is not a side of the joint: {{bad}} of its facets lie inside, as at {{at}}")
    return rows
