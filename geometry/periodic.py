"""Periodic joints: sides of a cell that are identified with each other, because the cell repeats in space."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.spatial

from geometry.errors import GeometryError, place, unknown
from geometry.joint import Joint
from geometry.periods import SAME_PLACE, Periods
from geometry.topology import IntArray


def periodic(joint: Joint, *sides: tuple[str, str]) -> Joint:
    """The joint as a cell that repeats: displacements are the same on both sides of each pair.

    S may cross the sides, and goes on at the other one; it may not lie in them.

    Args:
        joint: the cell, cut through bodies.
        sides: names of two sets of outer facets each, such as ("LEFT", "RIGHT"); one is the other moved by a translation,
            with its facets. The other sides stay free.

    Raises:
        GeometryError: an unknown name; sides that do not match, with the place; less than three cells between two sides;
            a seam on a periodic side; a joint whose layer is meshed.
    """
    if joint.band is not None:
        raise GeometryError(
            "the joint's layer is meshed; in a periodic joint it is a surface, S, with an interface model"
        )
    if not sides:
        raise GeometryError('periodic needs pairs of sides, such as ("LEFT", "RIGHT")')
    before = joint.periods or Periods((), ())
    names = [*before.names, *(name for pair in sides for name in pair)]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise GeometryError(f"{twice[0]!r} is in two pairs of periodic sides; a side has one other side")
    pairs = tuple(_matched(joint, *pair) for pair in sides)
    named = tuple((first, second) for first, second in sides)
    return replace(joint, periods=Periods(before.sides + named, before.pairs + pairs))


def require_inside(joint: Joint) -> None:
    """Raise GeometryError if S reaches a periodic side: inflated, opposite sides would not match."""
    for names, pair in zip(joint.periods.sides, joint.periods.pairs, strict=True) if joint.periods else ():
        reached = np.intersect1d(pair, joint.surface)
        if len(reached):
            sides = " and ".join(map(repr, names))
            raise GeometryError(
                f"S reaches the periodic sides {sides}, at {place(joint.points[reached[0]])}: the layer cannot be meshed, "
                "as the sides would not match when it opens; cut the cell where S is not, use the interface model, or mesh "
                "a large piece that is not periodic"
            )


def repeated(inflated: Joint, periods: Periods) -> Joint:
    """An inflated joint, whose periodic sides have not moved, with the periods of the one that it came from."""
    pairs = tuple(_matched(inflated, *names) for names in periods.sides)
    return replace(inflated, periods=Periods(periods.sides, pairs))


def _matched(joint: Joint, first: str, second: str) -> IntArray:
    """(n, 2) nodes on the first side and the same ones on the second."""
    rows = [_outer_rows(joint, name) for name in (first, second)]
    nodes = [np.unique(joint.table.nodes(row, joint.cells, joint.cell_type)) for row in rows]
    x = [joint.points[node] for node in nodes]
    vector = x[1].min(axis=0) - x[0].min(axis=0)
    size = np.ptp(joint.points, axis=0).max()
    for here, there, move, name, other in ((0, 1, vector, first, second), (1, 0, -vector, second, first)):
        apart, at = scipy.spatial.cKDTree(x[there]).query(x[here] + move)
        if apart.max() > SAME_PLACE * size:
            lost = x[here][apart.argmax()]
            raise GeometryError(
                f"the sides {first!r} and {second!r} do not match: {name!r} has a node at {place(lost)}, and {other!r} has "
                f"none at {place(lost + move)}; mesh both alike"
            )
        if here == 0:
            partner = nodes[1][at]
    image = np.full(len(joint.points), -1)
    image[nodes[0]] = partner
    moved = joint.table.index(image[joint.table.vertices[rows[0]]])
    wrong = ~np.isin(moved, rows[1])
    if wrong.any() or len(rows[0]) != len(rows[1]):
        lost = joint.points[joint.table.vertices[rows[0][wrong.argmax()]]].mean(axis=0)
        raise GeometryError(
            f"the sides {first!r} and {second!r} do not match: their nodes do, but not their facets, as at {place(lost)}; "
            "mesh both alike"
        )
    return np.column_stack([nodes[0], partner])


def _outer_rows(joint: Joint, name: str) -> IntArray:
    """Rows of the joint's table of the facets of a side."""
    if name not in joint.facets:
        raise GeometryError(unknown("side", name, joint.facets.keys() - joint.seams.keys()))
    if name in joint.seams:
        raise GeometryError(
            f"the seam {name!r} cannot be a periodic side: the cells on its two sides are no neighbours in the mesh; cut "
            "the periodic cell through bodies instead"
        )
    rows = np.unique(joint.table.index(joint.facets[name]))
    inner = joint.table.cells[rows, 1] >= 0
    if inner.any():
        x = joint.points[joint.table.vertices[rows[inner][0]]].mean(axis=0)
        raise GeometryError(
            f"{name!r} is no side of the joint: {inner.sum()} of its facets lie inside, as at {place(x)}"
        )
    return rows
