"""Quadrature points of one law in a UFL measure; assembly of matrices and nodal forces."""

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

TRACE_SLOTS = (0, 1, 2)  # Mandel components whose sum is the trace
MEASURE_OF_INTEGRAL = {"cell": "dx", "exterior_facet": "ds", "interior_facet": "dS"}


@dataclass(frozen=True, eq=False)
class MeshOrigin:
    """Relation of a mesh to the joint it was made from, before inflating and distributing.

    Attributes:
        comm: communicator for messages of the terms.
        x: (d,) UFL coordinates in the joint.
        numbers: function (dimension, local cells or facets) -> their numbers in the joint.
        columns: function that returns the column of each cell (-1 outside the layer) or facet of the joint, and the
            centres (columns, d) of the columns.
        x_on_s: (d,) UFL coordinates on S in the joint, to be restricted to a side; None: S lies on the facets of the
            mesh, and `x` is used.
        middle: (n_points, d) coordinates of the joint's points; points on S are midway between its sides.
    """

    comm: MPI.Intracomm
    x: Expr
    numbers: Callable[[int, Indices], IntArray]
    columns: Callable[[], tuple[IntArray, Array]]
    x_on_s: Expr | None = None
    middle: Array | None = None


class MeasureRegion:
    """The part of a mesh over which a measure integrates, as a submesh. Collective.

    Attributes:
        measure: dx, ds or dS, on all entities or on entities with some tags.
        parent_mesh: the whole mesh.
        mesh: submesh of the cells or facets of the measure, ghosts included.
        dim: topological dimension of the submesh.
        parent: local number in `parent_mesh` of each cell of `mesh`.
        maps: entity maps of the submesh, for forms.

    Raises:
        InputError: a measure of another kind, or a measure that selects tags but has no subdomain data.
    """

    def __init__(self, mesh: Mesh, measure: ufl.Measure) -> None:
        if measure.integral_type() not in MEASURE_OF_INTEGRAL:
            raise InputError(f"a law has a measure of type {measure.integral_type()!r}; allowed: dx, ds, dS")
        self.measure, self.parent_mesh = measure, mesh
        self.dim = mesh.topology.dim - (measure.integral_type() != "cell")
        self.mesh, self.maps, self.parent = create_submesh(mesh, self.dim, _entities(mesh, measure))

    def move(self, places: Array) -> None:
        """Move the nodes of a submesh of S, whose sides may be distant, to `places` (n, d) of the joint's points."""
        geometry = self.mesh.geometry
        geometry.x[:, : places.shape[1]] = places[np.asarray(geometry.input_global_indices, np.int64)]

    def compiled(self, form: Expr) -> fem.Form:
        """Compile a UFL form with functions on `mesh` and on `parent_mesh`."""
        return compiled(form, self.maps)

    def side(self, f: Expr) -> Expr:
        """A function on `mesh`, restricted as integrands of the measure require."""
        return f("+") if self.measure.integral_type() == "interior_facet" else f


def _entities(mesh: Mesh, measure: ufl.Measure) -> Indices:
    """Local cells or facets over which a measure integrates, ghosts included, sorted. Collective."""
    kind, data, topology = measure.integral_type(), measure.subdomain_data(), mesh.topology
    dim = topology.dim - (kind != "cell")
    create_connectivity(mesh, dim)
    imap, ids = topology.index_map(dim), np.atleast_1d(np.asarray(measure.subdomain_id(), object))
    if "everywhere" in ids:
        entities: Indices = np.arange(imap.size_local, dtype=np.int32)
        if kind != "cell":
            outer = np.asarray(dolfinx.mesh.exterior_facet_indices(topology))
            entities = outer if kind == "exterior_facet" else np.setdiff1d(entities, outer)
    elif data is None:
        name, tags = MEASURE_OF_INTEGRAL[kind], ", ".join(map(str, ids))
        raise InputError(f"the measure {name}({tags}) has no tags; give {name} its subdomain_data")
    elif hasattr(data, "indices"):
        entities = data.indices[np.isin(data.values, ids.astype(int))]
    else:
        rows = [np.asarray(entities, np.int32).ravel() for tag, entities in data if tag in ids]
        entities = np.concatenate([np.empty(0, np.int32), *rows])
        if kind != "cell":
            cell, facet = entities.reshape(-1, 2)[:: 2 if kind == "interior_facet" else 1].T
            to_facets = topology.connectivity(topology.dim, dim)
            entities = to_facets.array[to_facets.offsets[cell] + facet]
    marks = la.vector(imap, dtype=np.int8)
    marks.array[entities[entities < imap.size_local]] = 1
    marks.scatter_forward()
    return np.flatnonzero(marks.array).astype(np.int32)


