"""Zoom: stresses inside layers that interface laws stand for, from the layers by themselves; corners of their free ends."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from forms.base import Array, InputError
from forms.ends.corner import CornerField
from forms.law import BulkLaw
from forms.temperature import finite_values
from geometry.refusals import place_text, require_known
from geometry.seam import S
from geometry.sheet import StraightEnd, straight_ends
from thinlayer.discretisation.full_model import FullModel, LayerModel
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import SeamLayer
from thinlayer.discretisation.side_loads import SideLoad
from thinlayer.discretisation.state import State
from thinlayer.errors import Violation, warn
from thinlayer.output.probe import Probe
from thinlayer.output.surface import Surface
from thinlayer.solving.layer_subproblem import DirichletLayers, LayerSubproblem
from thinlayer.surface.surface_mesh import SurfaceMesh

SINGLE_END_DISTANCE = (
    3.0  # distance of two ends, over the thickness, within which the field of one is not that of an end alone
)
END_CELL_SIZES = (1 / 16, 1 / 2)  # how far cells at ends reach, over the thickness, and tetrahedra
TRACTION_WARNING_ERROR = 0.3  # difference in traction of the layer and the bodies, in L2, from which on zooms warn
CORNER_EXCLUSION = 1 / 16  # distance from a corner, over the thickness, where stresses are not known
CORNER_ARC_RADIUS = 0.3  # over the thickness, of the arc around a corner from which its strength is taken
SUBLAYER_ARC_RADIUS = 0.6  # the same over the thickness of a thin sublayer


@dataclass(frozen=True)
class CornerStrength:
    """The singular stresses at the corner between a face and a free end, at places along the end.

    On the face at the distance r from the corner the traction across it is H r^(exponent - 1) in the limit r -> 0; the
    traction along S, away from the end, is `shear` times that. A criterion of crack initiation compares H with what a
    test of the same layer and exponent has found.

    Attributes:
        x: (n, d) places along the end, farther than 3 thicknesses from others; in 2D one.
        m: (d,) unit normal of the end, in S, outward.
        side: "lower" or "upper", of the face.
        exponent: lambda, from 1 at nu = 0 to 0.595 at nu = 0.5.
        shear: of the traction along S; on the upper face with the other sign.
        H: (n,), stress times length^(1 - exponent).
    """

    x: Array
    m: Array
    side: str
    exponent: float
    shear: float
    H: Array


class Zoom:
    """Stresses inside a layer of an interface model: the layer meshed by itself, its faces where the bodies move them.

    For all laws with an energy (linear ones, or plasticity in one step from rest), sublayers, curved seams, networks,
    layers with a weight or an eigenstrain. Cells are divided towards free ends and junctions. The error is that of the
    faces: for a layer of order 0 O(eps), of order 1 O(eps^2); with `Zoom(estimate(state).better)` the bodies have yielded
    to the layer and its ends. Of a model whose layer is meshed the stresses are those in its own cells.

    Args:
        state: of an interface model or of a full one, as `solve` returns it, or `history.at(t)`. Collective.
        seam: name of a seam; "S" of a joint that has one.
        cells_through: number of cells through the thickness.
        at_ends: how far cells at free ends and junctions reach at most, over the thickness, > 0. None: 1/16; of tetrahedra,
            of which there would be too many, 1/2.

    Attributes:
        layer: state of the layer by itself, for `Probe`, pictures and files, whole on every rank; of a full model this one.

    Raises:
        InputError: no such state or seam; a layer whose law has no energy, or remembers earlier steps.
        SolveError: the layer by itself is not found.
    """

    def __init__(self, state: State, seam: str = S, *, cells_through: int = 8, at_ends: float | None = None) -> None:
        self.state, self._one = state, _layer_of(state, seam)
        self.seam = self._one.name
        if at_ends is None:
            at_ends = END_CELL_SIZES[state.model.joint.cell_type == "tetrahedron"]
        self.layer = state if isinstance(state.model, FullModel) else self._by_itself(cells_through, at_ends)
        self._probe, self._surface = Probe(self.layer), SurfaceMesh(self.layer.model, self.seam)

    def _by_itself(self, cells_through: int, at_ends: float) -> State:
        """The layer, or layers that meet, meshed between the faces of the state."""
        state, model = self.state, self.state.model
        assert isinstance(model, InterfaceModel)
        layers = {}
        for name in [*model.layers] if model.joint.seams_meet else [self.seam]:
            what, thin = f"zoom into {model.layers[name]}: ", model.layers[name].thin_layer
            model.applicability[name].require("alone", what)
            if thin.law.traits.remembers and not state.sudden:
                raise InputError(f"{what}it remembers earlier steps; mesh it (structure.full)")
            layers[name] = replace(thin, order=0, edges=None)
        divided = LayerModel(model, layers, cells_through, at_ends)
        coarse = LayerSubproblem(model, layers, state.t, cells_through)
        w = coarse.equilibrate_dirichlet(coarse.at_faces(state.u.x.array))
        self._require_faces(coarse.state(w))
        fine = DirichletLayers(divided, state.t)
        return fine.state(fine.equilibrate_dirichlet(coarse.in_refined_cells(w, fine)))

    @property
    def eps(self) -> float:
        """The layer's thickness; where it varies the one that its profile multiplies."""
        return float(self._one.thin_layer.eps)

    @property
    def law(self) -> BulkLaw:
        """The layer's law with real parameters, in a plane that of its kinematics."""
        return self._known.law

    @cached_property
    def _known(self) -> Any:
        return self.state.model.applicability[self.seam]

    def _require_faces(self, layers: State) -> None:
        """Warn if the layer does not bear what the bodies do."""
        surface = Surface(self.state.model, self.seam)
        bodies = surface.reaction(self.state)
        off = surface.norm(surface.traction(layers) - bodies) / (surface.norm(bodies) or 1.0)
        if off > TRACTION_WARNING_ERROR:
            reason = f"it bears tractions that differ by {100 * off:.2g} % from what the bodies do"
            remedy = "take Zoom(estimate(state).better), whose bodies have yielded to it"
            warn("zoom", f"zoom into {self._one}: between these faces {reason}; {remedy}", surface.model.comm)

    # ---------------------------------------------------------------- stresses
    def stress(self, x: Any, height: Any = 0.0) -> Array:
        """Stresses (n, 3, 3) at places x (n, d) of S and heights, or (3, 3) at one place; between cells their mean.

        Args:
            x: places on S, in the mesh's coordinates.
            height: over the thickness, from -1/2 at the lower to 1/2 at the upper face, one or (n,).

        Raises:
            InputError: places off the seam; heights out of range; places at corners of free ends, in the last cell.
        """
        located, _ = self._surface.at(x)
        y = self._heights(height, len(located.x))
        free = self._known.free
        if len(free.vertices):
            near = free.distance(self.state.model.joint.points, located.x) < CORNER_EXCLUSION * self.eps
            near &= np.abs(y) > 0.5 - CORNER_EXCLUSION
            if near.any():
                corner = f"the corner at {place_text(located.x[near.argmax()])}, height {y[near.argmax()]:g}"
                why = "is nearer than cells can tell, and stresses are infinite there"
                raise InputError(f"{corner}, {why}; their exponents and strengths are in `corners`")
        stresses = self._probe.stress(self._surface.in_layer(located.x, y))
        return stresses if np.ndim(x) > 1 else stresses[0]

    def through(self, x: Any, n: int = 41) -> tuple[Array, Array]:
        """Heights (n,), from -1/2 to 1/2, and the stresses (n, 3, 3) there, at one place x (d,) of S."""
        heights = np.asarray(np.linspace(-0.5, 0.5, n), np.float64)
        return heights, self.stress(np.tile(np.asarray(x, float), (n, 1)), heights)

    def _heights(self, height: Any, n: int) -> Array:
        if (y := finite_values(height, (), (n,))) is None or not (np.abs(y) <= 0.5).all():
            allowed = f"one number or {n}, from -1/2 to 1/2 of the thickness"
            raise InputError(f"heights are {height!r:.80}; allowed: {allowed}")
        return np.broadcast_to(y, (n,))

    # ---------------------------------------------------------------- corners
    @cached_property
    def ends(self) -> list[tuple[StraightEnd, Array]]:
        """Each free end, and places (n, d) on it: vertices of S farther than 3 thicknesses from others; in 2D one.

        Raises:
            InputError: ends are curved.
        """
        free, points = self._known.free, self.state.model.joint.points
        ends, pairs = straight_ends(free, self._one.sheet), []
        every = points[np.unique(free.vertices)]
        for end in ends:
            others = [
                other.adjoins(every) & (other.distance(every) <= SINGLE_END_DISTANCE * self.eps) for other in ends
            ]
            x = every[end.has(every) & (np.sum(others, axis=0) == 1)]
            if len(x):
                pairs.append((end, x[np.argsort(x @ end.along)]))
        return pairs

    @cached_property
    def corners(self) -> list[CornerStrength]:
        """The singular stresses at the corners of straight free ends, two for each: on the lower and on the upper face.

        By reciprocity with the dual field on an arc around the corner, between rigid faces in plane strain.

        Raises:
            InputError: corners of which exponents are not known, with the reason.
        """
        for load in SideLoad.of(self.state.model, self._one):
            raise Violation("loaded side", f"the {load.what} acts on the layer's side").error(self._at_corners)
        self._known.require("corners", self._at_corners)
        return [self._strength(end, x, side) for end, x in self.ends for side in (-1, 1)]

    @property
    def _at_corners(self) -> str:
        return f"zoom into {self._one} at its corners: "

    def _strength(self, end: StraightEnd, x: Array, side: int) -> CornerStrength:
        """At the corners on the upper (1) or the lower face (-1)."""
        sublayers = self.law.sublayers
        share, law = sublayers[0 if side < 0 else -1]
        lmbda, mu = law.elastic_moduli()
        corner = CornerField(1 / (1 + mu / lmbda) / 2 if lmbda else 0.0)
        radius = CORNER_ARC_RADIUS if len(sublayers) == 1 else min(CORNER_ARC_RADIUS, SUBLAYER_ARC_RADIUS * share)
        r, axes = radius * self.eps, end.axes * np.array([[1.0], [-side]])  # inward, and into the layer
        at = np.vstack([corner.arc(radius), [[0.0, 0.0], [radius, 0.0]]])
        on_s = (x[:, None] - at[:, :1] * self.eps * end.m).reshape(-1, x.shape[1])
        places = self._surface.in_layer(on_s, np.tile(side * (0.5 - at[:, 1]), len(x)))
        u = (self._probe.displacement(places) @ axes[:, : x.shape[1]].T).reshape(len(x), -1, 2)
        stress = self._probe.stress(places).reshape(len(x), -1, 3, 3)
        in_axes = np.einsum("ai,nqij,bj->nqab", axes, stress, axes)[:, :-2]
        turn = (u[:, -1, 1] - u[:, -2, 1]) / r  # of the face, with its body
        u -= u[:, -2:-1] + turn[:, None, None] * self.eps * np.stack([-at[:, 1], at[:, 0]], axis=1)
        components = np.stack([in_axes[..., 0, 0], in_axes[..., 1, 1], in_axes[..., 0, 1]], axis=2)
        H = [corner.strength(r, mu * u_arc, two) for u_arc, two in zip(u[:, :-2], components, strict=True)]
        return CornerStrength(x, end.m, "upper" if side > 0 else "lower", corner.exponent, corner.shear, np.array(H))


def _layer_of(state: State, seam: str) -> SeamLayer:
    """The layer of a seam of a state of an interface model."""
    if not isinstance(state, State) or not isinstance(state.model, InterfaceModel | FullModel):
        received = state.model if isinstance(state, State) else state
        allowed = "a state of an interface or a full model, as solve returns it"
        raise InputError(f"a zoom takes {allowed}, not {received!r:.80}")
    model, names = state.model, [*state.model.joint.seams]
    name = names[0] if seam == S and len(names) == 1 else seam
    require_known("seam", name, names)
    if name not in model.layers:
        raise InputError(f"there is no layer on the seam {name!r}")
    return model.layers[name]
