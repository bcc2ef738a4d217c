"""Checked arguments of `inflate` for each seam's layer, and facet sets of the joint with meshed layers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Self, TypeVar

import numpy as np

from forms.base import InputError, is_finite, is_integer, require
from geometry.inflating.band_cells import NodeCopies, NodeLines, level_heights
from geometry.joint import Joint, Profile
from geometry.refusals import place_text, refuse, require_known
from geometry.seam import BASE, LAYER, LOWER_FACE, UPPER_FACE, FacetName
from geometry.sheet import continued_ridge_keys
from geometry.topology import BoolArray, FacetTable, FloatArray, IntArray, facet_ridge_keys

BODY_CHOICES = ("kept", "extended")
MIN_THICKNESS = 1e-11  # smallest thickness of a meshed layer, over the size of its joint
ValueType = TypeVar("ValueType")
Names = Sequence[str]
Sizes = float | Mapping[str, float]
Shares = Sequence[float] | Mapping[str, Sequence[float]]
Profiles = Profile | Mapping[str, Profile | None] | None
CellsThrough = int | Mapping[str, Sequence[float]]


def value_by_seam(
    joint: Joint, value: ValueType | Mapping[str, ValueType], argument: str, *default: ValueType
) -> dict[str, ValueType]:
    """Return name of a seam -> its value, for all seams of a joint.

    Args:
        joint: the joint with the seams.
        value: one value for all seams, or {name of a seam: value}.
        argument: name of the argument, for messages.
        default: at most one value, for seams that `value` does not name; without it, each seam must be named.

    Raises:
        InputError: a value for an unknown seam, or none for a seam.
    """
    if not isinstance(value, Mapping):
        return dict.fromkeys(joint.seams, value)
    for name in value:
        require_known("seam", name, joint.seams, argument)
    missing = [name for name in joint.seams if name not in value]
    if missing and not default:
        raise InputError(f"the seam {missing[0]!r} has no {argument}; give {argument}={{{missing[0]!r}: ..., ...}}")
    return {name: value[name] if name in value else default[0] for name in joint.seams}


def check_layering(cells_through: CellsThrough, bodies: str) -> None:
    """Raise InputError unless the arguments `cells_through` and `bodies` of `inflate` are allowed.

    Args:
        cells_through: number of cells through the thickness, a whole number >= 1, or {name of a seam: heights}.
        bodies: "kept" or "extended".
    """
    require_known("way to make room for the layer (bodies=...)", bodies, BODY_CHOICES)
    wanted = "the layer needs a whole number >= 1 of cells"
    is_allowed = isinstance(cells_through, Mapping) or is_integer(cells_through, 1)
    require(is_allowed, "cells_through", cells_through, wanted)


class Layering(NamedTuple):
    """Checked arguments of `inflate` for the layers of all seams.

    Attributes:
        eps: name of a seam -> thickness of its layer, a length.
        fractions: name of a seam -> thickness of each sublayer over the layer's, from the lower to the upper face; ()
            for no sublayers.
        heights: for each seam the heights of the levels of nodes, as fractions of the thickness from 0 to 1.
        thickness: (n_S, k) thickness at the k nodes of each facet of S, lengths.
        varying_seams: names of the seams with a profile.
        junction_priority: names of the seams that get cells, in order of priority for the cells of junctions.
        has_cells: (n_S,) whether the seam of each facet of S gets cells; False in gaps.
    """

    eps: dict[str, float]
    fractions: dict[str, Sequence[float]]
    heights: list[FloatArray]
    thickness: FloatArray
    varying_seams: tuple[str, ...]
    junction_priority: list[str]
    has_cells: BoolArray

    @classmethod
    def of(
        cls,
        joint: Joint,
        eps: Sizes,
        profile: Profiles,
        through: CellsThrough,
        fractions: Shares,
        junctions: Names,
        gaps: Names,
    ) -> Self:
        """Return the checked arguments of `inflate` with values for each seam.

        Args:
            joint: the joint as drawn, in which S is a surface.
            eps: thickness of the layers, a length > 0, or {name of a seam: thickness}.
            profile: function of coordinates (d, n) of n points in d dimensions that returns n factors of eps > 0; or
                {name of a seam: function}; None: all factors are 1.
            through: number of cells through the thickness, or {name of a seam: heights between which cells lie}.
            fractions: thickness of each sublayer over the layer's, () for no sublayers; or {name of a seam: such
                fractions}.
            junctions: names of the first seams in the order of priority for the cells of junctions.
            gaps: names of the seams that get no cells.

        Raises:
            InputError: an argument is out of range, all seams are gaps, or S ends inside the bodies.
        """
        for argument, names in (("junctions", junctions), ("gaps", gaps)):
            for name in names:
                require_known("seam", name, joint.seams, argument)
        in_gaps = np.isin(np.array([*joint.seams])[joint.seam_numbers], list(gaps))
        if in_gaps.all():
            raise InputError("all seams are gaps: there is no layer to mesh; use the interface model")
        eps_of = value_by_seam(joint, eps, "eps")
        fractions_of: dict[str, Sequence[float]] = value_by_seam(joint, fractions, "fractions", ())
        profiles: dict[str, Profile | None] = value_by_seam(joint, profile, "profile", None)
        too_thin = f"the coordinates of bodies of size {joint.size:.3g} do not resolve it; use the interface model"
        for name, size in eps_of.items():
            which, part = "" if len(joint.seams) == 1 else f" of {name!r}", fractions_of[name]
            require(is_finite(size) and size > 0, f"the layer's thickness eps{which}", size, "it must be > 0")
            require(size >= MIN_THICKNESS * joint.size, f"the layer's thickness eps{which}", size, too_thin)
            if len(part) and not (all(map(is_finite, part)) and min(part) > 0 and abs(sum(part) - 1) <= 1e-12):
                raise InputError(f"the fractions {tuple(part)}{which} of sublayers must be numbers > 0 and add up to 1")
        if joint.tip is not None:
            tip = f"S ends inside the bodies (near {place_text(joint.tip)})"
            raise InputError(f"{tip}: the layer has no room at its tip and cannot be meshed; use the interface model")
        at_nodes = np.stack([size * joint.relative_thickness(profiles[name], name) for name, size in eps_of.items()])
        thickness = at_nodes[joint.seam_numbers[:, None], joint.surface]
        through_of: dict[str, int | Sequence[float]] = value_by_seam(joint, through, "cells_through", 1)
        heights = [level_heights(joint.degree, through_of[name], part) for name, part in fractions_of.items()]
        varying_seams = tuple(name for name in joint.seams if profiles[name] is not None)
        junction_priority = [name for name in dict.fromkeys([*junctions, *joint.seams]) if name not in gaps]
        eps_of = {name: float(size) for name, size in eps_of.items()}
        return cls(eps_of, fractions_of, heights, thickness, varying_seams, junction_priority, ~in_gaps)


def check_junctions(joint: Joint, lines: NodeLines, layering: Layering) -> None:
    """Raise InputError if layers meet at a junction that cannot be meshed.

    Such layers have sublayers, a varying thickness, curved cells or an odd number of cells through the thickness.

    Args:
        joint: the joint as drawn, before S is opened.
        lines: all lines of nodes through the thickness, at the nodes of S.
        layering: checked arguments for the layers.
    """
    junction_lines = np.flatnonzero(np.bincount(lines.feet)[lines.feet] > 1)
    names, x = np.array([*joint.seams])[lines.seam_no[junction_lines]], joint.points[lines.feet[junction_lines]]
    with_sublayers = [name for name, fractions in layering.fractions.items() if len(fractions)]
    for reason, bad_seams in (
        ("the sublayers of one layer have no place in the others", with_sublayers),
        ("junctions are meshed between layers of uniform thickness only", list(layering.varying_seams)),
        ("junctions are meshed between straight-sided cells only", [*joint.seams] if joint.degree == 2 else []),
    ):
        refuse(np.isin(names, bad_seams), x, f"S branches at {{at}}: {reason}; use the interface model")
    is_odd = lines.last_level[junction_lines] % 2 > 0
    refuse(is_odd, x, "layers meet at {at} and need an even number of cells (cells_through) there")


def moved_facets(
    joint: Joint, copies: NodeCopies, layering: Layering, cells: IntArray, n_band_cells: int, drawn_nodes: IntArray
) -> tuple[dict[str, IntArray], tuple[str, ...]]:
    """Return the facet sets of the joint with meshed layers.

    Args:
        joint: the joint as drawn, before S is opened.
        copies: copies of its nodes, one on each body.
        layering: checked arguments for the layers.
        cells: (n, m) numbers of the m vertices of each of the layers' cells, those of junctions last.
        n_band_cells: number of the layers' cells that are not in junctions.
        drawn_nodes: (n_nodes,) for each node of the joint with layers the node of the joint as drawn that it comes
            from. For copies and for nodes inside layers this is a node of S.

    Returns:
        Name of a set -> (n, k) numbers of the k vertices of each of its n facets; and the names of the sets of facets
        between bodies and layers.
    """
    has_cells, vertex_order = layering.has_cells, np.argsort(joint.surface[:, : joint.table.vertices.shape[1]], axis=1)
    above, below = (np.take_along_axis(side, vertex_order, axis=1) for side in (copies.above, copies.below))
    on_base = joint.surface_cells[:, 0] < 0
    new_facets: dict[str, IntArray] = {}
    face_names: list[str] = []
    for seam_no, seam in enumerate(joint.seams):
        in_seam, several = joint.seam_numbers == seam_no, len(joint.seams) > 1
        face_facets = {UPPER_FACE: above} if on_base[in_seam].any() else {UPPER_FACE: above, LOWER_FACE: below}
        named = {str(FacetName(seam, name)) if several else name: side[in_seam] for name, side in face_facets.items()}
        new_facets |= named
        face_names += named if has_cells[in_seam].any() else ()
    if (on_base & has_cells).any():
        new_facets[BASE] = below[on_base & has_cells]
    table = FacetTable.of(cells, joint.cell_type)
    is_outer = table.cells[:, 1] < 0
    is_outer[table.index(np.concatenate([above[has_cells], below[has_cells]]))] = False
    outer_facets, in_band = table.vertices[is_outer], table.cells[is_outer, 0] < n_band_cells
    s_vertices = drawn_nodes[outer_facets]
    below_keys, is_upright = facet_ridge_keys(s_vertices, joint.dim - 1), (s_vertices == s_vertices[:, :1]).all(axis=1)
    for name, facets in joint.facets.items():
        if name in joint.seams:
            continue
        rows = joint.table.index(facets)
        new_facets[name] = joint.table.nodes(rows, copies.body_cells[:, : joint.corners.shape[1]], joint.cell_type)
        continues = np.isin(below_keys, continued_ridge_keys(joint, facets)).any(axis=1)
        # in 3D the end of a junction continues the same sets as its layers
        continues |= is_upright & np.isin(s_vertices[:, 0], s_vertices[continues & in_band])
        if continues.any():
            new_facets[str(FacetName(name, LAYER))] = outer_facets[continues]
    return new_facets, tuple(face_names)