def quadrature_degree(V: fem.FunctionSpace, measure: ufl.Measure) -> int:
    """Quadrature degree for laws of displacements in V: exact on straight cells, higher on curved cells.

    Quadrilaterals and hexahedra get one more point per direction. UFL would sum the degrees of all directions and of
    the geometry, which needs many times more points without a gain in accuracy.
    """
    mesh = V.mesh
    degree = V.ufl_element().basix_element.degree
    curved = 2 * (mesh.ufl_domain().ufl_coordinate_element().basix_element.degree - 1)
    if mesh.topology.cell_type in (CellType.quadrilateral, CellType.hexahedron):
        return int(2 * degree + 1 + curved)
    return int((2 * degree - 1 if measure.integral_type() == "cell" else 2 * degree) + curved)


class Quadrature:
    """Quadrature points of a term. Collective.

    Attributes:
        term: the law, its strain, weight and measure.
        region: the cells or facets of the measure.
        origin: relation of the mesh to its joint; None: no joint.
        comm: communicator for messages.
        degree: quadrature degree of the measure; if it has no degree, from `quadrature_degree` and the kinematics.
        measure: the term's measure with this degree.
        count: number of points of this rank.
        cells: (cells, points per cell) numbers of the points in the cells of the region that this rank owns.
        x: (points, d) coordinates of the points.
        n: (points, 3) director; NaN in bodies, which have no director.
        weights: (points,) quadrature weights.
    """

    def __init__(self, V: fem.FunctionSpace, term: Term, origin: MeshOrigin | None = None) -> None:
        self.term, self.origin = term, origin
        metadata = dict(term.measure.metadata())
        degree = quadrature_degree(V, term.measure) + term.kinematics.degree
        self.degree = metadata.setdefault("quadrature_degree", degree)
        self.region = MeasureRegion(V.mesh, term.measure)
        self.comm = origin.comm if origin else communicator(V.mesh)
        self.measure = term.measure.reconstruct(metadata=metadata)
        self._functions: dict[int, fem.FunctionSpace] = {}
        W, mesh, parent = self._space((5 + self.dim,)), self.region.mesh, self.region.parent_mesh
        self.count = W.dofmap.index_map.size_local
        self.cells = np.asarray(W.dofmap.list)[: mesh.topology.index_map(mesh.topology.dim).size_local]
        q, x = (self.region.side(f) for f in (ufl.TestFunction(W), ufl.SpatialCoordinate(parent)))
        n = three_dimensional(term.n) if term.n is not None else ufl.zero(3)
        rows = ufl.as_vector([n[0], n[1], n[2], 1, term.weight, *(x[i] for i in range(self.dim))])
        values = self._integrated(rows, q)
        self._integrals, self.weights = values[:, 3].copy(), values[:, 4].copy()
        self.n, self.x = (values[:, part] / values[:, 3:4] for part in (slice(0, 3), slice(5, None)))
        if term.n is None:
            self.n[:] = np.nan

    @property
    def dim(self) -> int:
        """Number of coordinates."""
        return int(self.region.parent_mesh.geometry.dim)

    @cached_property
    def slots(self) -> list[int]:
        """Mandel components that strains may have here; the others are zero."""
        e_0, of_strains = self.term.prescribed_strain, self.term.kinematics.slots(self.dim)
        if self.term.volume is not None:
            of_strains = (*of_strains, *TRACE_SLOTS)
        of_e_0 = [k for k, pair in enumerate(MANDEL_PAIRS) if e_0 is not None and not isinstance(e_0[pair], Zero)]
        return sorted({*of_strains, *of_e_0})

    def _space(self, shape: tuple[int, ...], mesh: Mesh | None = None) -> fem.FunctionSpace:
        mesh = mesh or self.region.mesh
        element = basix.ufl.quadrature_element(mesh.basix_cell(), value_shape=shape, degree=self.degree)
        return fem.functionspace(mesh, element)

    def _integrated(self, rows: Expr, q: Expr) -> Array:
        """Values of m functions at the points, times the quadrature weights, (points, m)."""
        form = self.region.compiled(ufl.inner(rows, q) * self.measure)
        return np.asarray(fem.assemble_vector(form).array.reshape(-1, q.ufl_shape[0])[: self.count])

    def values(self, f: Expr) -> Array:
        """Values (points, m) of a vector expression (m,), which is restricted as the measure requires. Collective."""
        q = self.region.side(ufl.TestFunction(self._space(f.ufl_shape)))
        return self._integrated(f, q) / self._integrals[:, None]

    def means(self, values: Array) -> Array:
        """Means (cells, ...) of values (points, ...) over each cell or facet of the region that this rank owns."""
        of_cells, weights = values[self.cells], self.weights[self.cells]
        whole = weights.sum(axis=1).reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray(np.einsum("cp,cp...->c...", weights, of_cells) / whole)

    @cached_property
    def joint_x(self) -> Array:
        """Coordinates (d, points) of the points in the joint before inflating; without a joint in the mesh."""
        on_s = self.origin.x_on_s if self.origin and self.region.dim < self.dim else None
        x = on_s if on_s is not None or self.origin is None else self.origin.x
        is_here = x is None or isinstance(x, ufl.SpatialCoordinate)
        return np.ascontiguousarray((self.x if is_here else self.values(self.region.side(x))).T)

    def function(self, values: Array) -> fem.Function:
        """Function (m,) on the whole mesh, for `measure`, with `values` (points, m) in cells and zero elsewhere."""
        width = values.shape[1]
        if width not in self._functions:
            self._functions[width] = self._space((width,), self.region.parent_mesh)
        f = fem.Function(self._functions[width])
        points = np.asarray(f.function_space.dofmap.list)[self.region.parent[: len(self.cells)]]
        f.x.array.reshape(-1, width)[points] = values[self.cells]
        f.x.scatter_forward()
        return f

    def at_points(self, values: Array) -> fem.Function:
        """Function on the region's mesh with values (n,) at the points, for measures of this degree. Collective."""
        return set_owned_values(fem.Function(self._space(())), values)

    @property
    def original(self) -> IntArray:
        """Number in the joint of the cell or facet that each cell of `region.mesh` is which this rank owns."""
        assert self.origin is not None, "a mesh without a joint"
        return self.origin.numbers(self.region.dim, self.region.parent[: len(self.cells)])

    @cached_property
    def columns(self) -> Columns:
        """Columns of the layer that contain the points; on S without a joint each facet is a column.

        Raises:
            InputError: a meshed layer without a joint.
        """
        if self.origin:
            numbers, centres = self.origin.columns()
            of_cells = numbers[self.original]
            used = np.zeros(len(centres), np.int8)
            used[of_cells] = 1
            self.comm.Allreduce(MPI.IN_PLACE, used, MPI.MAX)  # columns of other seams have no points of this law
            of_cells, count = (np.cumsum(used, dtype=np.int64) - 1)[of_cells], int(used.sum())
        elif self.measure.integral_type() == "cell":
            raise InputError(f"{type(self.term.law).__name__} has phases in columns, which layers of other meshes lack")
        else:
            imap = self.region.mesh.topology.index_map(self.region.dim)
            of_cells, count = np.arange(imap.size_local, dtype=np.int64) + imap.local_range[0], int(imap.size_global)
        of = np.empty(self.count, np.int64)
        of[self.cells] = of_cells[:, None]
        return Columns(self.comm, of, count, self.weights)


