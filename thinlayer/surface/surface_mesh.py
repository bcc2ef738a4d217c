"""S as a separate mesh: points, integrals, projections, lines, and values of functions on both sides, as arrays."""

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
from scipy.spatial import cKDTree

from forms.base import Array, InputError, require
from geometry.refusals import refuse, require_known
from geometry.seam import BASE, S
from geometry.sheet import Rim, Sheet
from geometry.topology import FACET_TYPES, BoolArray, IntArray, along, by_place, lagrange, sum_by_number
from thinlayer.discretisation.contact_nodes import normal_frames
from thinlayer.discretisation.full_model import FullModel
from thinlayer.discretisation.layer import SeamLayer
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State, cell_values
from thinlayer.surface.lines import Line, Plane, lines_on
from thinlayer.surface.locating import EXTENDED_BODIES_HINT, LocatedPoints

Where = Array | BoolArray | Callable[[Array], object]
SIDE_NAMES = ("lower", "upper")


class FacetPoints:
    """q points on each of n facets of a surface.

    Attributes:
        rows: (n,) positions of the facets on the surface.
        points: (q, d - 1) or (n, q, d - 1) coordinates in the reference facet.
        shapes: (n, q, k) values of the shape functions of degree 1 of the corners.
        x, n: (d, n, q) coordinates, and unit normals from the lower to the upper side.
        weights: (n, q) weights of integrals over S; in axisymmetry over the whole revolution.
    """

    def __init__(self, surface: SurfaceMesh, rows: IntArray, points: Array, weights: Array | float = 1.0) -> None:
        joint, nodes, count = surface.joint, surface.faces.mean(axis=0)[rows], len(rows)
        linear = tabulated(lagrange(surface.kind, 1), points, count, 1)
        table = tabulated(lagrange(surface.kind, joint.degree), points, count, 1)
        self.rows, self.points, self.shapes, self._reference_slopes = rows, points, linear[0], linear[1:]
        self.x = np.moveaxis(table[0] @ nodes, -1, 0)
        self._along = along = table[1:] @ nodes
        across = np.stack([along[0, ..., 1], -along[0, ..., 0]], -1) if joint.dim == 2 else np.cross(*along)
        size = np.linalg.norm(across, axis=-1)
        above = joint.points[joint.corners[surface.cells[rows, 1]]].mean(axis=1)
        up = np.einsum("fqd,fd->fq", across, above - joint.points[surface.corners[rows]].mean(axis=1))
        self.n = np.moveaxis(across * (np.sign(up) / size)[..., None], -1, 0)
        self.weights = weights * size * surface.model.kinematics.factor_at(np.moveaxis(self.x, 0, -1))

    @cached_property
    def slopes(self) -> Array:
        """(n, q, k, d) gradients along S of the shape functions of degree 1 of the corners."""
        to_x = np.linalg.pinv(np.moveaxis(self._along, 0, -1))
        return np.asarray(np.einsum("jfqa,fqjd->fqad", self._reference_slopes, to_x))


def tabulated(element: basix.finite_element.FiniteElement, points: Array, count: int, derivatives: int = 0) -> Array:
    """Values (1, n, q, a) of an element's functions at points (q, t), or (n, q, t), of n entities.

    With one derivative the result is (1 + t, n, q, a): values, then slopes.
    """
    table = element.tabulate(derivatives, points.reshape(-1, points.shape[-1]))[..., 0]
    table = table.reshape(len(table), *points.shape[:-1], -1)
    return np.broadcast_to(table if points.ndim == 3 else table[:, None], (len(table), count, *table.shape[-2:]))


