"""Pressure of an incompressible or rubbery layer: unknowns on the cells of the meshed layer, or on S."""

from __future__ import annotations

import math

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc
from scipy.spatial import cKDTree
from ufl.classes import Zero

from forms.base import Array
from forms.tensors import Expr
from forms.work import Term
from geometry.domain import cell_nodes
from geometry.topology import IntArray
from thinlayer.discretisation.key import Key
from thinlayer.discretisation.mesh_functions import SharedDofs, broken_space
from thinlayer.discretisation.time_functions import StepStrains
from thinlayer.parts.part import Block, FieldPart, FileOrder, PartTraits, StepOutcome, TimeStep
from thinlayer.pointwise.quadrature import (
    MeasureRegion,
    MeshOrigin,
    Quadrature,
    add_integral_to_nodes,
    assemble_matrix,
    assemble_values,
    set_owned_values,
)
from thinlayer.system.ranks import communicator, destroy

VERTEX_TOLERANCE = 1e-9  # distance of two vertices, relative to the size of S, at which they count as the same


class PressurePart(FieldPart):
    """Pressure p of an incompressible or rubbery layer as unknowns, with a weak equation for the change of volume.

    p is positive in tension. The equation is int q (tr e - c p) - int_S f grad_S p . grad_S q = 0 for all q of degree
    1. Its terms are:

    - e: strain of the displacements plus the prescribed strain, so that a free expansion causes no pressure.
    - c: the law's `volume_compliance`.
    - f: the flow along S, `Term.mobility`. An interface law of order 1 has f = eps^3/(12 mu), and p is zero at free
      ends.
      Otherwise f = 0.

    The pressure has degree 1, displacements and jumps have degree 2. In the meshed layer this is the Taylor-Hood
    element.

    Args:
        V: space of the displacements.
        term: virtual work of the incompressible law.
        stiffness: a nodal stiffness, force per displacement, > 0. It scales the rows of G to forces, so that the
            residuals of both equations have the same unit.
        origin: relation of the mesh to the joint, the undistributed mesh from which it was made. Files need it. For a
            law with flow it gives the positions of S between bodies that are apart. None: there is no joint.
        rim_x: (n, d) coordinates of the vertices of S where p is zero, in d dimensions; None: there are none.
        masters: (n_points,) for each point of the joint, the point with which periodic sides identify it
            (`Joint.masters`); None: the joint is not periodic.

    Attributes:
        key: name of the pressure in `State.fields`: the term's key, with "pressure" in place of "layer".
        region: the cells of the meshed layer, or S, as a mesh.
        unit: scale of the unknowns: the pressure is `field` times `unit`.
        G: matrix of int q tr e(v), times `unit`; rows: pressures, columns: displacements v.
        C: matrix of int c p q + int_S f grad_S p . grad_S q, times the square of `unit`; None: c and f are zero.
    """

    traits = PartTraits(saddle=True, weakens=True)
    hint = "S has too few cells for the pressures of its layer"

    def __init__(
        self, V: fem.FunctionSpace, term: Term, stiffness: float, origin: MeshOrigin | None = None,
        rim_x: Array | None = None, masters: IntArray | None = None,
    ) -> None:  # fmt: skip
        self.key, self._origin, self._term = str(Key.parse(term.key).pressure_key), origin, term
        points = Quadrature(V, term, origin) if term.law.fields else None
        self.region = region = points.region if points else MeasureRegion(V.mesh, term.measure)
        if flows_along_surface(term) and origin and origin.middle_points is not None:
            region.move_nodes(origin.middle_points)
        self.on_S = region.dim < region.parent_mesh.topology.dim
        self._vertex_space = fem.functionspace(region.mesh, ("Lagrange", 1))
        space = self._vertex_space if masters is None else periodic_space(region, masters)
        self.field = self._p = fem.Function(space)
        q, v = region.plus_side(ufl.TestFunction(space)), ufl.TrialFunction(V)
        self.G = G = assemble_matrix(region.compiled(q * ufl.tr(term.strain(v)) * term.weight * term.measure))
        self.C = self._assemble_compliance(space, term, points)
        self.unit = stiffness / G.norm(PETSc.NormType.INFINITY)
        if self.C is not None:  # else rounding errors of volumes next to stiff bodies would be as large as forces
            self.unit = min(self.unit, math.sqrt(stiffness / self.C.norm(PETSc.NormType.INFINITY)))
            self.C.scale(self.unit**2)
        G.scale(self.unit)
        self._zero_dofs = dofs_at_vertices(space, rim_x) if rim_x is not None and len(rim_x) else np.empty(0, np.int64)
        terms = [term] if term.prescribed_strain is not None else []
        self._step_strain = StepStrains(V.mesh, terms)
        volume_form = sum(q * ufl.tr(self._step_strain.now(p.prescribed_strain)) * p.weight * p.measure for p in terms)
        self._volume_form = region.compiled(volume_form) if terms else None
        self._G_trans = G.transpose(PETSc.Mat())
        self._volume_change, self._C_product, self._forces = G.createVecLeft(), G.createVecLeft(), G.createVecRight()

    def _assemble_compliance(self, space: fem.FunctionSpace, term: Term, points: Quadrature | None) -> PETSc.Mat | None:
        """Assemble the matrix of int c p q + int_S f grad_S p . grad_S q; None: c and f are zero. Collective.

        c is the law's `volume_compliance`, f the flow `Term.mobility` along S. The attribute `C` is this matrix times the
        square of `unit`.

        Args:
            space: space of the pressures p and q.
            term: virtual work of the law.
            points: quadrature points where parameters that are functions of the place are evaluated; None: there are no
                such parameters.
        """
        region, law, measure = self.region, term.law, term.measure
        p, q = ufl.TrialFunction(space), ufl.TestFunction(space)
        forms = []
        if points:
            functions = {name: points.region_function(values) for name, values in law.fields_at(points.joint_x).items()}
            law = law.with_parameters({name: region.plus_side(f) for name, f in functions.items()})
            measure = points.measure
        if not isinstance(compliance := ufl.as_ufl(law.volume_compliance), Zero):
            forms.append(compliance * region.plus_side(p) * region.plus_side(q) * term.weight * measure)
        if flows_along_surface(term):  # gradients on the mesh of S are gradients along S
            mobility = self._cell_means(term.mobility) * term.kinematics.on_mesh(region.mesh).factor
            forms.append(mobility * ufl.inner(ufl.grad(p), ufl.grad(q)) * ufl.dx(region.mesh))
        if not forms:
            return None
        C, *other_matrices = (assemble_matrix(region.compiled(form)) for form in forms)
        for matrix in other_matrices:
            C.axpy(1.0, matrix)
            matrix.destroy()
        return C

    def _cell_means(self, f: Expr) -> fem.Function:
        """Return the mean of the UFL scalar `f` over each facet or cell, a piecewise constant function. Collective."""
        space = fem.functionspace(self.region.mesh, ("DG", 0))
        q, n_owned = self.region.plus_side(ufl.TestFunction(space)), space.dofmap.index_map.size_local
        forms = [integrand * q * self.region.measure for integrand in (f, fem.Constant(self.region.parent_mesh, 1.0))]
        integrals, sizes = (assemble_values(self.region.compiled(form), n_owned) for form in forms)
        return set_owned_values(fem.Function(space), integrals / sizes)

    def _p_at_end(self) -> Array:
        """Return this rank's pressures (own_size,) at the end of the step, divided by `unit`.

        They belong to the last call of `evaluate`.
        """
        theta, p = self.interval.theta, self._p.x.array[: self.own_size]
        return np.asarray(p if theta == 1 else (p - (1 - theta) * self.own_values_before(self.interval.old)) / theta)

    def _multiply_C(self, C: PETSc.Mat, p: Array) -> tuple[Array, float]:
        """Return C p on this rank, and the number p . C p summed over all ranks. Collective.

        Args:
            C: the matrix.
            p: (own_size,) this rank's pressures, divided by `unit`.
        """
        v = self._C_product.duplicate()
        v.array[:] = p
        C.mult(v, self._C_product)
        p_C_p = float(v.dot(self._C_product))
        v.destroy()
        return self._C_product.array_r.copy(), p_C_p

    def begin(self, interval: TimeStep) -> None:
        super().begin(interval)
        # contributions (own_size,) of prescribed strains to `own_residual`
        self._strain_volume, old = (self.unit * v for v in self._strain_forces(self._step_strain, self._volume_form))
        self._volume_increment = self._strain_volume - old

    def evaluate(self, u: fem.Function, mid: fem.Function) -> None:
        self.G.mult(u.x.petsc_vec, self._volume_change)
        volume_change: Array = self._volume_change.array_r + self._strain_volume
        self._residual = volume_change - (0.0 if self.C is None else self._multiply_C(self.C, self._p_at_end())[0])

    def law_traits(self) -> dict[str, PartTraits]:
        return {type(self._term.law).__name__: self.traits}

    def add_forces(self, out: PETSc.Vec) -> float:
        self.G.multTranspose(self._p.x.petsc_vec, self._forces)
        out.axpy(1.0, self._forces)
        return 0.0

    def add_work_in(self, z: fem.Function, out: PETSc.Vec) -> None:
        density = self.unit * self.region.plus_side(self._p) * ufl.tr(self._term.strain(z)) * self._term.weight
        add_integral_to_nodes(density, z.function_space, self._term.measure, out, self.region.entity_maps)

    def own_residual(self) -> Array:
        return self._residual

    def own_prescribed(self, t: float | None) -> tuple[IntArray, Array]:
        """Return the local numbers of the pressures that are set to zero at free ends of S, and as many zeros.

        Only laws with a flow along S have such pressures. The time `t` has no influence.
        """
        return self._zero_dofs, np.zeros(len(self._zero_dofs))

    def tangents(self, relative_residual: float) -> list[Block]:
        blocks = [Block(self._G_trans, column=self.key, kept=True), Block(self.G, row=self.key, kept=True)]
        if self.C is not None:
            blocks.append(Block(self.C, -1 / self.interval.theta, row=self.key, column=self.key, kept=True))
        return blocks

    def commit(self) -> StepOutcome:
        """Return the energies of the pressure over the accepted step.

        The stored energy is p.C p/2. The supplied work is that of the pressure in the growth of prescribed strains.
        """
        self._volume_change.array[:] = self._volume_increment
        work = float(self._volume_change.dot(self._p.x.petsc_vec))
        if self.C is None:
            return StepOutcome(kept=False, supplied=work)
        new, old = self._p_at_end(), self.own_values_before(self.interval.old)
        before, after, change_energy = (self._multiply_C(self.C, p)[1] / 2 for p in (old, new, new - old))
        return StepOutcome(before, after, remainder=(2 * self.interval.theta - 1) * change_energy, supplied=work)

    def own_result(self) -> fem.Function:
        """Return the pressure at the end of the step as a function, for the state.

        `field` is the pressure at the time old.t + theta dt, divided by `unit`. For theta < 1 the result is
        extrapolated from it and from the pressure at the start. If C is None, the pressure before the first step is
        unknown; then `field` times `unit` is returned.
        """
        p, old, theta = super().own_result(), self.interval.old.fields.get(self.key), self.interval.theta
        if theta < 1 and (old is not None or self.C is not None):
            p.x.array[:] = (p.x.array - (1 - theta) * (0.0 if old is None else old.x.array)) / theta
        return p

    @property
    def own_file_order(self) -> FileOrder:
        assert self._origin is not None, "a mesh without a joint"
        space, region = self._vertex_space, self.region
        cells, x = np.asarray(space.dofmap.list), space.tabulate_dof_coordinates()[:, : region.mesh.geometry.dim]
        ordered = FileOrder.by_place(self._origin.to_joint(region.dim, region.indices)[: len(cells)], cells, x)
        dof_numbers = np.empty(len(x), np.int64)
        dof_numbers[cells] = self._p.function_space.dofmap.list  # one dof may have several vertices, on periodic sides
        return FileOrder(ordered.file_rows, dof_numbers[ordered.value_positions])

    def destroy(self) -> None:
        destroy(self.G, self.C, self._G_trans, self._volume_change, self._forces, self._C_product)


