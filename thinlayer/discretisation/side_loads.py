"""Tractions on a layer's own side, of height eps, where the layer has no cells: forces of order eps on its two faces.

A traction t on the side does the work eps t . v per length of the rim of S, v the mean displacement of the side. Between
faces of displacements <u> -+ [u]/2 the ansatz of order 1 has v = <u>: each face gets half of the force. At a free end
(`forms.ends`) the side moves besides by -(c_N M/lmbda) [u_N] along the outward normal m in S and by -c_T [u_m] along n
(reciprocity: the energy that the end takes away), which is of the same size, and the force reaches the faces
over lengths of the thickness, at the mean distances rho_N eps (along m), c_T eps (along n) and 7 zeta(3)/pi^3 eps
(along the end). With the weights a of `forms.ends.weights` the work is then

    int_S { eps [t_m v_m f_N' + t_n v_n f_T' + t_tau v_tau f'] - a_N M/lmbda t_m [v_N] - a_T t_n [v_m] },  v = <u>,

f' = 1/r within r of the end. Without it loads on sides leave errors as large as what they do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import basix
import numpy as np
import ufl
from dolfinx import fem

from forms.elastic import poisson_ratio
from forms.ends.constants import FreeEnd, free_end
from forms.ends.weights import Strips
from forms.kinematics import Expr
from forms.planes import Kinematics
from forms.work import Interface
from geometry.joint import Joint
from geometry.seam import LAYER
from geometry.sheet import Rim, Sheet, StraightEnd, share_within, straight_ends
from geometry.topology import BoolArray, FloatArray, IntArray, ridge_keys
from thinlayer.discretisation.forces import Forces, Weighted
from thinlayer.discretisation.given import Coordinates, Load, Pressure, vanishes
from thinlayer.discretisation.layer import SeamLayer, real_law
from thinlayer.discretisation.mesh_functions import cellwise
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.point_loads import ConcentratedForms, Nodes, along_edges
from thinlayer.errors import Refused

# 7 zeta(3)/pi^3: mean distance over the thickness of the tractions that balance a load along the end
ANTIPLANE = 0.2713773
AtBase = Callable[[Expr], Expr]
Piece = tuple[Expr, Weighted]  # of a load, and where it acts


@dataclass(frozen=True)
class SideLoad:
    """A traction on the side of a layer of order 1.

    Attributes:
        what: words for errors.
        load: as given.
        rim: the ridges of S that have this side.
    """

    what: str
    load: Load | Pressure
    rim: Rim

    @classmethod
    def of(cls, model: Model, one: SeamLayer) -> Iterator[SideLoad]:
        """Those of a layer, but for zeros."""
        tractions, facets, rim = model.structure.tractions or {}, model.joint.facets, one.sheet.rim
        for name in sorted(tractions):
            whole = name.removesuffix(f"/{LAYER}")
            given = cls(f"traction on {name!r}", tractions[name], rim)
            if whole != name and not vanishes(given.load):
                here = rim.on(facets[whole])
                if here.any():
                    yield given.on(here)

    def on(self, which: BoolArray) -> SideLoad:
        """The same on some of its ridges."""
        return replace(self, rim=self.rim[which])

    @property
    def varies(self) -> bool:
        """Whether it is a function of place and time."""
        return callable(self.load.p if isinstance(self.load, Pressure) else self.load)

    def weights(self, areas: FloatArray) -> FloatArray:
        """Weights (..., c) for `at_points` of parts of a side, given by area times outward normal, (..., d)."""
        return -areas if isinstance(self.load, Pressure) else np.linalg.norm(areas, axis=-1, keepdims=True)

    def at_points(self, at: Coordinates, g: Expr) -> tuple[Expr, Callable[[Expr], Expr]]:
        """The load at places with densities g (c,) of `weights`, and what it works in: of displacements v."""
        if isinstance(self.load, Pressure):
            return at.given(self.load.p, self.what, ()).expression, lambda v: ufl.dot(g, v)
        return at.given(self.load, self.what, (at.mesh.geometry.dim,)).expression, lambda v: g[0] * v


def add_side_loads(forces: Forces, model: Model, one: SeamLayer, sides: Interface, at_base: AtBase) -> None:
    """Add the tractions on the side of a layer of order 1 to the forces of an interface model.

    Args:
        forces: the forces.
        model: the model.
        one: the layer.
        sides: of its seam.
        at_base: motions of a rigid base, from those at the facets of the body above it.
    """
    reduction = model.reductions[one.name]
    free = ridge_keys(reduction.loose.vertices)
    for load in SideLoad.of(model, one):
        if one.flows:
            reason = f"the {load.what} acts on the side of {one}, whose pressure of order 1 is zero at free ends"
            raise Refused("loaded side", reason).error()
        known = np.isin(ridge_keys(load.rim.vertices), free) & (reduction.weights is not None)
        found = [*_at_ends(load.on(known), forces.at, model, one, sides)]
        if not known.all():
            refused = reduction.why_not("ends")
            why = f", as {refused.reason}" if refused else " where a support holds the side"
            model.warn(
                "halves",
                f"{load.what}: each face of {one} gets half of the force, and how it reaches the faces makes a difference "
                f"as large as the force, which is not known{why}; mesh the layer (structure.full) if that matters",
                *(one.name, load.what),
            )
            found += _halves(load.on(~known), model, one, forces.points, at_base)
        for force, place in found:
            forces.add_weighted(one.name, load.what, force, place)


# ---------------------------------------------------------------- ends with constants
def _at_ends(load: SideLoad, at: Coordinates, model: Model, one: SeamLayer, sides: Interface) -> Iterator[Piece]:
    """The load at straight free ends, handed to the faces along strips."""
    assert one.thin
    mesh, based = model.domain.mesh, one.name in model.joint.base_seams
    for end in straight_ends(load.rim, one.sheet):
        shares = np.zeros((len(model.joint.cells), 1, 5))
        upper = model.joint.surface_cells[one.sheet.facets, 1]
        constants = free_end(poisson_ratio(real_law(one.layer, one.structure.kinematics)))
        shares[upper, 0] = _shares(end, load.rim, one.sheet, model.kinematics, float(one.thin.eps), constants)
        known = sides.upper(cellwise(model.domain, ("DG", 0, (5,)), shares))
        m, offset = fem.Constant(mesh, end.m), fem.Constant(mesh, end.offset)
        place = at.moved(at.x + (offset - ufl.dot(m, at.x)) * m)
        yield place.traction(load.load, load.what, m), _handed(known, m, sides, based)


def _shares(
    end: StraightEnd, rim: Rim, sheet: Sheet, kinematics: Kinematics, eps: float, constants: FreeEnd
) -> FloatArray:
    """(n, 5) densities on facets: of eps times the load along m, n and the end; of what works in the opening and in shear.

    The first three make the whole force of the side, on any mesh.
    """
    x, strips = sheet.joint.points[sheet.vertices], Strips.of(constants)
    facet, count = np.searchsorted(sheet.facets, sheet.parts[0]), len(sheet.facets)
    area = np.bincount(facet, sheet.areas, count)
    factor = np.bincount(facet, sheet.areas * kinematics.factor_at(x.mean(axis=1)), count)
    ends = sheet.joint.points[rim.vertices].mean(axis=1)
    at_end = kinematics.factor_at(ends[end.has(ends)]).mean()
    here, distance = end.faces(x.mean(axis=1)) * sheet.areas, end.distance(x)

    def within(reach: float) -> FloatArray:
        return np.asarray(np.bincount(facet, share_within(distance, reach * eps) * here, count) / area)

    l_N, l_T = strips.opening.length, strips.shear.length
    handed = [within(reach) for reach in (strips.r_N, strips.r_T, 2 * ANTIPLANE)]
    forces = [eps * end.length * at_end * share / (share @ factor) for share in handed]
    drawn = constants.drawn_in / l_N * within(l_N), constants.c_T / l_T * within(l_T)
    return np.stack([*forces, *drawn], axis=1)


def _handed(shares: Expr, m: Expr, sides: Interface, based: bool) -> Weighted:
    """The place of a load, from its shares on S."""
    n = sides.n
    along_m, along_n, along_end, opening, shear = (shares[k] for k in range(5))

    def of_mean(v: Expr) -> Expr:
        parts = (along_m - along_end) * ufl.dot(m, v) * m + (along_n - along_end) * ufl.dot(n, v) * n
        return along_end * v + parts

    def of_jump(w: Expr) -> Expr:
        return opening * ufl.dot(n, w) * m + shear * ufl.dot(m, w) * n

    def moved(v: Expr) -> Expr:
        return of_mean((sides.upper(v) + sides.lower(v)) / 2) - of_jump(sides.jump(v))

    def on_base(v: Expr) -> Expr:
        return of_mean(sides.upper(v) / 2) + of_jump(sides.upper(v))

    return Weighted(sides.measure, sides.factor, sides.upper, moved, on_base if based else None)


# ---------------------------------------------------------------- other ends
def _halves(
    load: SideLoad, model: Model, one: SeamLayer, points: ConcentratedForms, at_base: AtBase
) -> Iterator[Piece]:
    """The load as forces on the rims of both faces, half of it on each; a rigid base takes its half by itself."""
    assert one.thin
    joint, based = model.domain.joint, one.name in model.joint.base_seams
    below, above = joint.surface_cells[one.sheet.parts[0][load.rim.simplex]].T
    faces = [_ridges(joint, cells, load.rim.vertices) for cells in (above, above if based else below)]
    places = joint.cell_points, joint.points[joint.cells] if based else joint.cell_points
    x, along = np.stack([face.in_space(joint, at) for face, at in zip(faces, places, strict=True)], axis=1)
    height = float(one.thin.eps) * one.sheet.mean_normal + 0 * x[0] if joint.parted is None else x[0] - x[1]
    weights = load.weights(_areas(height, along.mean(axis=0), load.rim.outward)) / 2
    faces = faces[:1] if based else faces
    nodes = Nodes(np.concatenate([face.cells for face in faces]), np.concatenate([face.points for face in faces]))
    weights = np.concatenate([model.kinematics.factor_at(at)[..., None] * weights for at in x[: len(faces)]])
    for at, g, measure in points.at_nodes(nodes, weights, load.varies):
        force, moved = load.at_points(at, g)

        def on_base(v: Expr, moved: Callable[[Expr], Expr] = moved) -> Expr:
            return moved(at_base(v))

        yield force, Weighted(measure, 1, mean=moved, on_base=on_base if based else None)


def _ridges(joint: Joint, cells: IntArray, vertices: IntArray) -> Nodes:
    """Ridges of S, given by vertices (n, d - 1), in cells (n,): the vertices in 2D, edges in 3D with two Gauss points."""
    kind = basix.CellType[joint.cell_type]
    corner = (joint.corners[cells][:, None] == vertices[..., None]).argmax(axis=2)
    if joint.dim == 3:
        return along_edges(kind, cells, corner, 2)
    return Nodes(cells, np.asarray(basix.geometry(kind))[corner])


def _areas(height: FloatArray, along: FloatArray, outward: FloatArray) -> FloatArray:
    """(n, k, d) area of a side at points of its edges times its outward normal.

    Args:
        height: (n, k, d) from the lower to the upper face.
        along: (n, k, d) lengths along the edges.
        outward: (n, d) directions to which the normals point.
    """
    across = np.stack([height[..., 1], -height[..., 0]], axis=-1) if height.shape[-1] == 2 else np.cross(height, along)
    sense = np.sign(np.einsum("nkd,nd->nk", across, outward))
    return np.asarray(sense[..., None] * across)
