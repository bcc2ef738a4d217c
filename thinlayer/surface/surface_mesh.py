"""S as a separate mesh, with fields on S as arrays: integrals, projections, lines, values on both sides."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any
from weakref import proxy

import basix
import numpy as np
import numpy.typing as npt
import scipy.sparse
import scipy.sparse.linalg
from dolfinx import fem

from forms.base import Array, InputError, require
from geometry.refusals import refuse, require_known
from geometry.seam import S
from geometry.sheet import Rim, Sheet
from geometry.topology import (
    FACET_TYPES,
    BoolArray,
    IntArray,
    curve_order,
    lagrange,
    normal_vectors,
    place_order,
    sum_by_number,
)
from thinlayer.discretisation.contact_nodes import normal_frames
from thinlayer.discretisation.full_model import FullModel
from thinlayer.discretisation.layer import SeamLayer
from thinlayer.discretisation.mesh_functions import band_of
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State, node_values
from thinlayer.surface.lines import Line, Plane, lines_on
from thinlayer.surface.locating import EXTENDED_BODIES_HINT, LocatedPoints
from thinlayer.surface.surface_function import SurfaceFunction

Where = Array | BoolArray | Callable[[Array], object]
SIDE_NAMES = ("lower", "upper")


class FacetPoints:
    """Points on facets of a `SurfaceMesh`, q on each of n facets, with shape functions, normals and weights there.

    d is the number of dimensions, k the number of corners of a facet.

    Args:
        surface: the surface.
        rows: (n,) positions of the facets among those of the surface.
        points: coordinates in the reference facet, (q, d - 1) for all facets or (n, q, d - 1).
        weights: (q,) quadrature weights in the reference facet; 1 if the points are no quadrature rule.

    Attributes:
        rows, points: the arguments.
        shapes: (n, q, k) values, at the points, of the degree-1 shape functions of the facets' corners.
        x, n: (d, n, q) coordinates, and unit normals from the lower to the upper side.
        weights: (n, q) weights of integrals over S; in axisymmetry over the whole revolution.
    """

    def __init__(self, surface: SurfaceMesh, rows: IntArray, points: Array, weights: Array | float = 1.0) -> None:
        joint, nodes, count = surface.joint, surface.faces.mean(axis=0)[rows], len(rows)
        linear_table = tabulated(lagrange(surface.kind, 1), points, count, 1)
        table = tabulated(lagrange(surface.kind, joint.degree), points, count, 1)
        self.rows, self.points, self.shapes, self._reference_gradients = rows, points, linear_table[0], linear_table[1:]
        self.x = np.moveaxis(table[0] @ nodes, -1, 0)
        self._tangent_vectors = tangents = table[1:] @ nodes
        normals = normal_vectors(tangents)
        area_factors = np.linalg.norm(normals, axis=-1)
        upward = np.einsum("fqd,fd->fq", normals, joint.interface_normals[surface.rows[rows]])
        self.n = np.moveaxis(normals * (np.sign(upward) / area_factors)[..., None], -1, 0)
        self.weights = weights * area_factors * surface.model.kinematics.factors_at(np.moveaxis(self.x, 0, -1))

    @cached_property
    def shape_gradients(self) -> Array:
        """Gradients (n, q, k, d) along S of the degree-1 shape functions of the k corners, at q points of n facets."""
        inverse_tangents = np.linalg.pinv(np.moveaxis(self._tangent_vectors, 0, -1))
        return np.asarray(np.einsum("jfqa,fqjd->fqad", self._reference_gradients, inverse_tangents))


def tabulated(element: basix.finite_element.FiniteElement, points: Array, count: int, derivatives: int = 0) -> Array:
    """Return the values (1, n, q, a) of the basis functions of an element at q points in each of n cells or facets.

    a is the number of basis functions. With one derivative the result is (1 + t, n, q, a): the values, then the
    derivatives by the t reference coordinates.

    Args:
        element: the element.
        points: reference coordinates, (q, t) for all cells or facets or (n, q, t).
        count: the number n of cells or facets.
        derivatives: 0 or 1.
    """
    table = element.tabulate(derivatives, points.reshape(-1, points.shape[-1]))[..., 0]
    table = table.reshape(len(table), *points.shape[:-1], -1)
    return np.broadcast_to(table if points.ndim == 3 else table[:, None], (len(table), count, *table.shape[-2:]))


class SurfaceMesh:
    """The interface S of a joint, or one of its seams, as a separate mesh that is whole on every rank.

    A seam is a named part of S with its own layer. A scalar field is an array (n, q), with a value at each of q
    quadrature points of each of n facets. A vector field is (d, n, q) in d dimensions. A field that is constant on each
    facet may be (n, 1). An array (m,) of values at the m nodes represents the scalar field that is linear between them.
    A constant vector v must be given as `np.reshape(v, (-1, 1, 1))`, since numpy would spread an array (d,) along the
    points.

    Args:
        model: a model of the joint.
        seam: name of a seam; "S": all seams.

    Attributes:
        x, n: (d, n, q) coordinates of the quadrature points, and unit normals from the lower to the upper side.
        weights: (n, q) weights of integrals: areas, in axisymmetry of the whole revolution.
        quadrature: the quadrature points; `rule` returns the points of other degrees.
        rows: (n,) positions of the facets in `joint.surface_rows`.
        cells: (n, 2) numbers in the joint of the cells below (-1: a rigid base) and above each facet.
        corners: (n, k) numbers in the joint of the k corners of each facet.
        faces: (2, n, a, d) coordinates of the a nodes of each facet, in the cells below, then in the cells above.
        seams: (n,) name of each facet's seam.
        points: (q, d - 1) quadrature points in the reference facet.
        shapes: (q, k) values at these points of the degree-1 shape functions of the corners.
        node_numbers: (m,) numbers that identify the m nodes of S, those of `Joint.pairs`. A node is a vertex of S
            together with a seam and the two bodies that the seam joins there. So a vertex where seams or bodies meet
            has several nodes. In 2D nodes are ordered along S, piece after piece; in 3D by coordinates.
        vertices: (m,) numbers in the joint of the vertices at which the nodes lie. Where periodic sides identify
            several vertices, it is the number of the first of them.
        nodes: (n, k) positions, in the array `node_numbers`, of the nodes at the k corners of each facet.

    Raises:
        InputError: `model` is no model, or the seam is unknown.
    """

    def __init__(self, model: Model, seam: str = S) -> None:
        if not isinstance(model, Model):
            hint = ": give the state's model" if isinstance(model, State) else ""
            raise InputError(f"Surface needs a model, not {model!r:.80}{hint}")
        if seam != S:
            require_known("seam", seam, model.joint.seams)
        self.model, self.seam = model, seam
        self.joint = joint = model.domain.joint if model.broken else model.joint
        self.kind = FACET_TYPES[joint.cell_type]
        self.rows: IntArray = joint.facets_of(seam)
        self.cells = joint.surface_cells[self.rows]
        self.corners = joint.surface[self.rows, : joint.table.vertices.shape[1]]
        self.seams = np.array(list(joint.seams))[joint.seam_numbers[self.rows]]
        self.faces = joint.faces[:, self.rows]
        self.node_numbers, self.vertices, self.nodes = self._number_nodes()
        self._rules: dict[int, FacetPoints] = {}
        self.quadrature = self.rule(2 * (model.structure.degree + joint.degree - 1) + model.kinematics.factor_degree)
        self.x, self.n, self.weights = self.quadrature.x, self.quadrature.n, self.quadrature.weights
        self.points, self.shapes = self.quadrature.points, np.asarray(self.quadrature.shapes[0])

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.model!r}, {self.seam!r})"

    def rule(self, degree: int) -> FacetPoints:
        """Return the points on all facets of the quadrature rule that is exact for polynomials of degree `degree`."""
        if degree not in self._rules:
            self._rules[degree] = self.on_facets(*basix.make_quadrature(basix.CellType[self.kind], degree))
        return self._rules[degree]

    def on_facets(self, points: Array, weights: Array | float = 1.0) -> FacetPoints:
        """Map points of the reference facet to all facets.

        Args:
            points: (q, d - 1) coordinates in the reference facet; d: number of dimensions.
            weights: (q,) quadrature weights there; 1 if the points are no quadrature rule.
        """
        return FacetPoints(self, np.arange(len(self.rows)), points, weights)

    @cached_property
    def corner_points(self) -> FacetPoints:
        """The corners of all facets, as points that are no quadrature rule."""
        return self.on_facets(np.asarray(basix.geometry(basix.CellType[self.kind])))

    # ---------------------------------------------------------------- places
    def at(self, x: npt.ArrayLike) -> tuple[LocatedPoints, FacetPoints]:
        """Find the facets on which points lie, and the points' positions on them.

        A point on an edge lies on several facets. The rows of both results are pairs of a point and a facet, in the
        same order.

        Args:
            x: coordinates (n, d) of points in d dimensions, or (d,) of one point.

        Raises:
            InputError: x has another shape or numbers that are not finite, or a point is not on the surface.
        """
        located = LocatedPoints.locate(self.kind, self.faces.mean(axis=0), x)
        refuse(located.is_missing, located.x, f"{{bad}} of {{all}} places are not on {self.seam}, the first at {{at}}")
        return located, FacetPoints(self, located.entity, located.X[:, None])

    def on_side(self, located: LocatedPoints, side: str) -> LocatedPoints:
        """Keep, for points that lie on the surface, only the cells on the given side of it.

        Points that do not lie on the surface keep all their cells.

        Args:
            located: points, and the cells of the joint that contain them.
            side: "lower" or "upper".

        Raises:
            InputError: another side, or a point where this side has no cells, as below S on a rigid base.
        """
        require(side in SIDE_NAMES, "side", side, "allowed: lower, upper")
        count, k = len(self.joint.cells) + 1, SIDE_NAMES.index(side)
        lower, upper = (LocatedPoints.locate(self.kind, nodes, located.x) for nodes in self.faces)
        points, at = np.union1d(lower.point, upper.point), (lower, upper)[k]
        cells = self.cells[at.entity, k]
        wanted = (at.point * count + cells)[cells >= 0]
        reason = "but a rigid base" if self.joint.parted is None else EXTENDED_BODIES_HINT
        message = f"no body is on the {side} side of S at {{at}}, {reason}"
        refuse(~np.isin(points, wanted // count), located.x[points], message)
        return located[np.isin(located.point * count + located.entity, wanted) | ~np.isin(located.point, points)]

    def in_layer(self, x: npt.ArrayLike, height: npt.ArrayLike) -> Array:
        """Return the coordinates (n, d) of points in the meshed layer of a full model, from positions on S and heights.

        Args:
            x: (n, d) coordinates of points on S.
            height: positions across the layer, from -1/2 at the lower to 1/2 at the upper face, one number or (n,).

        Raises:
            InputError: the model is not a full model, or a point is not on S.
        """
        if not isinstance(self.model, FullModel):
            raise InputError(f"the surface of a meshed layer is of a full model, not of {self.model!r:.80}")
        inflated, (located, at) = self.model.inflated_joint, self.at(x)
        nodes = inflated.points[band_of(inflated).face_nodes[:, self.rows]]
        shapes = tabulated(lagrange(self.kind, self.joint.degree), at.points, len(at.rows))[0]
        lower, upper = (located.point_means(face_x) for face_x in np.einsum("fqa,sfad->sfd", shapes, nodes[:, at.rows]))
        return np.asarray(lower + (np.asarray(height, float)[..., None] + 0.5) * (upper - lower))

    # ---------------------------------------------------------------- states, and functions of models
    def displacements(self, state: State) -> Array:
        """Return the displacements (2, d, n, q) of the lower, then of the upper side of S in `state`. Collective.

        They are values at the q quadrature points of n facets in d dimensions, and zero on a rigid base.

        Raises:
            InputError: `state` is no state, or its model has another joint.
        """
        self._require_same_joint(state)
        return self.side_values(state.u, state.model, self.quadrature)

    def jump(self, state: State) -> Array:
        """Return the jumps [u] = u(upper) - u(lower), (d, n, q), at the q quadrature points of n facets. Collective.

        `state` has the displacements u.
        """
        lower, upper = self.displacements(state)
        return np.asarray(upper - lower)

    def _require_same_joint(self, state: State) -> None:
        if not isinstance(state, State):
            raise InputError(f"Surface takes a state, as solve returns it or history.last is, not {state!r:.80}")
        if state.model.surface_identity is not self.model.surface_identity:
            raise InputError("this state's model has another joint than the surface; build both from the same one")

    def side_values(self, f: fem.Function, model: Model, at: FacetPoints) -> Array:
        """Return the values (2, c, n, q) of a function on the lower, then on the upper side of S. Collective.

        On a rigid base they are zero.

        Args:
            f: function with c components on the model's mesh.
            model: the model of f.
            at: the points on S, q on each of n facets.
        """
        element = f.function_space.ufl_element().basix_element
        values = node_values(f, model, self.cells[at.rows].clip(0))  # not used below S on a rigid base
        out = np.zeros((2, f.function_space.dofmap.bs, *at.weights.shape))
        geometry = np.asarray(basix.geometry(basix.CellType[self.joint.cell_type]))
        for side, cells in enumerate(self.cells[at.rows].T):
            rows = np.flatnonzero(cells >= 0)
            if len(rows):
                in_cells = self.joint.in_cells[side, self.rows[at.rows[rows]], : self.corners.shape[1]]
                X = at.shapes[rows] @ geometry[in_cells]
                out[side][:, rows] = np.moveaxis(tabulated(element, X, len(rows))[0] @ values[rows, side], -1, 0)
        return out

    @cached_property
    def distance_to_ends(self) -> Array:
        """Distances (n, q) of the quadrature points from the ends of S or, for the surface of one seam, of the seam.

        They are infinite if there are no ends, as on a closed surface.
        """
        x = np.moveaxis(self.x, 0, -1)
        rim = Sheet(self.joint, self.seam).rim
        return rim.distance(self.joint.points, x.reshape(-1, len(self.x))).reshape(x.shape[:-1])

    # ---------------------------------------------------------------- integrals
    def _as_field(self, f: object) -> Array:
        """Convert a number, a field or nodal values to a field (..., n, q) at the q quadrature points of n facets.

        Args:
            f: a number, a field (..., n, q), a field (..., n, 1) that is constant on each facet, or values (m,) at m
                nodes.

        Raises:
            InputError: f has another shape, or is no array of numbers.
        """
        try:
            values = np.asarray(f, float)
            if values.shape == (len(self.node_numbers),):
                values = self.at_points(values)
            if f is None or (values.ndim and values.shape[-2:] not in ((len(self.rows), 1), self.weights.shape)):
                raise ValueError
            return np.broadcast_to(values, (*values.shape[:-2], *self.weights.shape))
        except (TypeError, ValueError):
            text = f"an array {f.shape}" if isinstance(f, np.ndarray) and f.ndim else f"{f!r:.80}"
            shape = f"(..., n, q) = (..., {str(self.weights.shape)[1:]}, as surface.jump(state) or surface.x[0]"
            message = f"{text} is not a field on S; give an array {shape}, (n, 1) of facets, or values at nodes"
            raise InputError(message) from None

    def where(self, part: Where | float) -> Array:
        """Return factors (n, q) at the q quadrature points of n facets, which select a part of S in integrals.

        They are 1 inside the part and 0 outside.

        Args:
            part: the factors as a field. Or a numpy function of the coordinates x (d, n, q) that returns them, such as
                `lambda x: x[0] > 1`.

        Raises:
            InputError: `part` is neither.
        """
        try:
            return self._as_field(part(self.x) if callable(part) else part)
        except Exception as error:
            example = "lambda x: (x[0] > 1) & (x[0] < 9)"
            raise InputError(f"where is not a numpy function of coordinates such as {example}: {error}") from error

    def integral(self, f: npt.ArrayLike) -> Any:
        """Return the integral of a field over S: a number, or an array (d,) for a vector field.

        Args:
            f: a number, or values at the q quadrature points of n facets: (n, q), for vectors (d, n, q).
        """
        total = (self._as_field(f) * self.weights).sum(axis=(-2, -1))
        return total if total.ndim else float(total)

    def norm(self, f: npt.ArrayLike, where: Where | float = 1.0) -> float:
        """Return the L2 norm of a field over S, or over a part of S.

        Args:
            f: values at the q quadrature points of n facets: (n, q), for vectors (d, n, q).
            where: factors, 1 inside the part and 0 outside: a field (n, q) or a numpy function of the coordinates x (d,
                n, q).
        """
        return float(np.sqrt((self._as_field(f) ** 2 * self.where(where) * self.weights).sum()))

    def frame(self, f: npt.ArrayLike) -> Array:
        """Return the components (d, n, q) of a vector field along the tangents of S, then along its normal.

        `f` is the field (d, n, q), with components along the coordinate axes. In 2D the tangent is (n_2, -n_1). In 3D
        consider the smallest rotation that takes the second coordinate axis to n. It takes the first and the third axis
        to the tangents (`forms.tensors.layer_frame`).
        """
        values, n = self._as_field(f), self.n
        if values.shape != n.shape:
            raise InputError(f"frame needs a vector field of shape {n.shape}, not {values.shape}")
        axes = normal_frames(np.moveaxis(n, 0, -1).reshape(-1, len(n))).reshape(*self.weights.shape, len(n), len(n))
        return np.einsum("fqij,jfq->ifq", axes, values)

    # ---------------------------------------------------------------- nodes
    def _number_nodes(self) -> tuple[IntArray, IntArray, IntArray]:
        """Return the arrays `node_numbers`, `vertices` and `nodes`."""
        corner_numbers = self.joint.pairs[self.rows]
        numbers, first_corners, nodes = np.unique(corner_numbers, return_index=True, return_inverse=True)
        vertices, nodes = self.joint.masters[self.corners].ravel()[first_corners], nodes.reshape(corner_numbers.shape)
        x, size = self.joint.points[vertices], self.joint.size
        order = curve_order(x, nodes, size) if self.joint.dim == 2 else place_order(x, size)
        return numbers[order], vertices[order], np.argsort(order)[nodes]

    @property
    def places(self) -> Array:
        """Coordinates (m, d) of the m nodes of S in d dimensions."""
        return self.joint.points[self.vertices]

    def positions_of(self, numbers: IntArray) -> IntArray:
        """Return the positions, in this mesh's array `node_numbers`, of the given node numbers.

        Args:
            numbers: node numbers, all of which the array contains, in any shape; the result has the same shape.
        """
        order = np.argsort(self.node_numbers)
        return order[np.searchsorted(self.node_numbers[order], numbers)]

    def mass(self, f: npt.ArrayLike = 1.0) -> scipy.sparse.csc_matrix:
        """Return the mass matrix (m, m) of the degree-1 shape functions of the m nodes, with a weight.

        Args:
            f: the weight: a number, or values (n, q) at the q quadrature points of n facets.
        """
        return self._matrix(np.einsum("fq,qa,qb->fab", self._as_field(f) * self.weights, self.shapes, self.shapes))

    def stiffness(self, f: npt.ArrayLike = 1.0) -> scipy.sparse.csc_matrix:
        """Return the matrix (m, m) of int_S f grad_S p . grad_S q for the degree-1 shape functions p, q of the m nodes.

        Args:
            f: a number, or values (n, q) at the q quadrature points of n facets.
        """
        gradients = self.quadrature.shape_gradients
        return self._matrix(np.einsum("fq,fqad,fqbd->fab", self._as_field(f) * self.weights, gradients, gradients))

    def _matrix(self, facet_matrices: Array) -> scipy.sparse.csc_matrix:
        rows, columns = np.broadcast_arrays(self.nodes[:, :, None], self.nodes[:, None])
        shape = (len(self.node_numbers),) * 2
        return scipy.sparse.csc_matrix((facet_matrices.ravel(), (rows.ravel(), columns.ravel())), shape=shape)

    def nodal_sums(self, at_corners: Array) -> Array:
        """Sum values at corners of facets over all corners that are the same node.

        Args:
            at_corners: (n, k, ...) values at the k corners of n facets.

        Returns:
            The sum (m, ...) at each of the m nodes.
        """
        return sum_by_number(self.nodes, at_corners, len(self.node_numbers))

    def moments(self, f: npt.ArrayLike) -> Array:
        """Return the integrals over each facet of a field times the degree-1 shape function of each corner.

        They are (n, k) for n facets with k corners, for vector fields (n, k, d).

        Args:
            f: a number, or values at the q quadrature points of the facets: (n, q), for vectors (d, n, q).
        """
        return np.asarray(np.einsum("fq,qa,...fq->fa...", self.weights, self.shapes, self._as_field(f)))

    def projected(self, moments: Array) -> Array:
        """Return the nodal values (m, ...) of the L2 projection of a field on functions of degree 1.

        `moments` (n, k, ...) are those that the method `moments` returns for the field.
        """
        total = self.nodal_sums(moments)
        return np.asarray(self._solver(total.reshape(len(total), -1))).reshape(total.shape)

    def lumped(self, moments: Array) -> Array:
        """Return nodal values (m, ...) of a field: its integral with each node's shape function over the node's area.

        This is a projection with a lumped mass matrix. Contact laws define tractions at nodes in this way. `moments`
        (n, k, ...) are those that the method `moments` returns for the field.
        """
        return np.asarray((self.nodal_sums(moments).T / self.areas).T)

    @cached_property
    def areas(self) -> Array:
        """Areas (m,) of S that belong to the m nodes: integrals of their degree-1 shape functions."""
        return self.nodal_sums(self.moments(1.0))

    @cached_property
    def _solver(self) -> Callable[[Array], Array]:
        return scipy.sparse.linalg.splu(self.mass()).solve

    def nodal(self, f: npt.ArrayLike) -> Array:
        """Return the L2 projection of a field on functions of degree 1, by its nodal values.

        They are (m,), or (m, d) for vectors, at the m nodes with the coordinates `places`.

        Args:
            f: values at the q quadrature points of n facets: (n, q), for vectors (d, n, q).
        """
        return self.projected(self.moments(f))

    def at_points(self, nodal: Array) -> Array:
        """Interpolate nodal values linearly to the q quadrature points of n facets.

        The result is (n, q) for values `nodal` (m,) at m nodes, and (d, n, q) for vectors (m, d).
        """
        return np.asarray(np.einsum("qa,fa...->...fq", self.shapes, nodal[self.nodes]))

    def from_corners(self, at_corners: Array) -> Array:
        """Interpolate values at the corners of facets linearly to their quadrature points.

        `at_corners` (..., n, k) has the values at the k corners of n facets. The result is (..., n, q) at q points of
        each.
        """
        return np.asarray(at_corners @ self.shapes.T)

    def function(self, f: npt.ArrayLike, times: npt.ArrayLike | None = None) -> SurfaceFunction:
        """Return a field as a function of place and time, for data of other models of the same joint.

        It is the L2 projection of degree 1, and takes parameters of laws, or sources, from another model's results.

        Args:
            f: a number, or values at the q quadrature points of n facets: (n, q), at several times (rows, n, q).
            times: (rows,) increasing times, between which the function is linear; None: it does not depend on time.

        Raises:
            InputError: f is no field; times do not increase, or are not as many as the fields.
        """
        values, rows = self._as_field(f), None if times is None else np.array(times, float)
        count = 0 if rows is None else rows.size
        require(rows is None or (count > 1 and (np.diff(rows) > 0).all()), "times", times, "two or more, increasing")
        require(values.shape[:-2] == ((count,) if count else ()), "shape of f", np.shape(f), f"{count or 'no'} times")
        return SurfaceFunction(self, self.nodal(values).T if count else self.nodal(values), rows)

    def profile(self, f: npt.ArrayLike) -> tuple[Array, Array]:
        """Return the coordinates (m, d) of the m nodes of S, and nodal values of a field there.

        They are those of the L2 projection of degree 1: (m,), for vector fields (m, d).

        Args:
            f: values at the q quadrature points of n facets: (n, q), for vectors (d, n, q).
        """
        return self.places, self.nodal(f)

    def along(self, f: npt.ArrayLike, *, plane: Plane | None = None) -> list[Line]:
        """Return the values of a field along the lines of S, by arc length.

        A field that is constant on each facet gives steps. Other fields are L2-projected on functions of degree 1.
        Where values jump, as at a junction with another seam, a line has two points with the same arc length.

        In 2D a line is a piece of a seam: it ends where the seam ends, branches or crosses itself. In 3D it is the cut
        of a seam by a plane. Lines are ordered by seam, then by their start points. A line starts at its lower end: the
        one with the smaller first coordinate or, if these are equal, the smaller next one. A closed line starts at its
        lowest point in this sense, and goes on to the lower neighbour of that point.

        Args:
            f: values at the q quadrature points of n facets: (n, q), for vectors (d, n, q); or values (m,) at m nodes.
            plane: in 3D a point of the plane and its normal, ((x, y, z), (n_x, n_y, n_z)); None in 2D.

        Raises:
            InputError: f is not a field, or a plane is given in 2D. Or in 3D no plane is given, or it does not cut S.
        """
        values, lines = self.at_corners(f), list[Line]()
        for name in dict.fromkeys(self.seams.tolist()):
            in_seam = self.seams == name
            lines += lines_on(self.joint, name, self.rows[in_seam], values[in_seam], plane)
        if not lines:
            raise InputError(f"the plane {plane!r} does not cut S")
        return lines

    def at_corners(self, f: npt.ArrayLike) -> Array:
        """Return the values (n, k), for vector fields (n, k, d), of a field at the k corners of n facets.

        A field that is not constant on each facet is L2-projected on functions of degree 1.

        Args:
            f: values at the q quadrature points of the facets: (n, q), for vectors (d, n, q); or values (m,) at m
                nodes.
        """
        values = self._as_field(f)
        if np.shape(f) == (len(self.node_numbers),):
            return np.asarray(f, float)[self.nodes]
        if np.shape(f)[-2:] == (len(self.rows), 1):
            return np.stack([np.moveaxis(values[..., 0], -1, 0)] * self.nodes.shape[1], axis=1)
        return self.nodal(values)[self.nodes]

    # ---------------------------------------------------------------- layers
    def thickness(self, layer: SeamLayer, vertices: IntArray) -> Array:
        """Return the thickness of a layer at vertices, in an array of the shape of `vertices`.

        Args:
            layer: a layer with a law of strains.
            vertices: numbers of the vertices in the joint, in any shape.
        """
        relative = self.joint.relative_thickness(layer.as_thin_layer.profile, layer.name)
        return np.asarray(layer.eps * relative[vertices])

    def ridge_lengths(self, rim: Rim) -> Array:
        """Return the lengths (n,) of the n ridges (edges in 3D, vertices in 2D) in `rim`, which bound S at its ends.

        In plane models they are 1, in axisymmetry the circumference.
        """
        return np.asarray(rim.length * self.model.kinematics.factors_at(self.joint.points[rim.vertices].mean(axis=1)))


def surface_of(model: Model, seam: str) -> SurfaceMesh:
    """Return the `SurfaceMesh` of the seam `seam` of `model`; it is made once and then taken from the model."""
    surfaces: dict[str, SurfaceMesh] = vars(model).setdefault("surface_mesh_cache", {})
    if seam not in surfaces:
        surfaces[seam] = SurfaceMesh(model, seam)
        surfaces[seam].model = proxy(model)  # the model owns the mesh: no reference cycle
    return surfaces[seam]