class SurfaceMesh:
    """S of a joint, or one of its seams, as a separate mesh, whole on every rank.

    A field is an array with a value at each of q quadrature points of each of n facets: (n, q), for vectors (d, n, q).
    A field that is constant on facets is (n, 1). Values (m,) at the nodes represent the field that is linear between
    them. A constant vector v must have the shape of `np.reshape(v, (-1, 1, 1))`: numpy broadcasts (d,) along the
    points.

    Args:
        model: a model of the joint.
        seam: name of a seam; "S": all seams.

    Attributes:
        x, n: (d, n, q) quadrature points, and unit normals from the lower to the upper side.
        weights: (n, q) weights of integrals: areas, in axisymmetry of the whole revolution.
        quadrature: the quadrature points; `rule` returns the points of other degrees.
        rows: (n,) positions of the facets in `joint.surface_rows`.
        cells: (n, 2) numbers in the joint of the cells below (-1: a rigid base) and above.
        corners: (n, k) vertices of the facets in the joint.
        faces: (2, n, a, d) coordinates of the facets' nodes in the cells below and above.
        seams: (n,) name of each facet's seam.
        points: (q, d - 1) quadrature points in the reference facet.
        shapes: (q, k) values at these points of the shape functions of degree 1 of the corners.

    Raises:
        InputError: not a model, or an unknown seam.
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
        self.rows: IntArray = np.searchsorted(joint.surface_rows, joint.rows_of(seam))
        self.cells = joint.surface_cells[self.rows]
        self.corners = joint.surface[self.rows, : joint.table.vertices.shape[1]]
        self.seams = np.array(list(joint.seams))[joint.seam_numbers[self.rows]]
        self.faces = joint.faces()[:, self.rows]
        self._rules: dict[int, FacetPoints] = {}
        self.quadrature = self.rule(2 * model.structure.degree + 2 * (joint.degree - 1) + model.kinematics.degree)
        self.x, self.n, self.weights = self.quadrature.x, self.quadrature.n, self.quadrature.weights
        self.points, self.shapes = self.quadrature.points, np.asarray(self.quadrature.shapes[0])

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.model!r}, {self.seam!r})"

    def rule(self, degree: int) -> FacetPoints:
        """The points of the quadrature rule of this degree on all facets."""
        if degree not in self._rules:
            self._rules[degree] = self.on_facets(*basix.make_quadrature(basix.CellType[self.kind], degree))
        return self._rules[degree]

    def on_facets(self, points: Array, weights: Array | float = 1.0) -> FacetPoints:
        """The same points (q, d - 1) of the reference facet on all facets."""
        return FacetPoints(self, np.arange(len(self.rows)), points, weights)

    @cached_property
    def corner_points(self) -> FacetPoints:
        """The corners of all facets."""
        return self.on_facets(np.asarray(basix.geometry(basix.CellType[self.kind])))

    # ---------------------------------------------------------------- places
    def at(self, x: npt.ArrayLike) -> tuple[LocatedPoints, FacetPoints]:
        """All facets that contain points x (n, d), or one point (d,), and the points on these facets.

        Raises:
            InputError: no finite numbers of this shape; points that are not on the surface.
        """
        located = LocatedPoints.of(self.kind, self.faces.mean(axis=0), x)
        refuse(located.missing, located.x, f"{{bad}} of {{all}} places are not on {self.seam}, the first at {{at}}")
        return located, FacetPoints(self, located.entity, located.X[:, None])

    def on_side(self, located: LocatedPoints, side: str) -> LocatedPoints:
        """Keep, for points on the surface, only the cells on one side; other points keep all their cells.

        Args:
            located: points in cells of the joint.
            side: "lower" or "upper".

        Raises:
            InputError: another side; a rigid base, which has no cells below.
        """
        require(side in SIDE_NAMES, "side", side, "allowed: lower, upper")
        count, k = len(self.joint.cells) + 1, SIDE_NAMES.index(side)
        lower, upper = (LocatedPoints.of(self.kind, nodes, located.x) for nodes in self.faces)
        points, at = np.union1d(lower.point, upper.point), (lower, upper)[k]
        cells = self.cells[at.entity, k]
        wanted = (at.point * count + cells)[cells >= 0]
        there = "but a rigid base" if self.joint.parted is None else EXTENDED_BODIES_HINT
        message = f"no body is on the {side} side of S at {{at}}, {there}"
        refuse(~np.isin(points, wanted // count), located.x[points], message)
        return located[np.isin(located.point * count + located.entity, wanted) | ~np.isin(located.point, points)]

    def in_layer(self, x: npt.ArrayLike, height: npt.ArrayLike) -> Array:
        """Points (n, d) in the meshed layer of a full model, at points x of S and heights between the faces.

        Args:
            x: points on S, (n, d).
            height: from -1/2 at the lower to 1/2 at the upper face, one number or (n,).

        Raises:
            InputError: the surface is not of a full model; points off S.
        """
        if not isinstance(self.model, FullModel):
            raise InputError(f"the surface of a meshed layer is of a full model, not of {self.model!r:.80}")
        inflated = self.model.inflated
        nodes = self.joint.faces(inflated.cell_points)[:, self.rows]
        if BASE in inflated.facets:
            table, kind = inflated.table, inflated.cell_type
            on_base = np.unique(table.nodes(table.index(inflated.facets[BASE]), inflated.cells, kind))
            stands = self.cells[:, 0] < 0
            _, at_s = cKDTree(inflated.reference[on_base]).query(nodes[0, stands])
            nodes[0, stands] = inflated.points[on_base[at_s]]
        located, at = self.at(x)
        shapes = tabulated(lagrange(self.kind, self.joint.degree), at.points, len(at.rows))[0]
        lower, upper = (located.mean(places) for places in np.einsum("fqa,sfad->sfd", shapes, nodes[:, at.rows]))
        return np.asarray(lower + (np.asarray(height, float)[..., None] + 0.5) * (upper - lower))

    # ---------------------------------------------------------------- states, and functions of models
    def displacements(self, state: State) -> Array:
        """(2, d, n, q) displacements of the lower and of the upper side; zero on a rigid base. Collective.

        Raises:
            InputError: not a state, or a state of another joint.
        """
        self._require_same_joint(state)
        return self.sides(state.u, state.model, self.quadrature)

    def jump(self, state: State) -> Array:
        """(d, n, q) jump [u] = u(upper) - u(lower). Collective."""
        lower, upper = self.displacements(state)
        return np.asarray(upper - lower)

    def _require_same_joint(self, state: State) -> None:
        if not isinstance(state, State):
            raise InputError(f"Surface takes a state, as solve returns it or history.last is, not {state!r:.80}")
        if state.model.surface_identity is not self.model.surface_identity:
            raise InputError("this state's model has another joint than the surface; build both from the same one")

    def sides(self, f: fem.Function, model: Model, at: FacetPoints) -> Array:
        """(2, m, n, q) values of a model's function f (m,) below and above; zero on a rigid base. Collective."""
        element = f.function_space.ufl_element().basix_element
        values = cell_values(f, model, self.cells[at.rows].clip(0))  # not used below S on a rigid base
        out = np.zeros((2, f.function_space.dofmap.bs, *at.weights.shape))
        geometry = np.asarray(basix.geometry(basix.CellType[self.joint.cell_type]))
        for side, cells in enumerate(self.cells[at.rows].T):
            local = (self.joint.corners[cells][:, None] == self.corners[at.rows][..., None]).argmax(axis=2)
            kinds, kind = np.unique(local, axis=0, return_inverse=True)
            for k, corners in enumerate(kinds):  # one for each orientation of facets in their cells
                here = np.flatnonzero((kind.ravel() == k) & (cells >= 0))
                if len(here):
                    X = (at.shapes[0] if at.points.ndim == 2 else at.shapes[here]) @ geometry[corners]
                    out[side][:, here] = np.moveaxis(tabulated(element, X, len(here))[0] @ values[here, side], -1, 0)
        return out

    @cached_property
    def distance_to_ends(self) -> Array:
        """(n, q) distances of the quadrature points from the ends of S, or of this seam; infinite if it is closed."""
        x = np.moveaxis(self.x, 0, -1)
        rim = Sheet(self.joint, self.seam).rim
        return rim.distance(self.joint.points, x.reshape(-1, len(self.x))).reshape(x.shape[:-1])

    # ---------------------------------------------------------------- integrals
    def _field(self, f: object) -> Array:
        """Return f as a field (..., n, q); raise InputError if it is not a field."""
        try:
            values = np.asarray(f, float)
            if values.shape == (len(self.numbers),):
                values = self.at_points(values)
            if f is None or (values.ndim and values.shape[-2:] not in ((len(self.rows), 1), self.weights.shape)):
                raise ValueError
            return np.broadcast_to(values, (*values.shape[:-2], *self.weights.shape))
        except (TypeError, ValueError):
            what = f"an array {f.shape}" if isinstance(f, np.ndarray) and f.ndim else f"{f!r:.80}"
            shape = f"(..., n, q) = (..., {str(self.weights.shape)[1:]}, as surface.jump(state) or surface.x[0]"
            message = f"{what} is not a field on S; give an array {shape}, (n, 1) of facets, or values at nodes"
            raise InputError(message) from None

    def where(self, part: Where | float) -> Array:
        """(n, q) weights of a part of S, from a field or a numpy function of the coordinates x (d, n, q).

        Raises:
            InputError: `part` is neither.
        """
        try:
            return self._field(part(self.x) if callable(part) else part)
        except Exception as error:
            example = "lambda x: (x[0] > 1) & (x[0] < 9)"
            raise InputError(f"where is not a numpy function of coordinates such as {example}: {error}") from error

    def integral(self, f: npt.ArrayLike) -> Any:
        """Integral over S of a field: a float, or an array (d,) for a vector field."""
        total = (self._field(f) * self.weights).sum(axis=(-2, -1))
        return total if total.ndim else float(total)

    def norm(self, f: npt.ArrayLike, where: Where | float = 1.0) -> float:
        """L2 norm over S of a field, weighted with `where`."""
        return float(np.sqrt((self._field(f) ** 2 * self.where(where) * self.weights).sum()))

    def frame(self, f: npt.ArrayLike) -> Array:
        """(d, n, q) components of a vector field in the frame of S: tangential components, then the normal component.

        The tangents are axes of `forms.tensors.layer_frame`: (n_2, -n_1) in 2D, the first and the third axis in 3D.
        """
        values, n = self._field(f), self.n
        if values.shape != n.shape:
            raise InputError(f"frame needs a vector field of shape {n.shape}, not {values.shape}")
        axes = normal_frames(np.moveaxis(n, 0, -1).reshape(-1, len(n))).reshape(*self.weights.shape, len(n), len(n))
        return np.einsum("fqij,jfq->ifq", axes, values)

    # ---------------------------------------------------------------- nodes
    @cached_property
    def _numbered(self) -> tuple[IntArray, IntArray, IntArray]:
        """The values of `numbers`, `vertices` and `nodes`."""
        of_table = self.joint.table.vertices[self.joint.surface_rows[self.rows]]
        at = (of_table[:, None] == self.corners[..., None]).argmax(axis=2)
        codes = np.take_along_axis(self.joint.pairs[self.rows], at, axis=1)
        numbers, first, nodes = np.unique(codes, return_index=True, return_inverse=True)
        vertices, nodes = self.joint.masters[self.corners].ravel()[first], nodes.reshape(codes.shape)
        x, size = self.joint.points[vertices], self.joint.size
        order = along(x, nodes, size) if self.joint.dim == 2 else by_place(x, size)
        return numbers[order], vertices[order], np.argsort(order)[nodes]

    @property
    def numbers(self) -> IntArray:
        """(m,) numbers of the nodes (`Joint.pairs`): where seams meet, one for each pair of bodies at a vertex.

        In 2D they are ordered along S, piece after piece; in 3D by coordinates. Each piece of S has one pair at a
        vertex.
        """
        return self._numbered[0]

    @property
    def places(self) -> Array:
        """(m, d) coordinates of the nodes."""
        return self.joint.points[self.vertices]

    @property
    def vertices(self) -> IntArray:
        """(m,) vertex of the joint at each node; the first of the vertices that periodic sides identify."""
        return self._numbered[1]

    @property
    def nodes(self) -> IntArray:
        """(n, k) position in `numbers` of the node at each corner."""
        return self._numbered[2]

    def find(self, numbers: IntArray) -> IntArray:
        """Positions in `numbers` of the nodes with these numbers."""
        order = np.argsort(self.numbers)
        return order[np.searchsorted(self.numbers[order], numbers)]

    def mass(self, f: npt.ArrayLike = 1.0) -> scipy.sparse.csc_matrix:
        """(m, m) mass matrix of the functions of degree 1, weighted with a field."""
        return self._matrix(np.einsum("fq,qa,qb->fab", self._field(f) * self.weights, self.shapes, self.shapes))

    def stiffness(self, f: npt.ArrayLike = 1.0) -> scipy.sparse.csc_matrix:
        """(m, m) products of the gradients along S of the functions of degree 1, weighted with a field."""
        slopes = self.quadrature.slopes
        return self._matrix(np.einsum("fq,fqad,fqbd->fab", self._field(f) * self.weights, slopes, slopes))

    def _matrix(self, of_facets: Array) -> scipy.sparse.csc_matrix:
        rows, columns = np.broadcast_arrays(self.nodes[:, :, None], self.nodes[:, None])
        shape = (len(self.numbers),) * 2
        return scipy.sparse.csc_matrix((of_facets.ravel(), (rows.ravel(), columns.ravel())), shape=shape)

    def sums(self, of_corners: Array) -> Array:
        """(m, ...) sums at the nodes of values (n, k, ...) at the corners of facets."""
        return sum_by_number(self.nodes, of_corners, len(self.numbers))

    def moments(self, f: npt.ArrayLike) -> Array:
        """(n, k) or (n, k, d) integrals of a field over each facet with the functions of degree 1 of its corners."""
        return np.asarray(np.einsum("fq,qa,...fq->fa...", self.weights, self.shapes, self._field(f)))

    def projected(self, moments: Array) -> Array:
        """(m, ...) nodal values of the L2 projection, from moments (n, k, ...) with the functions of degree 1."""
        total = self.sums(moments)
        return np.asarray(self._solver(total.reshape(len(total), -1))).reshape(total.shape)

    def lumped(self, moments: Array) -> Array:
        """(m, ...) nodal values of moments by a lumped mass matrix, as contact laws define tractions."""
        return np.asarray((self.sums(moments).T / self.areas).T)

    @cached_property
    def areas(self) -> Array:
        """(m,) areas of S around the nodes."""
        return self.sums(self.moments(1.0))

    @cached_property
    def _solver(self) -> Callable[[Array], Array]:
        return scipy.sparse.linalg.splu(self.mass()).solve

    def nodal(self, f: npt.ArrayLike) -> Array:
        """L2 projection (m,) or (m, d) of a field to degree 1, at the nodes (`numbers`, `places`)."""
        return self.projected(self.moments(f))

    def at_points(self, nodal: Array) -> Array:
        """(n, q) or (d, n, q) field of nodal values (m,) or (m, d)."""
        return np.asarray(np.einsum("qa,fa...->...fq", self.shapes, nodal[self.nodes]))

    def between(self, of_corners: Array) -> Array:
        """(..., n, q) field that is linear between values (..., n, k) at the corners of each facet."""
        return np.asarray(of_corners @ self.shapes.T)

    def profile(self, f: npt.ArrayLike) -> tuple[Array, Array]:
        """Coordinates (m, d) of the nodes, and nodal values (m,) or (m, d) of a field projected to degree 1."""
        return self.places, self.nodal(f)

    def along(self, f: npt.ArrayLike, *, plane: Plane | None = None) -> list[Line]:
        """Values of a field along the lines of S, by arc length: steps if it is constant on facets, else of degree 1.

        In 2D a line is a piece of a seam: it ends where the seam ends, branches or crosses itself. In 3D it is the cut
        of a seam by a plane. Lines are ordered by seam, then by their start points. A line starts at its lower end, by
        the first coordinate, then by the next ones. A closed line starts at its lowest point, towards the lower of its
        neighbours. Where values jump, as at a junction with another seam, there are two rows with the same s.

        Args:
            f: the field.
            plane: in 3D a point of the plane and its normal, ((x, y, z), (n_x, n_y, n_z)).

        Raises:
            InputError: f is not a field; a plane in 2D; in 3D no plane, or a plane that does not cut S.
        """
        values, lines = self.at_corners(f), list[Line]()
        for name in dict.fromkeys(self.seams.tolist()):
            mine = self.seams == name
            lines += lines_on(self.joint, name, self.rows[mine], values[mine], plane)
        if not lines:
            raise InputError(f"the plane {plane!r} does not cut S")
        return lines

    def at_corners(self, f: npt.ArrayLike) -> Array:
        """(n, k) or (n, k, d) values of a field at the corners of facets."""
        values = self._field(f)
        if np.shape(f) == (len(self.numbers),):
            return np.asarray(f, float)[self.nodes]
        if np.shape(f)[-2:] == (len(self.rows), 1):
            return np.stack([np.moveaxis(values[..., 0], -1, 0)] * self.nodes.shape[1], axis=1)
        return self.nodal(values)[self.nodes]

    # ---------------------------------------------------------------- layers
    def thickness(self, layer: SeamLayer, vertices: IntArray) -> Array:
        """Thickness (...) of a layer with a law of strains, at vertices (...) of the joint."""
        relative = self.joint.relative_thickness(layer.as_thin_layer.profile, layer.name)
        return np.asarray(layer.eps * relative[vertices])

    def lengths(self, rim: Rim) -> Array:
        """(n,) lengths of the ridges of a part of the rim; in plane models 1, in axisymmetry the circumference."""
        return np.asarray(rim.length * self.model.kinematics.factor_at(self.joint.points[rim.vertices].mean(axis=1)))


def surface_of(model: Model, seam: str) -> SurfaceMesh:
    """The `SurfaceMesh` of a model's seam, made once and stored in the model."""
    kept: dict[str, SurfaceMesh] = vars(model).setdefault("surfaces", {})
    if seam not in kept:
        kept[seam] = SurfaceMesh(model, seam)
        kept[seam].model = proxy(model)  # the model owns the mesh: no reference cycle
    return kept[seam]
