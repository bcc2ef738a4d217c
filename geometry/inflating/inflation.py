"""Opening of S: layers become cells between bodies, with further cells at junctions, where layers meet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from forms.base import InputError, require
from geometry.inflating.band_cells import FacetLines, NodeCopies, NodeLines, band_cells, node_lines
from geometry.inflating.extended_bodies import extended_motion, face_motion
from geometry.inflating.junctions import (
    JunctionCells,
    JunctionCorners,
    common_normals,
    junction_cells,
    junction_corners,
)
from geometry.inflating.kept_bodies import NOT_KEPT_MESSAGE, THICKNESS_TOLERANCE, body_translations, require_room
from geometry.inflating.layering import (
    CellsThrough,
    Layering,
    Names,
    Profiles,
    Sizes,
    check_junctions,
    check_layering,
    moved_facets,
)
from geometry.joint import InflatedBand, Joint
from geometry.periodic import with_sides
from geometry.refusals import refuse
from geometry.seam import JUNCTIONS, LAYER, FacetName
from geometry.topology import FacetTable, FloatArray, IntArray, node_jacobians, positions


def inflate(
    joint: Joint,
    eps: float | Mapping[str, float],
    *,
    profile: Profiles = None,
    cells_through: CellsThrough = 4,
    fractions: Sequence[float] | Mapping[str, Sequence[float]] = (),
    bodies: str = "kept",
    junctions: Sequence[str] = (),
    gaps: Sequence[str] = (),
) -> Joint:
    """Return the joint with S opened to layers of the given thickness, meshed with cells.

    Each of `eps`, `profile` and `fractions` is one value for all seams or {name of a seam: value}.

    Args:
        joint: the joint as drawn, in which S is a surface.
        eps: thickness of the layers, a length > 0.
        profile: function of the coordinates (d, n) of n points in d dimensions that returns n numbers > 0. The
            thickness is eps times these numbers at the vertices of S, and linear in between. None: the thickness is eps
            everywhere.
        cells_through: number of cells through the thickness, at least 1; each sublayer gets at least one. It must be
            even where layers meet. Or {name of a seam: heights between which cells lie, as fractions of the thickness
            from 0 to 1}, among them those of sublayers.
        fractions: thickness of each sublayer over the layer's thickness, from the lower to the upper face, with sum 1;
            () for a layer without sublayers.
        bodies: "kept": the bodies keep their shape and move apart by eps at each facet of S, with the least jumps along
            S. A body on a rigid base stays in place, and the layer lies below it. The thickness must be uniform, and S
            must allow such a motion; planar seams of running bonds, crossings and stacks do. "extended": the outer
            shape of the whole is kept. Each body gives up half of the thickness, on a rigid base all of it. The other
            nodes of the body follow by a harmonic motion and slide along its outer boundary.
        junctions: names of seams in the order of priority for the cells of junctions, where layers meet; other seams
            follow in the joint's order. A junction's cells belong to the first seam in this order that ends there and
            is no gap.
        gaps: names of seams that get no cells, so that the space between their bodies stays empty. If a gap ends
            between layers, the junction there has cells. But where two neighbouring seams at a junction are gaps, the
            junction stays empty: the body between them would touch its cells at a corner only.

    Returns:
        A joint with the layer's cells in the region "LAYER", with sublayers in "LAYER/1", "LAYER/2", ... from the lower
        to the upper face. The facets between layer and bodies are the sets "LOWER_FACE" ("BASE" on a rigid base) and
        "UPPER_FACE". For an outer facet set NAME of the bodies, "NAME/LAYER" is the set of outer facets of the layer
        that continue it. With several seams, regions are "LAYER/SEAM", "LAYER/SEAM/1", ..., and faces
        "SEAM/LOWER_FACE", "SEAM/UPPER_FACE". Cells where three or more bodies meet are the region "LAYER/JUNCTIONS"
        ("LAYER/JUNCTIONS/SEAM" where they belong to different seams). Body cells keep their numbers and the order of
        their nodes; curved cells stay curved.

    Raises:
        InputError: a size, cells_through or fractions are out of range; S reaches a periodic side, ends inside the
            bodies or is folded; all seams are gaps. With "kept": the thickness varies, or bodies cannot move apart in
            one piece. With "extended": the outer boundary meets S nearly parallel to it, or layers of different
            thickness meet nearly in line. Cells turn inside out, or layers overlap the bodies. A junction has
            sublayers, a varying thickness, curved cells or an odd number of cells; in 3D junctions meet at a vertex.
            Bodies touch only at a vertex or along an edge.
    """
    check_layering(cells_through, bodies)
    require(isinstance(joint, Joint), "joint", joint, "it must be a Joint")
    if joint.band is not None:
        raise InputError("this joint is inflated already; inflate the joint it came from")
    periods, joint = joint.periods, replace(joint, periods=None)
    fixed_nodes: IntArray = np.empty(0, np.int64)
    if periods:
        fixed_nodes = np.unique(np.concatenate(periods.node_pairs))
        sides = f"the periodic sides {' and '.join(map(repr, periods.side_names))}"
        text = f"S reaches one of {sides}, at {{at}}, which would not match when the layer opens; cut the cell where S"
        advice = "is not, use the interface model, or mesh a large piece that is not periodic"
        refuse(np.isin(fixed_nodes, joint.surface), joint.points[fixed_nodes], f"{text} {advice}")
    layering = Layering.of(joint, eps, profile, cells_through, fractions, junctions, gaps)
    copies = NodeCopies.of(joint)
    lines, s_lines = node_lines(joint, copies, layering.heights)
    check_junctions(joint, lines, layering)
    lines, polygon_corners = junction_corners(joint, lines, s_lines)

    copy_motion = _node_motion(joint, copies, layering.thickness, bodies, fixed_nodes)
    line_motion, line_s_nodes = lines.interpolate(copy_motion)
    motion = np.concatenate([copy_motion, line_motion])
    drawn_nodes = np.concatenate([np.arange(len(joint.points)), copies.copied_nodes, line_s_nodes])

    bands, sublayers = _layer_cells(joint, lines, s_lines, layering)
    fill = _BandCells(joint.cells[:0], joint.region[:0], bands.director[:0])
    if polygon_corners:
        all_fill = junction_cells(joint, lines, polygon_corners, copy_motion, drawn_nodes[: len(copy_motion)])
        motion, drawn_nodes = np.concatenate([motion, all_fill.values]), np.concatenate([drawn_nodes, all_fill.s_nodes])
        fill = _kept_junction_cells(joint, lines, s_lines, polygon_corners, layering.junction_priority, all_fill)
    owner_seams, seams, prefix = np.unique(fill.region), list(joint.seams), f"{LAYER}/{JUNCTIONS}"
    fill_regions = {prefix if len(owner_seams) == 1 else f"{prefix}/{seams[k]}": seams[k] for k in owner_seams}
    tilted = (fill.director == 0).all(axis=(1, 2))
    first_fill_region = len(joint.regions) + sum(map(len, sublayers.values()))

    cells, is_used = np.concatenate([copies.body_cells, bands.cells, fill.cells]), np.zeros(len(drawn_nodes), bool)
    is_used[cells] = True
    new_numbers = np.where(is_used, np.cumsum(is_used) - 1, -1)
    drawn_nodes, cells, copies = drawn_nodes[is_used], new_numbers[cells], copies.renumbered(new_numbers)
    drawn_points = joint.points[drawn_nodes]
    points = drawn_points + motion[is_used]
    _check_cells(joint, points, cells, len(bands.cells))
    layer_corners = cells[len(joint.cells) :, : joint.corners.shape[1]]
    facets, faces = moved_facets(joint, copies, layering, layer_corners, len(bands.cells), drawn_nodes)
    layer_regions = (*(name for of_seam in sublayers.values() for name in of_seam), *fill_regions)
    aligned = tuple(name for name, seam in fill_regions.items() if seams.index(seam) not in fill.region[tilted])
    director = np.concatenate([bands.director, np.where(tilted[:, None, None], np.eye(joint.dim)[1], fill.director)])
    band = InflatedBand(
        layering.eps, bodies, layer_regions, sublayers, fill_regions, aligned, faces, joint, drawn_points, director,
        np.stack([copies.below, copies.above]),
    )  # fmt: skip
    region = np.concatenate([joint.region, bands.region, first_fill_region + np.searchsorted(owner_seams, fill.region)])
    inflated = Joint(points, cells, joint.cell_type, region, joint.regions + layer_regions, facets, joint.seams, band)
    return with_sides(inflated, periods.sides) if periods else inflated


def without_bodies(inflated: Joint) -> Joint:
    """Return the layers of a joint with meshed layers as a joint of their own, without bodies.

    For an outer facet set NAME of the bodies, "NAME/LAYER" is the set of outer facets of the layers that continue it.
    In the result these facets are also the set NAME.
    """
    band = inflated.band
    assert band is not None
    first_region = len(inflated.regions) - len(band.regions)
    in_layer = inflated.region >= first_region
    used_nodes, cells = np.unique(inflated.cells[in_layer], return_inverse=True)
    new_numbers = positions(used_nodes, len(inflated.points))
    table = FacetTable.of(cells[:, : inflated.corners.shape[1]], inflated.cell_type)
    facets: dict[str, IntArray] = {}
    for name, set_facets in inflated.facets.items():
        layer_facets = new_numbers[set_facets]
        if len(layer_facets := layer_facets[table.index(layer_facets) >= 0]):
            facets[name] = facets[FacetName.parse(name).continued_set] = layer_facets
    points, region = inflated.points[used_nodes], inflated.region[in_layer] - first_region
    face_nodes = np.where(band.face_nodes >= 0, new_numbers[band.face_nodes], -1)
    new_band = replace(band, reference=band.reference[used_nodes], face_nodes=face_nodes)
    return Joint(points, cells, inflated.cell_type, region, band.regions, facets, inflated.seams, new_band)


class _BandCells(NamedTuple):
    """Cells of layers, with their regions and the normals of S.

    Attributes:
        cells: (n, k) numbers of the k nodes of each cell.
        region: (n,) number of each cell's region; for cells that `_kept_junction_cells` returns, the position in
            `joint.seams` of the seam that they belong to instead.
        director: (n, m, d) unit normal of S in d dimensions below or above each of a cell's m vertices; zero in
            junctions of layers with different normals.
    """

    cells: IntArray
    region: IntArray
    director: FloatArray


def _kept_junction_cells(
    joint: Joint, lines: NodeLines, s_lines: FacetLines, corners: JunctionCorners, priority: Names, fill: JunctionCells
) -> _BandCells:
    """Return the cells of junctions, except of those where two neighbouring seams are gaps.

    In the result, `region` is the position in `joint.seams` of the seam that a junction's cells belong to.

    Args:
        joint: the joint as drawn, before S is opened.
        lines: all lines of nodes through the thickness.
        s_lines: the lines at the nodes of each facet of S.
        corners: corners of the polygons that open at junctions.
        priority: names of the seams with cells, in order of priority for the cells of junctions.
        fill: cells in all junctions.
    """
    seams, no_rank = list(joint.seams), len(priority)
    rank = np.array([priority.index(name) if name in priority else no_rank for name in seams])
    line_rank = np.full(len(lines.feet), no_rank)  # the sides that close a polygon have no seam
    line_rank[: s_lines.line_numbers.max() + 1] = rank[lines.seam_no[: s_lines.line_numbers.max() + 1]]
    best_rank = np.full(int(corners.junc.max()) + 1, no_rank)
    np.minimum.at(best_rank, corners.junc, line_rank[corners.sides].min(axis=(1, 2)))
    owner_seams = np.array([*map(seams.index, priority), -1])[best_rank[corners.junc]]
    is_gap = line_rank == no_rank
    # where a body has a corner between two gaps there are no cells: it would touch them at that corner only
    is_empty = np.bincount(corners.junc, is_gap[corners.sides[:, 0]].all(axis=1)) > 0
    is_kept = ~is_empty[corners.junc][fill.corner]
    cells, corner = fill.cells[is_kept], fill.corner[is_kept]
    normals = common_normals(joint, s_lines, corners, is_gap)[corner]
    return _BandCells(cells, owner_seams[corner], np.broadcast_to(normals[:, None], (*cells.shape, joint.dim)))


def _layer_cells(
    joint: Joint, lines: NodeLines, s_lines: FacetLines, layering: Layering
) -> tuple[_BandCells, dict[str, tuple[str, ...]]]:
    """Return the cells of all layers, without those of junctions, and the names of their regions.

    Args:
        joint: the joint as drawn, before S is opened.
        lines: all lines of nodes through the thickness.
        s_lines: the lines at the nodes of each facet of S.
        layering: checked arguments for the layers.

    Returns:
        The cells; and name of a seam -> names of the regions of its sublayers, from the lower to the upper face. Gaps
        are left out.
    """
    bands: list[_BandCells] = []
    names: dict[str, tuple[str, ...]] = {}
    first_region = len(joint.regions)
    for seam_no, seam in enumerate(joint.seams):
        if seam not in layering.junction_priority:
            continue
        rows, fractions = np.flatnonzero((joint.seam_numbers == seam_no) & layering.has_cells), layering.fractions[seam]
        cells, sublayer, director = band_cells(joint, lines, s_lines, rows, layering.heights[seam_no], fractions)
        layer_name = LAYER if len(joint.seams) == 1 else f"{LAYER}/{seam}"
        names[seam] = tuple(f"{layer_name}/{k + 1}" for k in range(len(fractions))) if len(fractions) else (layer_name,)
        bands.append(_BandCells(cells, first_region + sublayer, director))
        first_region += len(names[seam])
    return _BandCells(*map(np.concatenate, zip(*bands, strict=True))), names


def _node_motion(joint: Joint, copies: NodeCopies, thickness: FloatArray, bodies: str, fixed: IntArray) -> FloatArray:
    """Return (n_nodes, d) the motion of all nodes and copies in d dimensions as the layers open, lengths.

    Args:
        joint: the joint as drawn, before S is opened.
        copies: copies of its nodes, one on each body and on a rigid base.
        thickness: (n_S, k) thickness of the layer at the k nodes of each facet of S, lengths.
        bodies: "kept" or "extended".
        fixed: numbers of nodes that must not move if `bodies` is "extended"; "kept" disregards them.

    Raises:
        InputError: the bodies cannot make room in this way.
    """
    n_nodes = len(joint.points) + len(copies.copied_nodes)
    if bodies == "extended":
        on_base = (joint.surface_cells[:, 0] < 0)[:, None]
        depth_above, depth_below = np.where(on_base, thickness, thickness / 2), np.where(on_base, 0.0, thickness / 2)
        face_nodes, face_values = face_motion(joint, copies, (depth_below, depth_above))
        return extended_motion(joint, copies.body_cells, n_nodes, face_nodes, face_values, fixed)
    for seam_no, name in enumerate(joint.seams):
        eps = thickness[joint.seam_numbers == seam_no]
        if np.ptp(eps) > THICKNESS_TOLERANCE * eps.max():
            raise InputError(f"the thickness varies along {name}: {NOT_KEPT_MESSAGE}")
    translation, motion = body_translations(joint, thickness[:, 0]), np.zeros((n_nodes, joint.dim))
    require_room(joint, translation)
    motion[copies.body_cells] = translation[joint.split_mesh.pieces][:, None]
    motion[len(joint.points) :][copies.is_on_base] = translation[-1]
    return motion


def _check_cells(joint: Joint, points: FloatArray, cells: IntArray, n_band_cells: int) -> None:
    jacobians = node_jacobians(joint.points, joint.cells, joint.cell_type)
    new_jacobians = node_jacobians(points, cells, joint.cell_type)
    n = len(joint.cells)
    complaint = "eps is too large for these bodies: {bad} cells turn inside out, the first at {at}; take a smaller eps"
    remedy = "larger cells there (at sharp ends several times eps), or on planar seams bodies='kept', which keeps cells"
    refuse((jacobians * new_jacobians[:n] <= 0).any(axis=1), joint.points[joint.cells], f"{complaint}, {remedy}")
    folded = np.abs(np.sign(new_jacobians[n:]).sum(axis=1)) < new_jacobians.shape[1]
    where = "the layer" if folded[:n_band_cells].any() else "a junction of layers"
    refuse(folded, points[cells[n:]], f"S turns too sharply for eps: {{bad}} cells of {where} are folded, as at {{at}}")


def with_gaps(joint: Joint, eps: Sizes, *, profile: Profiles = None) -> Joint:
    """Return the joint with bodies that gave up the layers' thickness, but with empty space in place of the layers.

    The bodies make room as in `inflate(..., bodies="extended")`. The result differs from `joint`
    only in `parted`, the new coordinates of the nodes of each cell. In `points` the bodies still meet on S.

    Args:
        joint: the joint as drawn, in which S is a surface.
        eps: thickness of the layers, a length > 0, or {name of a seam: thickness}.
        profile: function of the coordinates (d, n) of n points in d dimensions that returns n numbers > 0, by which eps
            is multiplied; or {name of a seam: function}. None: the thickness is eps.

    Raises:
        InputError: eps or the profile is out of range; S reaches a periodic side, ends inside the bodies or is folded;
            bodies cannot give way or would turn cells inside out.
    """
    inflated = inflate(joint, eps, profile=profile, cells_through=2, bodies="extended")
    return replace(joint, parted=inflated.points[inflated.cells[: len(joint.cells)]])


def points_on_middle(joint: Joint) -> FloatArray:
    """Return (n_points, d) coordinates of a joint's points, where those on S lie midway between its two sides.

    Points that are not on S are those of `joint.points`. If the bodies have not moved apart, all points are.

    Args:
        joint: the joint, in d dimensions; if its bodies have moved apart, its seams must not meet.
    """
    points = joint.points.copy()
    points[joint.surface] = joint.faces.mean(axis=0)
    return points


def offset_to_middle(joint: Joint) -> FloatArray:
    """Return for each cell the vectors from its nodes on S to the middle of the gap between bodies that moved apart.

    Args:
        joint: the joint, such as that of `with_gaps`, in d dimensions.

    Returns:
        (n_cells, k, d) vectors at the k nodes of each cell, lengths; zero at nodes that are not on S. The middle lies
        halfway between the lower and the upper side of S.
    """
    offsets, face_points = np.zeros_like(joint.cell_points), joint.faces
    for cells, in_cells, side_points in zip(joint.surface_cells.T, joint.in_cells, face_points, strict=True):
        at = np.flatnonzero(cells >= 0)
        offsets[cells[at, None], in_cells[at]] = (face_points.mean(axis=0) - side_points)[at]
    return offsets
