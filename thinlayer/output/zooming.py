"""Zoom: stresses inside the layer of an interface model, and strengths of its stress singularities at free ends.

The stresses are computed on a mesh of the layer alone, whose faces have the displacements of the bodies.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from forms.base import Array, InputError
from forms.ends.corner import CornerField
from forms.kinematics import PLANE_STRAIN
from forms.law import BulkLaw
from forms.temperature import finite_values
from geometry.refusals import refuse, require_known
from geometry.seam import S
from geometry.sheet import StraightEnd, straight_ends
from thinlayer.discretisation.full_model import FullModel, LayerModel
from thinlayer.discretisation.interface_model import InterfaceModel, SideLoad
from thinlayer.discretisation.layer import SeamLayer
from thinlayer.discretisation.state import State
from thinlayer.errors import Violation, warn
from thinlayer.output.probe import Probe
from thinlayer.output.surface import Surface
from thinlayer.parts.inertia import Inertia
from thinlayer.solving.layer_subproblem import DirichletLayers, LayerSubproblem
from thinlayer.surface.surface_mesh import SurfaceMesh
from thinlayer.system.units import percent

# distance of two ends, over the thickness, within which the field of one end is disturbed by the other
SINGLE_END_DISTANCE = 3.0
END_CELL_SIZES = (1 / 16, 1 / 2)  # largest extent of cells at ends, over the thickness; of tetrahedra
MAX_TRACTION_DIFFERENCE = 0.3  # relative L2 difference of the tractions of layer and bodies above which zooms warn
CORNER_EXCLUSION = 1 / 16  # distance from a corner, over the thickness, within which stresses are unknown
ROUNDING_TOLERANCE = 1e-9  # difference of distances that counts as rounding, over the distance
CORNER_ARC_RADIUS = 0.3  # radius, over the thickness, of the arc around a corner on which its strength is computed
SUBLAYER_ARC_RADIUS = 0.6  # the same over the thickness of a thin sublayer


@dataclass(frozen=True)
class CornerStrength:
    """Strength of the singular stresses at a corner of a layer, where its lower or upper face meets its free end.

    At the distance r from the corner, the normal traction on the face tends to H r^(exponent - 1) as r -> 0. A
    criterion of crack initiation compares H with its critical value, from a test of the same layer and exponent.

    Attributes:
        x: (n, d) points of S along the end, in d dimensions, farther than 3 thicknesses from other ends; in 2D one
            point.
        m: (d,) unit normal of the end in the plane of S, which points out of the layer.
        side: "lower" or "upper", the face of the layer.
        exponent: exponent of the displacements, r^exponent; from 1 at Poisson's ratio 0 to 0.595 at 0.5.
        shear: ratio of tangential to normal traction on the lower face near the corner. Tangential traction is positive
            inward along S, against m. On the upper face the ratio is -shear.
        H: (n,) strengths at the points x, in units of stress times length^(1 - exponent).
    """

    x: Array
    m: Array
    side: str
    exponent: float
    shear: float
    H: Array


class Zoom:
    """Stresses inside a layer of an interface model, computed on a mesh of this layer alone.

    Of a scalar field such as a temperature, values and fluxes take the place of stresses.

    The displacements of the layer's lower and upper face are those of the bodies in the interface model. The layer's
    law must have an energy: a linear law, or plasticity in one step from rest. Sublayers, curved seams, seams that
    meet, weight and eigenstrains of the layer are possible. Cells are refined towards free ends and junctions.

    The relative error is that of the face displacements: O(eps) for an interface law of order 0, O(eps^2) for order 1.
    In `estimate(state).better` the bodies are in equilibrium with the meshed layer, including its free ends. So
    `Zoom(estimate(state).better)` prescribes more accurate face displacements than `Zoom(state)`.
    For a full model nothing is solved, and the stresses are those in its own layer cells. In a structure with `Inertia`
    the layer's mass moves with its faces, linearly between them. Collective.

    Args:
        state: state of an interface model or a full model, as `solve` or `history.at(t)` returns it.
        seam: name of the seam with the layer; "S" if the joint has only one seam.
        cells_through: number of cells through the thickness.
        at_ends: largest size of cells at free ends and junctions, as a fraction of the layer's thickness, > 0. None:
            1/16; for tetrahedra 1/2, to limit their number.

    Attributes:
        state: the argument.
        seam: name of the seam with the layer.
        layer: state on the mesh of the layer alone, for `Probe`, pictures and files; each rank has the whole mesh. For
            a full model it is the argument `state`.

    Raises:
        InputError: no such state or seam; the layer's law has no energy, or depends on earlier steps.
        SolveError: the problem of the layer has no solution, or Newton's method does not converge.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, Zoom, solve
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> zoom = Zoom(solve(plates.interface(ThinLayer(glue, eps=0.05))))
        >>> print(zoom.stress((2, 0)).round(1))
        [[ -6.7   3.2   0. ]
         [  3.2 -10.    0. ]
         [  0.    0.   -6.7]]
    """

    def __init__(self, state: State, seam: str = S, *, cells_through: int = 8, at_ends: float | None = None) -> None:
        self.state, self._seam_layer = state, _layer_of(state, seam)
        self.seam = self._seam_layer.name
        self._applicability = state.model.applicability[self.seam]
        if at_ends is None:
            at_ends = END_CELL_SIZES[state.model.joint.cell_type == "tetrahedron"]
        self.layer = state if isinstance(state.model, FullModel) else self._solve_layer_alone(cells_through, at_ends)
        self._probe, self._surface = Probe(self.layer), SurfaceMesh(self.layer.model, self.seam)

    def _solve_layer_alone(self, cells_through: int, at_ends: float) -> State:
        """Solve for the layer alone under the state's face displacements; return its state on a refined mesh.

        If other layers meet this layer, they are on the mesh too. A coarse mesh is solved first; its solution starts
        Newton's method on the refined mesh.

        Args:
            cells_through: number of cells through the thickness.
            at_ends: largest size of cells at free ends and junctions, divided by the layer's thickness.
        """
        state, model = self.state, self.state.model
        assert isinstance(model, InterfaceModel)
        layers = {}
        for name in [*model.layers] if model.joint.seams_meet else [self.seam]:
            prefix = f"zoom into {model.layers[name]}: "
            model.applicability[name].require("alone", prefix)
            thin_layer = model.layers[name].as_thin_layer
            if thin_layer.law.traits.remembers and not state.sudden:
                raise InputError(f"{prefix}it remembers earlier steps; mesh it (structure.full)")
            layers[name] = replace(thin_layer, order=0, edges=None)
        refined_model = LayerModel(model, layers, cells_through, at_ends)
        coarse_problem = LayerSubproblem(model, layers, state.t, cells_through)
        fine_problem = DirichletLayers(refined_model, state.t)
        for mass in [part for part in model.parts if isinstance(part, Inertia) and part.key in state.memory]:
            accelerations = coarse_problem.to_layers(state.memory[mass.key]["a"].x.array)
            if accelerations.any():
                a = coarse_problem.dirichlet_displacements(accelerations, 0 * accelerations, 0 * accelerations)
                fine_problem.add_inertia(mass, coarse_problem.interpolate_to_refined(a, fine_problem))
                coarse_problem.add_inertia(mass, a)
        w = coarse_problem.equilibrate_dirichlet(coarse_problem.to_layers(state.u.x.array))
        self._warn_of_tractions(coarse_problem.state(w))
        fine_w = coarse_problem.interpolate_to_refined(w, fine_problem)
        return fine_problem.state(fine_problem.equilibrate_dirichlet(fine_w))

    @property
    def eps(self) -> float:
        """Thickness of the layer, a length; a variable thickness is this number times the layer's profile."""
        return self._seam_layer.eps

    @property
    def law(self) -> BulkLaw:
        """The law of stress and strain of the layer's material; in plane stress the law of strains in the plane."""
        return self._applicability.law

    def _warn_of_tractions(self, layer_state: State) -> None:
        """Warn if the tractions of the layer on S differ too much from those of the bodies' nodal forces.

        The face displacements are then inaccurate. Too much means that the L2 norm of the difference over S exceeds 0.3
        times that of the bodies' tractions.

        Args:
            layer_state: state of the meshed layer alone.
        """
        surface = Surface(self.state.model, self.seam)
        body_traction = surface.reaction(self.state)
        error = surface.norm(surface.traction(layer_state) - body_traction) / (surface.norm(body_traction) or 1.0)
        if error > MAX_TRACTION_DIFFERENCE:
            name = self.state.model.kinematics.quantities.traction
            message = f"zoom into {self._seam_layer}: {name}s differ by {percent(error)} from those of the bodies"
            warn("zoom", f"{message}; take Zoom(estimate(state).better), where they agree", surface.model.comm)

    # ---------------------------------------------------------------- stresses
    def stress(self, x: npt.ArrayLike, height: npt.ArrayLike = 0.0) -> Array:
        """Return the stresses (n, 3, 3) at n points inside the layer, or (3, 3) at one point. Collective.

        On a boundary between cells the stress is the mean over these cells.

        Args:
            x: (n, d) points on S in d dimensions, or one point (d,), in coordinates of the joint's mesh.
            height: distance from the middle of the layer along n, divided by its thickness, from -1/2 at the lower face
                to 1/2 at the upper face. One number, or (n,).

        Raises:
            InputError: points off the seam; heights out of range; points within 1/16 of the thickness from a corner of
                a free end, where stresses are infinite.
        """
        points, y = self._inside(x, height)
        free_rim = self._applicability.free_rim
        if len(free_rim.vertices):
            distances = free_rim.distance(self.state.model.joint.points, points)
            is_near_corner = distances < (1 - ROUNDING_TOLERANCE) * CORNER_EXCLUSION * self.eps
            is_near_corner &= np.abs(y) > 0.5 - CORNER_EXCLUSION
            reason = f"height {y[is_near_corner.argmax()]:g} is too near a corner, where stresses are infinite"
            refuse(is_near_corner, points, f"{{at}}, {reason}; `corners` has their strengths")
        stresses = self._probe.stress(self._surface.in_layer(points, y))
        return stresses if np.ndim(x) > 1 else stresses[0]

    def value(self, x: npt.ArrayLike, height: npt.ArrayLike = 0.0) -> Array:
        """Return the values (n,) of a scalar field inside the layer, or one value; arguments as of `stress`. Collective."""
        values = self._probe.value(self._surface.in_layer(*self._inside(x, height)))
        return values if np.ndim(x) > 1 else values[0]

    def flux(self, x: npt.ArrayLike, height: npt.ArrayLike = 0.0) -> Array:
        """Return the fluxes (n, 3) of a scalar field inside the layer, or (3,); arguments as of `stress`. Collective."""
        fluxes = self._probe.flux(self._surface.in_layer(*self._inside(x, height)))
        return fluxes if np.ndim(x) > 1 else fluxes[0]

    def _inside(self, x: npt.ArrayLike, height: npt.ArrayLike) -> tuple[Array, Array]:
        """Return points (n, d) of the seam, and the heights (n,) above it, after checking both."""
        located, _ = self._surface.at(x)
        if (y := finite_values(height, (), located.x.shape[:1])) is None or not (np.abs(y) <= 0.5).all():
            allowed = f"one number or {len(located.x)}, from -1/2 to 1/2 of the thickness"
            raise InputError(f"height is {height!r:.80}; allowed: {allowed}")
        return located.x, np.asarray(np.broadcast_to(y, located.x.shape[:1]))

    def through(self, x: npt.ArrayLike, n: int = 41) -> tuple[Array, Array]:
        """Return the stresses, or the values of a scalar field, through the thickness at one point of S. Collective.

        Args:
            x: (d,) the point, in d dimensions.
            n: number of heights.

        Returns:
            (n,) heights from -1/2 to 1/2, as in `stress`, and the stresses (n, 3, 3) or values (n,) there.
        """
        heights = np.asarray(np.linspace(-0.5, 0.5, n), np.float64)
        at_heights = self.value if self.state.model.n_components == 1 else self.stress
        return heights, at_heights(np.tile(np.asarray(x, float), (n, 1)), heights)

    # ---------------------------------------------------------------- corners
    @cached_property
    def ends(self) -> list[tuple[StraightEnd, Array]]:
        """Straight free ends of the layer, each with some points (n, d) of S along it; in 2D one point.

        The points are the mesh vertices of the end that are farther than 3 thicknesses from other free ends. Ends
        without such vertices are left out.

        Raises:
            InputError: ends are curved.
        """
        free_rim, points = self._applicability.free_rim, self.state.model.joint.points
        ends, ends_and_points = straight_ends(free_rim, self._seam_layer.sheet), []
        rim_x = points[np.unique(free_rim.vertices)]
        within = SINGLE_END_DISTANCE * self.eps
        is_close = [end.contains(rim_x) | (end.is_in_front(rim_x) & (end.distance(rim_x) <= within)) for end in ends]
        for end in ends:
            x = rim_x[end.contains(rim_x) & (np.sum(is_close, axis=0) == 1)]
            if len(x):
                ends_and_points.append((end, x[np.argsort(x @ end.along)]))
        return ends_and_points

    @cached_property
    def corners(self) -> list[CornerStrength]:
        """Strengths of the singular stresses at both corners of each straight free end, ordered as `ends`. Collective.

        Of each end the corner at the lower face comes first. The strengths follow from the reciprocal theorem with the
        dual singular field, on an arc around the corner. The singular fields are those between a rigid face and a free
        end in plane strain.

        Raises:
            InputError: the exponent of a corner is unknown, or a load acts on the layer's side.
        """
        prefix = f"zoom into {self._seam_layer} at its corners: "
        self.state.model.kinematics.require(PLANE_STRAIN.unknown, f"{prefix}a strength")
        for load in SideLoad.loads_on_sides(self.state.model, self._seam_layer):
            raise Violation("loaded side", f"the {load.what} acts on the layer's side").error(prefix)
        self._applicability.require("corners", prefix)
        return [self._corner_strength(end, x, side) for end, x in self.ends for side in (-1, 1)]

    def _corner_strength(self, end: StraightEnd, x: Array, side: int) -> CornerStrength:
        """Compute the strengths of the singular stresses along one corner of a free end.

        Args:
            end: the free end.
            x: (n, d) points of S along it, at which strengths are computed.
            side: 1 for the corner at the upper face, -1 at the lower face.
        """
        sublayers = self.law.sublayers
        fraction, law = sublayers[0 if side < 0 else -1]
        lmbda, mu = law.elastic_moduli()
        corner = CornerField(1 / (1 + mu / lmbda) / 2 if lmbda else 0.0)
        arc_ratio = CORNER_ARC_RADIUS if len(sublayers) == 1 else min(CORNER_ARC_RADIUS, SUBLAYER_ARC_RADIUS * fraction)
        r, axes = arc_ratio * self.eps, end.axes * np.array([[1.0], [-side]])  # inward, and into the layer
        arc_points = np.vstack([corner.arc_points(arc_ratio), [[0.0, 0.0], [arc_ratio, 0.0]]])
        surface_points = (x[:, None] - arc_points[:, :1] * self.eps * end.m).reshape(-1, x.shape[1])
        points = self._surface.in_layer(surface_points, np.tile(side * (0.5 - arc_points[:, 1]), len(x)))
        u = (self._probe.displacement(points) @ axes[:, : x.shape[1]].T).reshape(len(x), -1, 2)
        stress = self._probe.stress(points).reshape(len(x), -1, 3, 3)
        local_stress = np.einsum("ai,nqij,bj->nqab", axes, stress, axes)[:, :-2]
        rotation = (u[:, -1, 1] - u[:, -2, 1]) / r  # rotation of the face
        u -= u[:, -2:-1] + rotation[:, None, None] * self.eps * np.stack([-arc_points[:, 1], arc_points[:, 0]], axis=1)
        arc_stress = np.stack([local_stress[..., 0, 0], local_stress[..., 1, 1], local_stress[..., 0, 1]], axis=2)
        H = [corner.intensity(r, mu * u_arc, s_arc) for u_arc, s_arc in zip(u[:, :-2], arc_stress, strict=True)]
        return CornerStrength(x, end.m, "upper" if side > 0 else "lower", corner.exponent, corner.t_ratio, np.array(H))


def _layer_of(state: State, seam: str) -> SeamLayer:
    """Return the layer on a seam in a state's model.

    Args:
        state: state of a full or an interface model.
        seam: name of the seam; "S" if there is only one.

    Raises:
        InputError: not such a state; an unknown seam, or a seam without a layer.
    """
    if not isinstance(state, State) or not isinstance(state.model, InterfaceModel | FullModel):
        received = state.model if isinstance(state, State) else state
        raise InputError(f"a zoom is of a state of an interface or a full model, not of {received!r:.80}")
    model, names = state.model, [*state.model.joint.seams]
    name = names[0] if seam == S and len(names) == 1 else seam
    require_known("seam", name, names)
    if name not in model.layers:
        raise InputError(f"the seam {name!r} has no layer; seams with layers: {', '.join(model.layers) or 'none'}")
    return model.layers[name]
