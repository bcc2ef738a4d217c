"""Tractions on the side of a layer without cells, as forces of order eps on the layer's two faces.

The side is the layer's own boundary at an end of S; its height is the thickness eps. Per length of this end, a traction
t on the side does the work eps t . v, with the mean displacement v of the side. If the faces have the displacements
<u> -+ [u]/2, order 1 approximates v by <u>: each face gets half of the force.

At a free end the side has further displacements of the same size. They are -(c_N M/lmbda) [u_N] along the outward
normal m in S, and -c_T [u_m] along n. Here M is lmbda + 2 mu, and c_N, c_T and rho_N are constants of the end
(`forms.ends.constants.FreeEnd`). By reciprocity the displacements follow from the energy that the end takes away. The
force reaches the faces over lengths of the order of the thickness. Its mean distances from the end are rho_N eps (along
m), c_T eps (along n) and 7 zeta(3)/pi^3 eps (along the end, index tau). With the relative losses of stiffness a_N and
a_T near the end (`forms.ends.weights`) it does the work

    int_S { eps [t_m v_m f_N' + t_n v_n f_T' + t_tau v_tau f'] - a_N M/lmbda t_m [v_N] - a_T t_n [v_m] }

with v = <u>. For each component f' is 1/r within r of the end, where r is twice the mean distance, and else zero.
Without these terms the errors would be as large as the effects of loads on sides. `estimate(state).better` has the loads
on sides, too; on cells of S of two thicknesses its errors of traction and jump are 4 to 20 times as large.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import ufl
from dolfinx import fem

from forms.ends.constants import FreeEnd
from forms.tensors import Expr
from forms.work import Interface
from geometry.seam import FacetName
from geometry.sheet import Rim, StraightEnd, straight_ends
from geometry.topology import FloatArray, ridge_keys
from thinlayer.discretisation.coefficient import Coordinates, LoadInput, Pressure
from thinlayer.discretisation.forces import Forces, LoadRegion
from thinlayer.discretisation.layer import SeamLayer
from thinlayer.discretisation.mesh_functions import cellwise_function
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.sides import strip_shares
from thinlayer.errors import Violation

# 7 zeta(3)/pi^3: mean distance from the end, over the thickness, of the tractions that balance a load along the end
ANTIPLANE_LOAD_DISTANCE = 0.2713773
LoadPiece = tuple[Expr, LoadRegion]  # force, and the region where it acts


@dataclass(frozen=True)
class SideLoad:
    """A traction on the side of a layer whose interface law is of order 1.

    The side is the layer's own boundary at an end of S. It joins the two faces of the layer.

    Attributes:
        what: name of the load in error messages.
        load: the load as the user wrote it.
        rim: the ridges (vertices in 2D, edges in 3D) at which S ends on this side.
    """

    what: str
    load: LoadInput | Pressure
    rim: Rim

    @classmethod
    def loads_on_sides(cls, model: Model, layer: SeamLayer) -> Iterator[SideLoad]:
        """Yield the tractions, except zero ones, on a layer's lateral sides (at ends of S) in an interface model."""
        rim = layer.sheet.rim
        for name, load in sorted((model.structure.tractions or {}).items()):
            facet_set, value = FacetName.parse(name).continued_set, load.p if isinstance(load, Pressure) else load
            is_zero = not callable(value) and not np.any(np.asarray(value, float))
            if facet_set != name and not is_zero and (on_rim := rim.lies_on(model.joint.facets[facet_set])).any():
                yield cls(f"traction on {name!r}", load, rim[on_rim])


def add_side_loads(forces: Forces, model: Model, layer: SeamLayer, sides: Interface) -> None:
    """Add the tractions on the sides of a layer of order 1 to the forces of an interface model.

    Args:
        forces: the forces.
        model: the interface model.
        layer: the layer.
        sides: the two sides of S, for the layer's seam.

    Raises:
        InputError: it is not known how the layer transfers such a traction to its faces.
    """
    r = model.applicability[layer.name]
    loose_keys = ridge_keys(r.loose_rim.vertices)
    for load in SideLoad.loads_on_sides(model, layer):
        if layer.has_pressure_flow or r.weights is None or not np.isin(ridge_keys(load.rim.vertices), loose_keys).all():
            violation = None if layer.has_pressure_flow else r.why_not("ends")
            why = "a support holds the side" if not violation else violation.reason
            why = "its pressure of order 1 is zero at free ends" if layer.has_pressure_flow else why
            reason = f"the {load.what} acts on the side of {layer}, and how it reaches the faces is not known: {why}"
            raise Violation("loaded side", reason, "use order=0, which leaves it out, or mesh the layer").error()
        for force, region in _end_load(load, forces.at, model, layer, sides):
            forces.add_weighted_load(layer.name, load.what, force, region)


