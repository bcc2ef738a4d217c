"""Probe: displacements, stresses and internal variables of a state at arbitrary points and at quadrature points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from scipy.spatial import cKDTree

from forms.base import Array, InputError, require
from forms.kinematics import PLANE_STRAIN, ScalarField
from forms.tensors import scalar_gradients
from geometry.refusals import place_text, refuse
from geometry.seam import S
from geometry.topology import IntArray, is_tensor, place_order
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.key import Key
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State, node_values
from thinlayer.surface.law_points import LawPoints, law_points
from thinlayer.surface.locating import LocatedPoints
from thinlayer.surface.surface_mesh import SurfaceMesh
from thinlayer.system.ranks import errors_on_all, require_same

# difference of displacements at one point, over the largest displacement, that counts as zero
ZERO_JUMP_TOLERANCE = 1e-9


@dataclass(frozen=True)
class PointValues:
    """Values of one internal variable at the n quadrature points of one law, the same on all ranks.

    Attributes:
        key: name of the law by its place, such as "layer" or "body STONE" (see `Probe.names`).
        x: (n, d) coordinates in d dimensions, ordered by cell or facet, then by position.
        values: (n, ...) values at these points; tensors are (n, 3, 3).
        weights: (n,) quadrature weights; the sum of weights times values is the integral of the variable over the
            volume. At points on S they are areas times the thickness of the layer or sublayer, at order 1 half of it;
            for laws of jumps, areas.
        entity: (n,) number of the cell of each point in the joint. At points on S it is the row of the facet in the
            joint's `table` of facets.
    """

    key: str
    x: Array
    values: Array
    weights: Array
    entity: IntArray


class Probe:
    """Displacements, stresses and internal variables of a state at points of bodies, meshed layers and S.

    Of a scalar field such as a temperature, they are values and fluxes. Coordinates x are those of the undeformed mesh
    of the model; in a full model this mesh contains the layer. Methods are collective: all ranks must give the same
    arguments, and get the same results.

    Args:
        state: a state, as `solve` or `history.at(t)` returns it.

    Raises:
        InputError: not a state.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Probe, Structure, ThinLayer, solve
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> probe = Probe(solve(plates.interface(ThinLayer(glue, eps=0.05))))
        >>> print(probe.displacement((1, 0), side="upper").shape)
        (2,)
        >>> print(probe.stress((1, 1.5)).round(1))
        [[-1.2  3.7  0. ]
         [ 3.7 -9.6  0. ]
         [ 0.   0.  -3.2]]
    """

    def __init__(self, state: State) -> None:
        require(isinstance(state, State), "state", state, "give a state, as solve returns it, or history.at(t)")
        self.state, self._joint, self._comm = state, state.model.domain.joint, state.model.comm

    # ---------------------------------------------------------------- at points in bodies and meshed layers
    def displacement(self, x: npt.ArrayLike, *, side: str | None = None, seam: str = S) -> Array:
        """Return the displacements (n, d) at n points in d dimensions, or (d,) at one point.

        Args:
            x: (n, d) coordinates, or (d,) for one point.
            side: only for interface models: "lower" or "upper", the side of S that moves with the displacement at
                points on S. None: displacements jump at none of the points.
            seam: name of the seam to which `side` refers, for points where several seams meet; "S": all seams.

        Raises:
            InputError: points outside the bodies and meshed layers; `side` is None at a point where displacements jump.
        """
        self.state.model.kinematics.require(PLANE_STRAIN.unknown, "displacement", "value")
        return self._unknown(x, side, seam)

    def value(self, x: npt.ArrayLike, *, side: str | None = None, seam: str = S) -> Array:
        """Return the values (n,) of a scalar field at n points, or one value; arguments as of `displacement`.

        In a cell under a mean gradient they are those of its periodic part.
        """
        self.state.model.kinematics.require(ScalarField.unknown, "value", "displacement")
        return self._unknown(x, side, seam)[..., 0]

    def flux(self, x: npt.ArrayLike, *, side: str | None = None, seam: str = S) -> Array:
        """Return the fluxes (n, 3) of a scalar field at n points, or (3,) at one; arguments and accuracy as of `stress`."""
        self.state.model.kinematics.require(ScalarField.unknown, "flux", "stress")
        stresses = self._stress(x, side, seam)
        return scalar_gradients(stresses) if np.ndim(x) > 1 else scalar_gradients(stresses[None])[0]

    def _unknown(self, x: npt.ArrayLike, side: str | None, seam: str) -> Array:
        u = displacements_at(self.state.u, self.state.model, self._locate(x, side, seam), side)
        return u if np.ndim(x) > 1 else u[0]

    def stress(self, x: npt.ArrayLike, *, side: str | None = None, seam: str = S) -> Array:
        """Return the stresses (n, 3, 3) at n points in d dimensions, or (3, 3) at one point.

        In each cell a polynomial is fitted by least squares to the stresses at the quadrature points. Its total degree
        is one less than the degree of the displacements, on quadrilaterals and hexahedra equal to it. At a point in
        several cells the stress is the mean over these cells.

        Args:
            x: (n, d) coordinates, or (d,) for one point.
            side: only for interface models: "lower" or "upper", the side of S to whose cells the mean is limited at
                points on S. None: the mean is over all cells.
            seam: name of the seam to which `side` refers, for points where several seams meet; "S": all seams.

        Raises:
            InputError: points outside the bodies and meshed layers; an unknown side or seam.
        """
        self.state.model.kinematics.require(PLANE_STRAIN.unknown, "stress", "flux")
        return self._stress(x, side, seam)

    def _stress(self, x: npt.ArrayLike, side: str | None, seam: str) -> Array:
        located = self._locate(x, side, seam)
        pair_stresses = np.zeros((len(located.entity), 9))
        for points in law_points(self.state):
            if points.quadrature.region.dim == self._joint.dim:
                pair_stresses += self._fit_and_evaluate(points, points.stress().reshape(-1, 9), located)
        pair_stresses = self._comm.allreduce(pair_stresses)
        means = located.point_means(pair_stresses).reshape(-1, 3, 3)
        return means if np.ndim(x) > 1 else means[0]

    def _locate(self, x: npt.ArrayLike, side: str | None = None, seam: str = S, on_s: bool = False) -> LocatedPoints:
        """Find the cells, or the facets of S, that contain points; all ranks get the same result or error. Collective.

        Args:
            x: (n, d) coordinates, or (d,) for one point.
            side: "lower" or "upper": at points on S find only cells on this side; None: all cells. Not for facets.
            seam: name of the seam to which `side` refers; "S": all seams.
            on_s: True: find facets of S that contain the points; False: find cells.

        Returns:
            Pairs of a point and a cell, or facet, that contains it.
        """
        model = self.state.model
        with errors_on_all(self._comm):
            located = SurfaceMesh(model).at(x)[0] if on_s else cells_at(model, x, side, seam)
        require_same(self._comm, places=located.x, side=side, seam=seam)
        return located

    def _fit_and_evaluate(self, points: LawPoints, values: Array, located: LocatedPoints) -> Array:
        """Fit a polynomial in each cell to values at the quadrature points of a law, and evaluate it at given points.

        Args:
            points: quadrature points of the law.
            values: (points, k) values of k quantities there.
            located: pairs of a given point and a cell that contains it, m in number.

        Returns:
            (m, k) values of the polynomials; zero for cells that other ranks own or where other laws act.
        """
        fitted_values = np.zeros((len(located.entity), values.shape[1]))
        row_of_cell = {int(entity): row for row, entity in enumerate(points.quadrature.entity_numbers)}
        degree = self.state.model.structure.degree - (not is_tensor(self._joint.cell_type))
        for pair in np.flatnonzero(np.isin(located.entity, points.quadrature.entity_numbers)):
            cell = int(located.entity[pair])
            cell_points = points.quadrature.cells[row_of_cell[cell]]
            x = points.quadrature.x[cell_points]
            centre, cell_size = x.mean(axis=0), np.ptp(self._joint.points[self._joint.cells[cell]], axis=0).max()
            monomials = _evaluate_monomials((x - centre) / cell_size, degree)
            pair_monomials = _evaluate_monomials((located.x[located.point[pair]] - centre)[None] / cell_size, degree)
            fitted_values[pair] = pair_monomials @ np.linalg.lstsq(monomials, values[cell_points], rcond=None)[0]
        return fitted_values

    # ---------------------------------------------------------------- internal variables
    @cached_property
    def _variables(self) -> dict[str, dict[str, tuple[LawPoints, float, Array]]]:
        """Key of a law -> name of a variable -> points, fraction of their weights that the sublayer has, and values."""
        by_key: dict[str, dict[str, tuple[LawPoints, float, Array]]] = {}
        for points in law_points(self.state):
            sublayers = points.term.law.sublayers
            for k, ((fraction, _), variables) in enumerate(zip(sublayers, points.internal(), strict=True), 1):
                key = str(Key.parse(points.key).numbered(k)) if len(sublayers) > 1 else points.key
                if variables:
                    by_key[key] = {name: (points, fraction, values) for name, values in variables.items()}
        return by_key

    @property
    def names(self) -> dict[str, list[str]]:
        """Names of the internal variables of each law, by the law's key; laws without internal variables are left out.

        The key is "layer", "layer BED" for the layer on the seam BED, or "body STONE" for the region STONE, as in
        `State.memory`. Sublayers have keys of their own, numbered from the lower to the upper face: "layer 1", "layer
        BED/1". So have the two points through the thickness of an interface law of order 1.
        """
        return {key: list(variables) for key, variables in self._variables.items()}

    def points(self, name: str, key: str | None = None) -> PointValues:
        """Return an internal variable at all quadrature points of one law, in a body, a meshed layer or on S.

        Args:
            name: name of the variable, one of those in `names`.
            key: key of the law in `names`, such as "layer"; None: the only law that has this variable.

        Raises:
            InputError: no such variable; several laws have it, and `key` is None.
        """
        key = self._find_key(name, key)
        points, fraction, values = self._variables[key][name]
        quadrature = points.quadrature
        entity = np.empty(quadrature.count, np.int64)
        entity[quadrature.cells] = points.quadrature.entity_numbers[:, None]
        owned = (entity, quadrature.x, fraction * quadrature.weights, values)
        entity, x, weights, values = (np.concatenate(parts) for parts in zip(*self._comm.allgather(owned), strict=True))
        permutation = np.lexsort([np.argsort(place_order(x, self._joint.size)), entity])
        return PointValues(key, x[permutation], values[permutation], weights[permutation], entity[permutation])

    def internal(self, name: str, x: npt.ArrayLike, key: str | None = None) -> Array:
        """Return the value of an internal variable at the quadrature point nearest to each of n points.

        The search is limited to the cells that contain the point, for a law on S to such facets. Nothing is
        interpolated.

        Args:
            name: name of the variable, one of those in `names`.
            x: (n, d) coordinates in d dimensions, or (d,) for one point; for an interface law, points on its seam.
            key: key of the law in `names`, such as "layer"; None: the only law that has this variable.

        Returns:
            (n,) values, for tensors (n, 3, 3); without the first axis if x is one point (d,).

        Raises:
            InputError: no such variable; several laws have it, and `key` is None; points where the law does not act.
        """
        points = self.points(name, key)
        is_on_s = self._variables[points.key][name][0].quadrature.region.dim < self._joint.dim
        located = self._locate(x, on_s=is_on_s)
        entity = self._joint.surface_rows[located.entity] if is_on_s else located.entity
        nearest_values = np.empty((len(located.x), *points.values.shape[1:]))
        for k, point in enumerate(located.x):
            candidates = np.flatnonzero(np.isin(points.entity, entity[located.point == k]))
            if not len(candidates):
                raise InputError(f"the law {points.key!r} does not act at {place_text(point)}")
            nearest_values[k] = points.values[candidates[cKDTree(points.x[candidates]).query(point)[1]]]
        return nearest_values if np.ndim(x) > 1 else nearest_values[0]

    def _find_key(self, name: str, key: str | None) -> str:
        """Return the key of the law that has the internal variable `name`; if `key` is given, check it and return it.

        Raises:
            InputError: no law has the variable; the law with this key does not; several laws have it, and `key` is
                None.
        """
        keys = [law_key for law_key, variables in self._variables.items() if name in variables]
        if not keys or key not in (None, *keys):
            names_of_laws = (f"{law_key}: {', '.join(names)}" for law_key, names in self.names.items())
            all_names = "; ".join(names_of_laws) or "none, as no law has any"
            of_law = "" if key is None else f" of the law {key!r}"
            raise InputError(f"unknown internal variable {name!r}{of_law}; known: {all_names}")
        if key is None and len(keys) > 1:
            raise InputError(f"several laws have an internal variable {name!r}; give key=, one of {', '.join(keys)}")
        return key or keys[0]


def displacements_at(u: fem.Function, model: Model, located: LocatedPoints, side: str | None) -> Array:
    """Return displacements (n, d) at n points in d dimensions. Collective.

    Args:
        u: the displacements, in the model's space.
        model: the model.
        located: the points, with the cells that contain them.
        side: "lower" or "upper" if the cells are on this side of S; None: they are all cells that contain the points.

    Raises:
        InputError: displacements jump at a point.
    """
    basis = u.function_space.ufl_element().basix_element.tabulate(0, located.X)[0, :, :, 0]
    values = np.einsum("kn,knd->kd", basis, node_values(u, model, located.entity))
    largest_u = model.comm.allreduce(float(np.abs(u.x.array).max(initial=0.0)), max)
    first_pairs = np.searchsorted(located.point, np.arange(len(located.x)))
    is_jump = np.abs(values - values[first_pairs[located.point]]).max(axis=1) > ZERO_JUMP_TOLERANCE * largest_u
    hint = "several bodies meet there; give side= and seam=" if side else "give side="
    refuse(is_jump, located.x[located.point], f"{model.kinematics.unknown}s jump at {{at}}: {hint}")
    return np.asarray(values[first_pairs])


def cells_at(model: Model, x: npt.ArrayLike, side: str | None = None, seam: str = S) -> LocatedPoints:
    """Find the cells of a model that contain points.

    Args:
        model: the model.
        x: (n, d) coordinates in d dimensions, or (d,) for one point.
        side: "lower" or "upper": at points on S find only cells on this side, in an interface model; None: all cells.
        seam: name of the seam to which `side` refers; "S": all seams.

    Returns:
        Pairs of a point and a cell that contains it.

    Raises:
        InputError: no points; points outside the cells; an unknown side or seam; a side where S lies on a rigid base,
            which has no cells; a side although the model is no interface model.
    """
    located = LocatedPoints.in_cells(model.domain.joint, x)
    if side is None:
        return located
    if not isinstance(model, InterfaceModel):
        raise InputError(f"side is {side!r}; it is for places on S of an interface model, not of {model!r}")
    return SurfaceMesh(model, seam).on_side(located, side)


def _evaluate_monomials(x: Array, degree: int) -> Array:
    """Return the values (n, k) at n points `x` (n, d) of the k monomials whose total degree is at most `degree`."""
    factor_axes = [k for n in range(degree + 1) for k in combinations_with_replacement(range(x.shape[1]), n)]
    return np.column_stack([x[:, k].prod(axis=1) for k in factor_axes])
