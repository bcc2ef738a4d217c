"""Unknown on S of a layer of order 2: the amplitude of a bubble through the thickness, zero on both faces."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from forms.base import Array, InputError
from forms.work import Term
from geometry.topology import FACET_TYPES, BoolArray, IntArray, facet_nodes, vertex_weights
from thinlayer.discretisation.form_compilation import compiled
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import SeamLayer
from thinlayer.discretisation.mesh_functions import SharedDofs, broken_space
from thinlayer.discretisation.state import Configuration, State
from thinlayer.parts.compiled_part import CompiledPart
from thinlayer.parts.part import Block, FieldPart, FileOrder, StepOutcome
from thinlayer.pointwise.quadrature import assemble_values
from thinlayer.system.ranks import destroy


class BubblePart(FieldPart):
    """Unknowns b at nodes of S: the mean of a scalar field through a layer, minus the mean of its faces.

    The field is <T> + z [T] + 6 (1/4 - z^2) b at the height z, from -1/2 to 1/2 of the thickness. The equation of b is
    the balance of fluxes, sinks and sources in the layer, for virtual fields of the same shape. The nodes are those of
    the upper side of S; b is zero where a support holds the side of the layer, and free where it is insulated. Marches
    begin with b = 0, a field that is linear through the layer, or with b of the state of order 2 that is `initial`.

    Args:
        model: the model.
        layer: the layer, of order 2.

    Attributes:
        laws: the layer's law at each of the heights at which it is evaluated.
        seam: name of the layer's seam.
    """

    on_S = True

    def __init__(self, model: InterfaceModel, layer: SeamLayer) -> None:
        self.key, self.seam, self._model = layer.bubble_key, layer.name, model
        space, self._rows, self._cells, self._nodes, is_held = _nodes_on_upper_side(model, layer)
        self.field, self.laws = fem.Function(space), list[EnrichedPart]()
        dofs = np.asarray(space.dofmap.list)[self._cells[:, None], self._nodes]
        is_free = np.zeros(len(self.field.x.array), bool)
        is_free[dofs[~is_held]] = True
        is_free[dofs[is_held]] = False
        self._zero_dofs = np.flatnonzero(~is_free[: self.own_size])
        work = model.forces.work_on_bubble(layer.name, ufl.TestFunction(space))
        self._load = None if work.empty() else compiled(work)

    def own_load_at(self, t: float) -> Array:
        with self._model.forces.at.clock.at(t):
            return assemble_values(self._load, self.own_size)

    def own_prescribed(self, t: float | None) -> tuple[IntArray, Array]:
        return self._zero_dofs, np.zeros(len(self._zero_dofs))

    def own_values_before(self, old: Configuration) -> Array:
        """Return b before a step; at rest that of the state from which a march begins, if this has the same unknown."""
        initial = self._model.structure.initial
        if self.key in old.fields or not (isinstance(initial, State) and self.key in initial.fields):
            return super().own_values_before(old)
        values = np.array(initial.fields[self.key].x.array[: self.own_size])
        return values if len(values) == self.own_size else np.zeros(self.own_size)

    def evaluate(self, u: fem.Function, mid: fem.Function) -> None:
        """Do nothing: the parts `laws` do."""

    def add_forces(self, out: PETSc.Vec) -> float:
        return 0.0

    def own_residual(self) -> Array:
        return np.asarray(sum(part.bubble_forces() for part in self.laws) - self.load)

    def tangents(self, relative_residual: float) -> list[Block]:
        return []

    def commit(self) -> StepOutcome:
        change = self.field.x.array[: self.own_size] - self.own_values_before(self.interval.old)
        return StepOutcome(kept=False, supplied=float(self._model.comm.allreduce(float(self.load @ change))))

    @property
    def own_file_order(self) -> FileOrder:
        """Order in which b is written to files: one row for each facet of S, by the places of its nodes."""
        domain, V = self._model.domain, self._model.V
        dofs = np.asarray(self.field.function_space.dofmap.list)[self._cells[:, None], self._nodes]
        x = np.zeros((len(self.field.x.array), domain.joint.dim))
        x[dofs] = self._model.node_coordinates[np.asarray(V.dofmap.list)[self._cells[:, None], self._nodes]]
        return FileOrder.by_place(self._rows, dofs, x)


class EnrichedPart(CompiledPart):
    """A layer's law of order 2 at one height: a compiled law whose strain also depends on the bubble's amplitude.

    Args:
        key: name of the part in states and files.
        model: the model.
        term: virtual work of the law.
        bubble: the amplitude of the bubble.
    """

    def __init__(self, key: str, model: InterfaceModel, term: Term, bubble: BubblePart) -> None:
        super().__init__(key, model.V, term, model.origin, symmetric=model.symmetric)
        assert term.bubble_strain is not None
        self._bubble, points, trial = bubble, self.points, ufl.TrialFunction(bubble.field.function_space)
        self._B = points.matrix_to_strains(term.bubble_strain(trial))
        (self._b, self._e_b), self._own_forces = self._B.createVecs(), self._B.createVecRight()
        bubble.laws.append(self)

    def _strain(self, u: fem.Function, state: Configuration | None = None) -> Array:
        bubble = self._bubble
        b = bubble.field.x.array[: bubble.own_size] if state is None else bubble.own_values_before(state)
        self._b.array[:] = b
        self._B.mult(self._b, self._e_b)
        return np.asarray(super()._strain(u) + self._e_b.array_r.reshape(self.points.count, -1))

    def bubble_forces(self) -> Array:
        """Return the forces (n_b,) on the n_b amplitudes of this rank, for the last call of `evaluate`."""
        self._e_b.array[:] = (self._response.stress * self.points.weights[:, None]).ravel()
        self._B.multTranspose(self._e_b, self._own_forces)
        return np.asarray(self._own_forces.array_r.copy())

    def tangents(self, relative_residual: float) -> list[Block]:
        blocks, points, key = super().tangents(relative_residual), self.points, self._bubble.key
        D = points.point_matrix(self._response.tangent)
        u_column, b_column = D.matMult(points.B), D.matMult(self._B)
        blocks.append(Block(points.B.transposeMatMult(b_column), column=key))
        blocks.append(Block(self._B.transposeMatMult(u_column), row=key))
        blocks.append(Block(self._B.transposeMatMult(b_column), row=key, column=key))
        destroy(D, u_column, b_column)
        return blocks

    def pullback(self, weights: Array, z: fem.Function) -> tuple[PETSc.Vec, Array]:
        remedy = "use order=1, or the layer's mesh (structure.full)"
        raise InputError(f"derivative: a march with a layer on {self._bubble.seam!r} of order 2 has none; {remedy}")

    def destroy(self) -> None:
        super().destroy()
        destroy(self._B, self._b, self._own_forces, self._e_b)


def _nodes_on_upper_side(
    model: InterfaceModel, layer: SeamLayer
) -> tuple[fem.FunctionSpace, IntArray, IntArray, IntArray, BoolArray]:
    """Return a space of the model's element with dofs at nodes on the upper side of a seam alone. Collective.

    All other nodes share one dof, without effect on S.

    Returns:
        The space. For each of n facets of the seam its row (n,) in the joint's table, the local number (n,) of its upper
        cell, and the positions (n, m) in this cell of its m nodes. And a mask (n, m) of those where a support holds the
        layer's side.
    """
    domain, V, joint = model.domain, model.V, model.domain.joint
    rows = joint.rows_of(layer.name)
    upper = joint.surface_cells[np.searchsorted(joint.surface_rows, rows), 1]
    is_local = domain.local_cells[upper] >= 0
    cells, facets = domain.local_cells[upper[is_local]], joint.table.local_in(rows, upper)[is_local]
    cell_dofs, cell_type, mesh = np.asarray(V.dofmap.list), joint.cell_type, domain.mesh
    places = np.broadcast_to(np.arange(cell_dofs.shape[1]), cell_dofs.shape)
    nodes = facet_nodes(places, cell_type, cells, facets)
    keys = np.zeros(cell_dofs.shape, np.int64)
    numbers = np.asarray(V.dofmap.index_map.local_to_global(cell_dofs[cells[:, None], nodes].ravel().astype(np.int32)))
    keys[cells[:, None], nodes] = 1 + numbers.reshape(nodes.shape)
    distinct, key_indices = np.unique(keys, return_inverse=True)
    meeting_ranks = distinct * model.comm.size // (V.dofmap.index_map.size_global + 1)
    space = fem.functionspace(mesh, V.ufl_element())
    W = broken_space(model.comm, SharedDofs(space, distinct, meeting_ranks, key_indices.reshape(keys.shape)))
    held_rim = model.applicability[layer.name].rim_of_kinds("held", "symmetric", "antisymmetric", "oblique")
    corners = facet_nodes(joint.corners[domain.original_cells], cell_type, cells, facets)
    has_vertex = vertex_weights(FACET_TYPES[cell_type], 1 + (cell_dofs.shape[1] > joint.corners.shape[1])) > 0
    at_held_rim = ~(~np.isin(corners, held_rim.vertices)[:, None] & has_vertex[None, : nodes.shape[1]]).any(axis=2)
    is_bc = np.isin(cell_dofs[cells[:, None], nodes], model.bc_dofs_in(V))
    return W, rows[is_local], cells, nodes, at_held_rim & is_bc