def assemble_matrix(form: fem.Form) -> PETSc.Mat:
    """Assemble the matrix of a bilinear form, without supports."""
    pattern = fem.create_sparsity_pattern(form)
    pattern.finalize()
    made = dolfinx.cpp.la.petsc.create_matrix(communicator(form.mesh), pattern)
    A = copy(made)
    made.destroy()  # DOLFINx keeps a surplus reference, so that only the copy can be freed
    dolfinx.fem.petsc.assemble_matrix(A, form)
    A.assemble()
    return A


def assemble_forces(first: fem.Form, *others: fem.Form) -> PETSc.Vec:
    """Assemble the sum of linear forms as nodal forces; the caller destroys the vector."""
    b = dolfinx.fem.petsc.assemble_vector(first)
    for form in others:
        dolfinx.fem.petsc.assemble_vector(b, form)
    b.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
    return b


def add_assembled_forces(out: PETSc.Vec, *forms: fem.Form) -> float:
    """Add the nodal forces of linear forms to a vector, and return the norm of their sum."""
    b = assemble_forces(*forms)
    out.axpy(1.0, b)
    size = float(b.norm())
    b.destroy()
    return size


def set_owned_values(f: fem.Function, values: Array) -> fem.Function:
    """Set the owned dofs of a function to `values`, update its ghosts, and return it. Collective."""
    f.x.array[: len(values)] = values
    f.x.scatter_forward()
    return f


def assemble_values(form: fem.Form | None, count: int) -> Array:
    """Assembled values (count,) of a linear form at this rank's dofs; zeros for None."""
    if form is None:
        return np.zeros(count)
    b = assemble_forces(form)
    values = np.array(b.array_r)
    b.destroy()
    return values


def add_distributed(
    density: Expr, V: fem.FunctionSpace, measure: ufl.Measure, b: PETSc.Vec, maps: EntityMaps | None = None
) -> None:
    """Add the integral of a density to the first displacement component at nodes, distributed by shape functions.

    On S these are the shape functions of the upper side. As they add up to one, the entries add up to the integral.
    """
    v = ufl.TestFunction(V)
    shape = v("+")[0] if measure.integral_type() == "interior_facet" else v[0]
    add_assembled_forces(b, compiled(density * shape * measure, maps))
