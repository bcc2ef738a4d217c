"""Quadrature points of a law on the domain of a UFL measure; assembly of matrices and nodal forces."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import basix.ufl
import dolfinx.fem.petsc
import dolfinx.mesh
import numpy as np
import ufl
from dolfinx import fem, la
from dolfinx.mesh import CellType, Mesh
from mpi4py import MPI
from petsc4py import PETSc
from ufl.classes import Zero

from forms.base import Array, InputError
from forms.tensors import MANDEL_PAIRS, Expr, three_dimensional
from forms.work import Term
from geometry.domain import create_connectivity
from geometry.topology import Indices, IntArray
from thinlayer.pointwise.columns import Columns
from thinlayer.system.compat import EntityMaps, compiled, create_submesh
from thinlayer.system.ranks import communicator

DIAGONAL_MANDEL_INDICES = (0, 1, 2)  # Mandel components whose sum is the trace
MEASURE_NAMES = {"cell": "dx", "exterior_facet": "ds", "interior_facet": "dS"}


@dataclass(frozen=True, eq=False)
class MeshOrigin:
    """Relation of a model's mesh to the joint from which it was made; d: number of dimensions.

    The joint is the undistributed mesh as drawn, in which S is not yet opened to the layer's thickness.

    Attributes:
        comm: communicator for the sums and messages of laws at quadrature points.
        x: (d,) UFL coordinates in the joint as drawn.
        to_joint: function (topological dimension, local numbers of cells or facets) -> their numbers in the joint.
        get_columns: function without arguments that returns two arrays about the layer's columns, the cells above
            each other through the thickness. The first has the number of the column of each cell (-1 outside the
            layer), or of each facet. The second has the centres (columns, d) of the columns.
        x_on_s: (d,) UFL coordinates on S in the joint as drawn, to be restricted to a side; None: S lies on facets of
            the mesh, and `x` is used.
        middle_points: (n_points, d) coordinates of the mesh's points, where points of S are moved midway between its
            sides; None: S lies on facets of the mesh.
    """

    comm: MPI.Intracomm
    x: Expr
    to_joint: Callable[[int, Indices], IntArray]
    get_columns: Callable[[], tuple[IntArray, Array]]
    x_on_s: Expr | None = None
    middle_points: Array | None = None


class MeasureRegion:
    """Submesh of the cells or facets over which a UFL measure integrates. Collective.

    Attributes:
        measure: the measure dx, ds or dS, on all cells or facets or on those with some tags.
        parent_mesh: the whole mesh.
        mesh: submesh of the cells or facets of the measure, ghosts included.
        dim: topological dimension of the submesh.
        indices: local numbers, in `parent_mesh`, of the cells or facets that are the cells of `mesh`.
        entity_maps: entity maps of the submesh, for compiling forms.

    Raises:
        InputError: the measure is not dx, ds or dS, or it selects tags but has no subdomain data.
    """

    def __init__(self, mesh: Mesh, measure: ufl.Measure) -> None:
        if measure.integral_type() not in MEASURE_NAMES:
            raise InputError(f"a law has a measure of type {measure.integral_type()!r}; allowed: dx, ds, dS")
        self.measure, self.parent_mesh = measure, mesh
        self.dim = mesh.topology.dim - (measure.integral_type() != "cell")
        self.mesh, self.entity_maps, self.indices = create_submesh(mesh, self.dim, _measured_entities(mesh, measure))

    def move_nodes(self, new_x: Array) -> None:
        """Move the nodes of the submesh to other coordinates, for S for instance to those midway between its sides.

        Args:
            new_x: (n, d) new coordinates for all n points of the undistributed mesh; d: number of dimensions.
        """
        geometry = self.mesh.geometry
        geometry.x[:, : new_x.shape[1]] = new_x[np.asarray(geometry.input_global_indices, np.int64)]

    def compiled(self, form: Expr) -> fem.Form:
        """Compile the UFL `form`, whose functions may be defined on `mesh` and on `parent_mesh`."""
        return compiled(form, self.entity_maps)

    def plus_side(self, f: Expr) -> Expr:
        """Return `f` restricted to the side "+" if the measure is dS, otherwise `f` itself.

        A function on the submesh has the same values on both sides, so that the choice does not matter.
        """
        return f("+") if self.measure.integral_type() == "interior_facet" else f


def _measured_entities(mesh: Mesh, measure: ufl.Measure) -> Indices:
    """Return the local numbers of the cells or facets over which `measure` integrates, ascending. Collective.

    Ghosts are included.
    """
    kind, data, topology = measure.integral_type(), measure.subdomain_data(), mesh.topology
    dim = topology.dim - (kind != "cell")
    create_connectivity(mesh, dim)
    imap, tag_ids = topology.index_map(dim), np.atleast_1d(np.asarray(measure.subdomain_id(), object))
    if "everywhere" in tag_ids:
        entities: Indices = np.arange(imap.size_local, dtype=np.int32)
        if kind != "cell":
            outer_facets = np.asarray(dolfinx.mesh.exterior_facet_indices(topology))
            entities = outer_facets if kind == "exterior_facet" else np.setdiff1d(entities, outer_facets)
    elif data is None:
        name, tags = MEASURE_NAMES[kind], ", ".join(map(str, tag_ids))
        raise InputError(f"the measure {name}({tags}) has no tags; give {name} its subdomain_data")
    elif hasattr(data, "indices"):
        entities = data.indices[np.isin(data.values, tag_ids.astype(int))]
    else:
        tagged_entities = [np.asarray(entities, np.int32).ravel() for tag, entities in data if tag in tag_ids]
        entities = np.concatenate([np.empty(0, np.int32), *tagged_entities])
        if kind != "cell":
            cell, facet = entities.reshape(-1, 2)[:: 2 if kind == "interior_facet" else 1].T
            to_facets = topology.connectivity(topology.dim, dim)
            entities = to_facets.array[to_facets.offsets[cell] + facet]
    marks = la.vector(imap, dtype=np.int8)
    marks.array[entities[entities < imap.size_local]] = 1
    marks.scatter_forward()
    return np.flatnonzero(marks.array).astype(np.int32)


def quadrature_degree(V: fem.FunctionSpace, measure: ufl.Measure) -> int:
    """Return the quadrature degree for the virtual work of laws of displacements in `V`.

    It is exact for linear laws on straight triangles and tetrahedra, and is raised on curved cells. Quadrilaterals and
    hexahedra get one more point per direction. UFL's own estimate sums the degrees of all directions and of the
    geometry. It needs many times more points and gains no accuracy.

    Args:
        V: space of the displacements.
        measure: measure of the virtual work.
    """
    mesh = V.mesh
    degree = V.ufl_element().basix_element.degree
    geometry_degree = 2 * (mesh.ufl_domain().ufl_coordinate_element().basix_element.degree - 1)
    if mesh.topology.cell_type in (CellType.quadrilateral, CellType.hexahedron):
        return int(2 * degree + 1 + geometry_degree)
    return int((2 * degree - 1 if measure.integral_type() == "cell" else 2 * degree) + geometry_degree)


class Quadrature:
    """Quadrature points of one law on the domain of its measure; d: number of dimensions. Collective.

    Attributes:
        term: virtual work of the law, with its strain, weight and measure.
        region: submesh of the cells or facets of the measure.
        dim: number d of dimensions.
        origin: relation of the mesh to the joint, the undistributed mesh from which it was made; None: there is no
            joint.
        comm: communicator of the ranks.
        degree: quadrature degree. It is that of the measure; if the measure has none, `quadrature_degree` plus the
            degree that the kinematics add, as in axisymmetry.
        measure: the term's measure with this degree.
        count: number of points of this rank.
        cells: (cells, k) numbers of the k points in each cell of the region that this rank owns.
        x: (points, d) coordinates of the points.
        n: (points, 3) unit normal of the layer (director); NaN in bodies.
        weights: (points,) quadrature weights of integrals over cells or S, times the term's weight.
    """

    def __init__(self, V: fem.FunctionSpace, term: Term, origin: MeshOrigin | None = None) -> None:
        self.term, self.origin = term, origin
        metadata = dict(term.measure.metadata())
        degree = quadrature_degree(V, term.measure) + term.kinematics.factor_degree
        self.degree = metadata.setdefault("quadrature_degree", degree)
        self.region, self.dim = MeasureRegion(V.mesh, term.measure), int(V.mesh.geometry.dim)
        self.comm = origin.comm if origin else communicator(V.mesh)
        self.measure = term.measure.reconstruct(metadata=metadata)
        self._spaces: dict[int, fem.FunctionSpace] = {}
        W, mesh, parent = self._space((5 + self.dim,)), self.region.mesh, self.region.parent_mesh
        self.count = W.dofmap.index_map.size_local
        self.cells = np.asarray(W.dofmap.list)[: mesh.topology.index_map(mesh.topology.dim).size_local]
        q, x = (self.region.plus_side(f) for f in (ufl.TestFunction(W), ufl.SpatialCoordinate(parent)))
        n = three_dimensional(term.n) if term.n is not None else ufl.zero(3)
        integrand = ufl.as_vector([n[0], n[1], n[2], 1, term.weight, *(x[i] for i in range(self.dim))])
        integrals = self._assemble_at_points(integrand, q)
        self._measure_weights, self.weights = integrals[:, 3].copy(), integrals[:, 4].copy()
        self.n, self.x = (integrals[:, components] / integrals[:, 3:4] for components in (slice(0, 3), slice(5, None)))
        if term.n is None:
            self.n[:] = np.nan

    @cached_property
    def mandel(self) -> list[int]:
        """Positions of those Mandel components, ascending, that strains may have here; the others are zero."""
        e_0, strain_indices = self.term.prescribed_strain, self.term.kinematics.strain_indices(self.dim)
        if self.term.bbar_degree is not None:
            strain_indices = (*strain_indices, *DIAGONAL_MANDEL_INDICES)
        e_0_indices = [k for k, pair in enumerate(MANDEL_PAIRS) if e_0 is not None and not isinstance(e_0[pair], Zero)]
        return sorted({*strain_indices, *e_0_indices})

    def _space(self, shape: tuple[int, ...], mesh: Mesh | None = None) -> fem.FunctionSpace:
        mesh = mesh or self.region.mesh
        element = basix.ufl.quadrature_element(mesh.basix_cell(), value_shape=shape, degree=self.degree)
        return fem.functionspace(mesh, element)

    def _assemble_at_points(self, integrand: Expr, q: Expr) -> Array:
        """Return the values (points, m) of a UFL vector at the points, times the quadrature weights.

        Args:
            integrand: the UFL vector (m,).
            q: test function (m,) with one degree of freedom for each component at each point.
        """
        form = self.region.compiled(ufl.inner(integrand, q) * self.measure)
        return np.asarray(fem.assemble_vector(form).array.reshape(-1, q.ufl_shape[0])[: self.count])

    def values(self, f: Expr) -> Array:
        """Return the values (points, m) of the UFL vector `f` (m,) at the points. Collective.

        If the measure is dS, the functions in `f` must be restricted to a side.
        """
        q = self.region.plus_side(ufl.TestFunction(self._space(f.ufl_shape)))
        return self._assemble_at_points(f, q) / self._measure_weights[:, None]

    def cell_means(self, values: Array) -> Array:
        """Return the means (cells, ...) of `values` (points, ...) over each cell of `region` that this rank owns.

        Points are weighted by `weights`.
        """
        cell_values, weights = values[self.cells], self.weights[self.cells]
        cell_weights = weights.sum(axis=1).reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray(np.einsum("cp,cp...->c...", weights, cell_values) / cell_weights)

    @cached_property
    def joint_x(self) -> Array:
        """Coordinates (d, points) of the points in the joint as drawn, before S is opened to the layer's thickness.

        If there is no joint, they are the coordinates in the mesh.
        """
        on_s = self.origin.x_on_s if self.origin and self.region.dim < self.dim else None
        x = on_s if on_s is not None or self.origin is None else self.origin.x
        in_mesh = x is None or isinstance(x, ufl.SpatialCoordinate)
        return np.ascontiguousarray((self.x if in_mesh else self.values(self.region.plus_side(x))).T)

    def mesh_function(self, values: Array) -> fem.Function:
        """Return a function (m,) on the whole mesh that has `values` (points, m) at the points, and is zero elsewhere.

        It can be integrated with `measure`, which must be over cells.
        """
        n_components = values.shape[1]
        if n_components not in self._spaces:
            self._spaces[n_components] = self._space((n_components,), self.region.parent_mesh)
        f = fem.Function(self._spaces[n_components])
        points = np.asarray(f.function_space.dofmap.list)[self.region.indices[: len(self.cells)]]
        f.x.array.reshape(-1, n_components)[points] = values[self.cells]
        f.x.scatter_forward()
        return f

    def region_function(self, values: Array) -> fem.Function:
        """Return a function on the mesh of the region with `values`, (points,) or (points, m), at the points. Collective.

        It can be integrated with measures of the quadrature degree `degree`.
        """
        return set_owned_values(fem.Function(self._space(values.shape[1:])), values.ravel())

    @cached_property
    def entity_numbers(self) -> IntArray:
        """Numbers (cells,), in the joint, of the cells or facets of `region` that this rank owns."""
        assert self.origin is not None, "a mesh without a joint"
        return self.origin.to_joint(self.region.dim, self.region.indices[: len(self.cells)])

    @cached_property
    def columns(self) -> Columns:
        """Columns of the layer, with the points in each: the cells above each other through the thickness.

        On S each facet is a column.

        Raises:
            InputError: the law acts in the cells of a layer, but there is no `origin` that knows the columns.
        """
        if self.origin:
            numbers, centres = self.origin.get_columns()
            columns = numbers[self.entity_numbers]
            has_points = np.zeros(len(centres), np.int8)
            has_points[columns] = 1
            self.comm.Allreduce(MPI.IN_PLACE, has_points, MPI.MAX)  # columns of other seams have no points of this law
            columns, n_columns = (np.cumsum(has_points, dtype=np.int64) - 1)[columns], int(has_points.sum())
        elif self.measure.integral_type() == "cell":
            raise InputError(f"{type(self.term.law).__name__} has phases in columns, which layers of other meshes lack")
        else:
            imap = self.region.mesh.topology.index_map(self.region.dim)
            columns, n_columns = np.arange(imap.size_local, dtype=np.int64) + imap.local_range[0], int(imap.size_global)
        point_columns = np.empty(self.count, np.int64)
        point_columns[self.cells] = columns[:, None]
        return Columns(self.comm, point_columns, n_columns, self.weights)


def assemble_matrix(form: fem.Form) -> PETSc.Mat:
    """Assemble the matrix of the bilinear `form`; no rows or columns are changed for supports."""
    pattern = fem.create_sparsity_pattern(form)
    pattern.finalize()
    dolfinx_matrix = dolfinx.cpp.la.petsc.create_matrix(communicator(form.mesh), pattern)
    A = copy(dolfinx_matrix)
    dolfinx_matrix.destroy()  # DOLFINx keeps a surplus reference, so that only the copy can be freed
    dolfinx.fem.petsc.assemble_matrix(A, form)
    A.assemble()
    return A


def assemble_forces(first: fem.Form, *others: fem.Form) -> PETSc.Vec:
    """Assemble the sum of linear forms as a vector of nodal forces, which the caller destroys."""
    b = dolfinx.fem.petsc.assemble_vector(first)
    for form in others:
        dolfinx.fem.petsc.assemble_vector(b, form)
    b.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
    return b


def add_assembled_forces(out: PETSc.Vec, *forms: fem.Form) -> float:
    """Add the nodal forces of the linear `forms` to the vector `out`, and return the norm of their sum."""
    b = assemble_forces(*forms)
    out.axpy(1.0, b)
    force_norm = float(b.norm())
    b.destroy()
    return force_norm


def set_owned_values(f: fem.Function, values: Array) -> fem.Function:
    """Set the dofs of `f` that this rank owns to `values`, update the ghosts of `f`, and return it. Collective."""
    f.x.array[: len(values)] = values
    f.x.scatter_forward()
    return f


def assemble_values(form: fem.Form | None, count: int) -> Array:
    """Assemble the linear `form`, and return its values (count,) at the dofs that this rank owns.

    They are zeros if `form` is None.
    """
    if form is None:
        return np.zeros(count)
    b = assemble_forces(form)
    values = np.array(b.array_r)
    b.destroy()
    return values


def add_integral_to_nodes(
    density: Expr, V: fem.FunctionSpace, measure: ufl.Measure, b: PETSc.Vec, maps: EntityMaps | None = None
) -> None:
    """Add the integral of a density to a vector, distributed to the nodes by their shape functions.

    A node's contribution is added to the first component at the node. On S the shape functions are those of the upper
    side. As they add up to one, all contributions add up to the integral.

    Args:
        density: UFL scalar, restricted to a side if the measure is dS.
        V: space of the displacements.
        measure: measure of the integral.
        b: vector of V to which the integral is added.
        maps: entity maps for functions on submeshes; None: there are no such functions.
    """
    v = ufl.TestFunction(V)
    shape_function = v("+")[0] if measure.integral_type() == "interior_facet" else v[0]
    add_assembled_forces(b, compiled(density * shape_function * measure, maps))