def flows_along_surface(term: Term) -> bool:
    """Tell whether the pressure of the law in `term` drives a flow along S.

    It does in interface laws of order 1 of incompressible layers.
    """
    return not isinstance(ufl.as_ufl(term.mobility), Zero)


def periodic_space(region: MeasureRegion, masters: IntArray) -> fem.FunctionSpace:
    """Return a space of degree 1 whose functions have equal values at points that periodic sides identify. Collective.

    Args:
        region: the mesh of the functions.
        masters: (n_points,) for each point of the joint, the point with which periodic sides identify it.
    """
    mesh = region.mesh
    element = basix.ufl.element("Lagrange", mesh.basix_cell(), 1)
    corners = cell_nodes(mesh)[:, : element.basix_element.dim]
    vertices = np.asarray(mesh.geometry.input_global_indices, np.int64)[corners]
    comm = communicator(region.parent_mesh)
    return broken_space(comm, SharedDofs.of_entities(comm, mesh, element, [masters[vertices]]))


def dofs_at_vertices(space: fem.FunctionSpace, vertex_x: Array) -> IntArray:
    """Return this rank's owned dofs of `space`, of degree 1, at the vertices with coordinates `vertex_x`. Collective.

    `vertex_x` is (n, d) for n vertices in d dimensions; rounding errors of coordinates are allowed.
    """
    x = space.tabulate_dof_coordinates()[: space.dofmap.index_map.size_local, : vertex_x.shape[1]]
    boxes = space.mesh.comm.allgather((x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf)))
    low, high = (np.array(bounds) for bounds in zip(*boxes, strict=True))
    size = float((high.max(axis=0) - low.min(axis=0)).max())
    distances, _ = cKDTree(vertex_x).query(x)
    return np.flatnonzero(distances <= VERTEX_TOLERANCE * size).astype(np.int64)