def _end_load(load: SideLoad, at: Coordinates, model: Model, layer: SeamLayer, sides: Interface) -> Iterator[LoadPiece]:
    """Yield a load on the layer's side at straight free ends as forces per area of S, each with its region.

    The regions transfer the forces to the layer's faces, over strips along the ends.

    Args:
        load: the load.
        at: place and time as arguments of the load.
        model: the interface model.
        layer: the layer.
        sides: the two sides of S, for the layer's seam.
    """
    mesh, on_base = model.domain.mesh, layer.name in model.joint.base_seams
    constants = model.applicability[layer.name].end_constants
    assert constants is not None  # weights were made of them
    for end in straight_ends(load.rim, layer.sheet):
        cell_factors = np.zeros((len(model.joint.cells), 1, 5))
        upper_cells = model.joint.surface_cells[layer.sheet.facets, 1]
        cell_factors[upper_cells, 0] = _transfer_factors(end, load.rim, layer, constants)
        facet_factors = sides.upper(cellwise_function(model.domain, ("DG", 0, (5,)), cell_factors))
        m, offset = fem.Constant(mesh, end.m), fem.Constant(mesh, end.offset)
        end_coordinates = at.with_place(at.x + (offset - ufl.dot(m, at.x)) * m)
        yield end_coordinates.load(load.load, load.what, len(m), m), _transfer_region(facet_factors, m, sides, on_base)


def _transfer_factors(end: StraightEnd, rim: Rim, layer: SeamLayer, constants: FreeEnd) -> FloatArray:
    """Return five factors (n, 5) on the n facets of S that distribute a traction on the side of a free end over S.

    The first three multiply the traction's components along m (outward in S), along n and along the end. The products
    are forces per area of S, which add up to the total force on the side on any mesh. The last two, times a jump, are
    displacements of the side: along -m for an opening, along -n for a shear.

    Args:
        end: the straight free end.
        rim: the loaded ridges.
        layer: the layer.
        constants: constants of the layer's free ends.
    """
    sheet, eps, kinematics = layer.sheet, layer.eps, layer.structure.kinematics
    points, share_of_strip = sheet.joint.points, partial(strip_shares, end, sheet)
    weighted_areas = sheet.facet_integrals(kinematics.factors_at(points[sheet.vertices].mean(axis=1)))
    midpoints = points[rim.vertices].mean(axis=1)
    end_factor = kinematics.factors_at(midpoints[end.contains(midpoints)]).mean()
    l_N, l_T = constants.opening_strip, constants.shear_strip
    mean_distances = constants.rho_N, constants.c_T, ANTIPLANE_LOAD_DISTANCE
    facet_fractions = [share_of_strip(2 * eps * distance) for distance in mean_distances]
    force_factors = [eps * end.length * end_factor * share / (share @ weighted_areas) for share in facet_fractions]
    opening_factor = constants.inward_displacement / l_N * share_of_strip(eps * l_N)
    shear_factor = constants.c_T / l_T * share_of_strip(eps * l_T)
    return np.stack([*force_factors, opening_factor, shear_factor], axis=1)


def _transfer_region(factors: Expr, m: Expr, sides: Interface, based: bool) -> LoadRegion:
    """Return the region on S in which a traction on the layer's side does its work on the layer's faces.

    Args:
        factors: (5,) factors from `_transfer_factors`, in UFL.
        m: (d,) outward normal of the end in S, in d dimensions.
        sides: the two sides of S, for the layer's seam.
        based: whether S stands on a rigid base.
    """
    n = sides.n
    along_m, along_n, along_end, opening, shear = (factors[k] for k in range(5))

    def mean_part(v: Expr) -> Expr:
        normal_part = (along_m - along_end) * ufl.dot(m, v) * m + (along_n - along_end) * ufl.dot(n, v) * n
        return along_end * v + normal_part

    def jump_part(w: Expr) -> Expr:
        return opening * ufl.dot(n, w) * m + shear * ufl.dot(m, w) * n

    def side_displacement(v: Expr) -> Expr:
        return mean_part((sides.upper(v) + sides.lower(v)) / 2) - jump_part(sides.jump(v))

    def base_displacement(v: Expr) -> Expr:
        return mean_part(sides.upper(v) / 2) + jump_part(sides.upper(v))

    return LoadRegion(sides.measure, sides.factor, sides.upper, side_displacement, base_displacement if based else None)
