"""S as a mesh of its own: places, integrals, projections, lines, and values of functions on both sides, as numbers."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import basix
import numpy as np
import numpy.typing as npt
import scipy.sparse
import scipy.sparse.linalg
from dolfinx import fem
from scipy.spatial import cKDTree

from forms.base import is_number
from geometry.errors import unknown
from geometry.inflating.parting import points_on_middle
from geometry.joint import Joint
from geometry.order import along, by_place
from geometry.seam import S
from geometry.topology import FACET_TYPES, IntArray, lagrange
from thinlayer.discretisation.contact_nodes import frames_at
from thinlayer.discretisation.mixed import MixedModel
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.pairs import pair_numbers
from thinlayer.discretisation.state import State, cell_values
from thinlayer.errors import ModelError
from thinlayer.output.lines import Line, Plane, lines_on, require_plane
from thinlayer.parallel.exchange import carry

Array = npt.NDArray[np.float64]
Where = Array | npt.NDArray[np.bool_] | Callable[[Array], Any]
ROUNDING = 1e-12  # of sums, relative


class Rule:
    """Points on the n facets of a surface, q on each.

    Attributes:
        points: (q, d - 1) in the reference facet.
        shapes: (q, k) values of the functions of degree 1 of the corners.
        x, n: (d, n, q) places, and unit normals from the lower to the upper side.
        weights: (n, q) of integrals over S, in axisymmetry over the whole revolution.
    """

    def __init__(self, surface: SurfaceMesh, points: Array, weights: Array) -> None:
        joint, nodes = surface.joint, surface.nodes_of_facets
        places = points_on_middle(joint)[nodes]
        self.points, self.shapes = points, lagrange(surface.kind, 1).tabulate(0, points)[0, :, :, 0]
        table = lagrange(surface.kind, joint.degree).tabulate(1, points)[..., 0]
        self.x = np.einsum("qa,fad->dfq", table[0], places)
        along = np.einsum("jqa,fad->jfqd", table[1:], places)
        across = np.stack([along[0, ..., 1], -along[0, ..., 0]], -1) if joint.dim == 2 else np.cross(*along)
        size = np.linalg.norm(across, axis=-1)
        up = joint.points[joint.corners[surface.cells[:, 1]]].mean(axis=1) - joint.points[surface.corners].mean(axis=1)
        sign = np.sign(np.einsum("fqd,fd->fq", across, up))
        self.n = np.moveaxis(across * (sign / size)[..., None], -1, 0)
        self.weights = weights * size * surface.model.kinematics.factor_at(np.moveaxis(self.x, 0, -1))


class SurfaceMesh:
    """S of a joint, or one of its seams, as a mesh of its own, whole on every rank.

    A field is an array with a value at each of q points of quadrature of each of n facets: (n, q), of vectors (d, n, q).
    One that is constant on facets is (n, 1), and (m,) values at the nodes stand for the field that is linear between them.
    A constant vector v is `np.reshape(v, (-1, 1, 1))` beside it: numpy would take a plain one along the points.

    Args:
        model: a model of the joint.
        seam: name of a seam; "S": all of them.

    Attributes:
        x, n: (d, n, q) places and unit normals, from the lower to the upper side.
        weights: (n, q) of integrals: areas, in axisymmetry of the whole revolution.
        rows: (n,) positions of the facets in `joint.surface_rows`.
        cells: (n, 2) numbers in the joint of the cells below (-1: a rigid base) and above.
        corners: (n, k) their vertices in the joint.
        seams: (n,) names of their seams.
        points: (q, d - 1) the points of quadrature in the reference facet.
        shapes: (q, k) values at the points of the functions of degree 1 of the corners.

    Raises:
        ModelError: no model, or an unknown seam.
    """

    def __init__(self, model: Model, seam: str = S) -> None:
        if not isinstance(model, Model):
            hint = ": give the state's model" if isinstance(model, State) else ""
            raise ModelError(f"Surface needs a model, not {model!r:.80}{hint}")
        if seam not in (S, *model.joint.seams):
            raise ModelError(unknown("seam", seam, model.joint.seams))
        self.model, self.seam = model.by_law if isinstance(model, MixedModel) else model, seam
        self.joint: Joint = self.model.domain.joint if self.model.broken else model.joint
        joint = self.joint
        self.kind = FACET_TYPES[joint.cell_type]
        self.rows: IntArray = np.searchsorted(joint.surface_rows, joint.rows_of(seam))
        self.cells, self.nodes_of_facets = joint.surface_cells[self.rows], joint.surface[self.rows]
        self.corners = self.nodes_of_facets[:, : joint.table.vertices.shape[1]]
        self.seams = np.array(list(joint.seams))[joint.seam_numbers[self.rows]]
        self._rules: dict[int, Rule] = {}
        self._rule = self.rule(2 * model.structure.degree + 2 * (joint.degree - 1) + model.kinematics.degree)
        self.x, self.n, self.weights = self._rule.x, self._rule.n, self._rule.weights
        self.points, self.shapes = self._rule.points, self._rule.shapes

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.model!r}, {self.seam!r})"

    def rule(self, degree: int) -> Rule:
        """The points of a quadrature rule."""
        if degree not in self._rules:
            self._rules[degree] = Rule(self, *basix.make_quadrature(basix.CellType[self.kind], degree))
        return self._rules[degree]

    def sides(self, f: fem.Function, model: Model, points: Array) -> Array:
        """(2, m, n, q) values of a function of a model, below and above, at points (q, d - 1) of each facet.

        A body's cell has one number in the joint, and one order of its degrees of freedom, in all models.
        """
        domain, many = model.domain, len(self.joint.cells)
        own = np.arange(domain.mesh.topology.index_map(self.joint.dim).size_local)
        own = own[domain.original_cells[own] < many]
        wanted, at = np.unique(self.cells, return_inverse=True)
        at, m = at.reshape(self.cells.shape), f.function_space.dofmap.bs
        there = carry(model.comm, domain.original_cells[own], cell_values(f, own), wanted[wanted >= 0])
        values = np.vstack([np.zeros(((wanted < 0).sum(), there.shape[1])), there]).reshape(len(wanted), -1, m)
        element = f.function_space.ufl_element().basix_element
        geometry = np.asarray(basix.geometry(basix.CellType[self.joint.cell_type]))
        shapes = lagrange(self.kind, 1).tabulate(0, points)[0, :, :, 0]
        out = np.zeros((2, m, len(self.rows), len(points)))
        for side, cells in enumerate(self.cells.T):
            local = (self.joint.corners[cells][:, None] == self.corners[..., None]).argmax(axis=2)
            kinds, kind = np.unique(local, axis=0, return_inverse=True)
            for k, corners in enumerate(kinds):  # ways in which a facet lies in its cell
                here = np.flatnonzero((kind.ravel() == k) & (cells >= 0))
                table = element.tabulate(0, shapes @ geometry[corners])[0, :, :, 0]
                out[side][:, here] = np.einsum("qa,fam->mfq", table, values[at[here, side]])
        return out

    # ---------------------------------------------------------------- integrals
    def _field(self, f: Any) -> Array:
        """(..., n, q) a field; raises ModelError."""
        try:
            values = np.asarray(f, float)
            if values.shape == (len(self.numbers),):
                values = self.at_points(values)
            if values.ndim and values.shape[-2:] not in ((len(self.rows), 1), self.weights.shape):
                raise ValueError
            return np.broadcast_to(values, (*values.shape[:-2], *self.weights.shape))
        except (TypeError, ValueError):
            raise ModelError(
                f"{f!r:.80} is no field on S; give an array (..., n, q) = (..., {str(self.weights.shape)[1:]}, "
                "as surface.jump(state) or surface.x[0] is, (n, 1) of facets, or values at the nodes"
            ) from None

    def where(self, part: Where | float) -> Array:
        """(n, q) weights of a part of S: of a field, or a numpy function of places x (d, n, q).

        Raises:
            ModelError: neither.
        """
        try:
            return self._field(part(self.x) if callable(part) else part)
        except Exception as error:
            raise ModelError(
                f"where is no numpy function of coordinates, as lambda x: x[0] > 1 or lambda x: (x[0] > 1) & (x[0] < 9): "
                f"{error}"
            ) from error

    def integral(self, f: Any) -> Any:
        """Integral over S of a field: a float, of vectors an array (d,)."""
        total = (self._field(f) * self.weights).sum(axis=(-2, -1))
        return total if total.ndim else float(total)

    def norm(self, f: Any, where: Where | float = 1.0) -> float:
        """L2 norm over S of a field, weighted with `where`."""
        return float(np.sqrt((self._field(f) ** 2 * self.where(where) * self.weights).sum()))

    def frame(self, f: Any) -> Array:
        """(d, n, q) a vector field in the frame of S: tangential components, then the normal one.

        The tangents are those of `forms.kinematics.layer_frame`: (n_2, -n_1) in 2D, its first and third axis in 3D.
        """
        f, n = self._field(f), self.n
        if f.shape != n.shape:
            raise ModelError(f"frame needs a vector field, of shape {n.shape}, not {f.shape}")
        axes = frames_at(np.moveaxis(n, 0, -1).reshape(-1, len(n))).reshape(*self.weights.shape, len(n), len(n))
        return np.einsum("fqij,jfq->ifq", axes, f)

    # ---------------------------------------------------------------- nodes
    @cached_property
    def _numbered(self) -> tuple[IntArray, IntArray, IntArray]:
        """`numbers`, `vertices` and `nodes`."""
        of_table = self.joint.table.vertices[self.joint.surface_rows[self.rows]]
        at = (of_table[:, None] == self.corners[..., None]).argmax(axis=2)
        codes = np.take_along_axis(pair_numbers(self.joint)[self.rows], at, axis=1)
        numbers, first, nodes = np.unique(codes, return_index=True, return_inverse=True)
        vertices, nodes = self.joint.masters[self.corners].ravel()[first], nodes.reshape(codes.shape)
        x, size = self.joint.points[vertices], float(np.ptp(self.joint.points, axis=0).max())
        order = along(x, nodes, size) if self.joint.dim == 2 else by_place(x, size)
        return numbers[order], vertices[order], np.argsort(order)[nodes]

    @property
    def numbers(self) -> IntArray:
        """(m,) numbers of the nodes (`pair_numbers`): where seams meet, one for each pair of bodies at a vertex.

        In order along S in 2D, piece after piece, else by the coordinates; each piece of S has one pair at each vertex.
        """
        return self._numbered[0]

    @property
    def places(self) -> Array:
        """(m, d) places of the nodes."""
        return self.joint.points[self.vertices]

    @property
    def vertices(self) -> IntArray:
        """(m,) vertices of the joint at the nodes, of those that periodic sides identify the first one."""
        return self._numbered[1]

    @property
    def nodes(self) -> IntArray:
        """(n, k) position in `numbers` of the node at each corner."""
        return self._numbered[2]

    def find(self, numbers: IntArray) -> IntArray:
        """Positions of nodes with these numbers."""
        order = np.argsort(self.numbers)
        return order[np.searchsorted(self.numbers[order], numbers)]

    @cached_property
    def mass(self) -> scipy.sparse.csc_matrix:
        """(m, m) mass matrix of the functions of degree 1."""
        M = np.einsum("fq,qa,qb->fab", self.weights, self.shapes, self.shapes)
        rows, columns = np.broadcast_arrays(self.nodes[:, :, None], self.nodes[:, None])
        return scipy.sparse.csc_matrix((M.ravel(), (rows.ravel(), columns.ravel())), shape=(len(self.numbers),) * 2)

    def sums(self, of_corners: Array) -> Array:
        """(m, ...) sums at the nodes of values (n, k, ...) at the corners of facets."""
        out = np.zeros((len(self.numbers), *of_corners.shape[2:]))
        np.add.at(out, self.nodes, of_corners)
        return out

    def projected(self, moments: Array) -> Array:
        """(m, ...) nodal values of moments (n, k, ...), integrals with the functions of degree 1."""
        sums = self.sums(moments)
        return np.asarray(self._solver(sums.reshape(len(sums), -1))).reshape(sums.shape)

    def lumped(self, moments: Array) -> Array:
        """(m, ...) the same over the areas around nodes, as contact laws define tractions."""
        return np.asarray((self.sums(moments).T / self.areas).T)

    @cached_property
    def areas(self) -> Array:
        """(m,) areas of S around the nodes."""
        return self.sums(self.weights @ self.shapes)

    @cached_property
    def _solver(self) -> Callable[[Array], Array]:
        solve: Callable[[Array], Array] = scipy.sparse.linalg.splu(self.mass).solve
        return solve

    def nodal(self, f: Any) -> Array:
        """(m,) or (m, d): the L2 projection of a field to degree 1, at the nodes (`numbers`, `places`)."""
        return self.projected(np.einsum("fq,qa,...fq->fa...", self.weights, self.shapes, self._field(f)))

    def at_points(self, nodal: Array) -> Array:
        """(n, q) or (d, n, q) field of nodal values (m,) or (m, d)."""
        return np.asarray(np.einsum("qa,fa...->...fq", self.shapes, nodal[self.nodes]))

    def profile(self, f: Any) -> tuple[Array, Array]:
        """Places (m, d) and values (m,) or (m, d) of a field, projected to degree 1, at the nodes (`numbers`)."""
        return self.places, self.nodal(f)

    def along(self, f: Any, *, plane: Plane | None = None) -> list[Line]:
        """Values of a field along the lines of S, by arc length: steps where it is constant on facets, else of degree 1.

        In 2D a line is a piece of a seam: it ends where the seam ends, branches or crosses itself. In 3D it is where a
        plane cuts a seam. Lines are ordered by seam, then by the place at which they start, the lower one of their ends by
        the first coordinate, then by the next ones; a closed line starts at its lowest place and goes towards the lower of
        its neighbours. Where values jump, as where another seam meets a line, there are two rows of one s.

        Args:
            f: the field.
            plane: in 3D a point of the plane and its normal, ((x, y, z), (n_x, n_y, n_z)).

        Raises:
            ModelError: no field; a plane in 2D, none in 3D, one that does not cut S.
        """
        joint, values, found = self.joint, self.at_corners(f), list[Line]()
        require_plane(plane, joint.dim)
        rows = joint.surface_rows[self.rows]
        at = (self.corners[:, None] == joint.table.vertices[rows][..., None]).argmax(axis=2)
        values = np.take_along_axis(values, at.reshape(*at.shape, *[1] * (values.ndim - 2)), axis=1)
        for name in dict.fromkeys(self.seams.tolist()):
            mine = self.seams == name
            found += lines_on(joint, name, rows[mine], values[mine], plane)
        if not found:
            raise ModelError(f"the plane {plane!r} does not cut S")
        return found

    def at_corners(self, f: Any) -> Array:
        """(n, k) or (n, k, d) values of a field at the corners of facets."""
        values = self._field(f)
        if np.shape(f) == (len(self.numbers),):
            return np.asarray(f, float)[self.nodes]
        if np.shape(f)[-2:] == (len(self.rows), 1):
            return np.stack([np.moveaxis(values[..., 0], -1, 0)] * self.nodes.shape[1], axis=1)
        return self.nodal(values)[self.nodes]

    # ---------------------------------------------------------------- parts of S
    def most_of(self, f: Any, all_but: float, *, margin: float = 0.0) -> npt.NDArray[np.bool_]:
        """(n_S,) the fewest facets of S that hold the integral of |f| but for a share, for `Structure.mixed`.

        Args:
            f: scalar field, such as `Estimate.density` gives.
            all_but: the share that the others may hold, from 0 to less than 1.
            margin: length by which the part of S that is chosen is made wider.

        Raises:
            ModelError: a number out of range; an integral that is zero, or not finite; where seams meet.
        """
        if not is_number(margin) or not 0 <= margin < np.inf:
            raise ModelError(f"margin is {margin!r}; it must be a length >= 0")
        if self.joint.seams_meet:
            raise ModelError("most_of needs seams that do not meet, as mixed models do")
        joint, sums = self.joint, np.zeros(len(self.joint.surface_rows))
        sums[self.rows] = (np.abs(self._field(f)) * self.weights).sum(axis=1)
        chosen = most_of(sums, all_but)
        vertices = joint.table.vertices[joint.surface_rows]
        near, _ = cKDTree(joint.points[np.unique(vertices[chosen])]).query(joint.points[vertices].mean(axis=1))
        return np.asarray(chosen | (near < margin))


def most_of(sums: Array, all_but: float) -> npt.NDArray[np.bool_]:
    """The fewest values >= 0 whose sum is that of all but for a share.

    Raises:
        ModelError: a share out of range; values that are not finite, or all zero.
    """
    if not is_number(all_but) or not 0 <= all_but < 1:
        raise ModelError(f"all_but is {all_but!r}, a share of an integral; allowed: from 0 to less than 1")
    total = float(sums.sum())
    if not (np.isfinite(total) and total > 0):
        raise ModelError(f"the integral over S is {total:g}; nothing tells one part of S from another")
    order = np.argsort(-sums, kind="stable")
    left = total - np.cumsum(sums[order])
    chosen = np.zeros(len(sums), bool)
    chosen[order[: int(np.argmax(left <= (all_but + ROUNDING) * total)) + 1]] = True
    return chosen
