"""Errors on S: norms of the changes of tractions and jumps, and densities of the changes of goals."""

from __future__ import annotations

import math

import numpy as np
from petsc4py import PETSc
from scipy.spatial import cKDTree

from forms.base import Array
from geometry.topology import vertex_weights
from thinlayer.discretisation.layer import SeamLayer
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State, displacements_of
from thinlayer.estimating.global_local import BodyEquilibrium, GlobalLocal
from thinlayer.output.surface import Surface
from thinlayer.surface.pressure_excess import jump_stiffness
from thinlayer.surface.surface_mesh import SurfaceMesh

# largest rounding of the traction, over stiffness times displacements, and of the jump, over displacements
FIELD_ROUNDING = (1e-11, 1e-9)


def squared_norms(state: State, better: State, seam_layer: SeamLayer, layers: State) -> Array:
    """Return squared L2 norms on a seam of traction t, of jump [u], and of their changes by meshing. Collective.

    Args:
        state: the state u_0 with interface laws or bonds.
        better: u_1, the state of the interface model whose bodies are in equilibrium with the meshed layers.
        seam_layer: the layer on the seam.
        layers: state of the meshed layers, from which the tractions t(u_1) are taken.

    Returns:
        (4,) squared norms of t(u_1) - t(u_0), t(u_0), [u_1] - [u_0] and [u_0]. Those of t(u_0) and [u_0] are zero if
        they are only rounding.
    """
    surface = Surface(better.model, seam_layer.name)
    has_law = seam_layer.name in state.model.layers
    t, w = (surface.traction if has_law else surface.reaction)(state), surface.jump(state)
    fields = [surface.traction(layers) - t, t] + ([surface.jump(better) - w, w] if has_law else [])
    squares = np.array([surface.norm(f) ** 2 for f in fields] + [0.0] * (4 - len(fields)))
    u_squared = float(better.u.x.petsc_vec.norm(PETSc.NormType.INFINITY)) ** 2 * surface.integral(1.0)
    rounding_squares = np.square(FIELD_ROUNDING) * u_squared * (max(jump_stiffness(seam_layer.samples[0])) ** 2, 1.0)
    squares[1::2] *= squares[1::2] > rounding_squares  # rounding of bodies without forces there
    return np.asarray(squares)


def relative_errors(squares: Array) -> tuple[float, float]:
    """Return the relative errors of traction and jump on S; nan for a field that is zero with the interface law.

    `squares` are the squared norms (4,) of `squared_norms`, or a sum of them over several seams.
    """
    t_error, t, w_error, w = (float(root) for root in np.sqrt(squares))
    errors = t_error / t if t else math.nan, w_error / w if w else math.nan
    return errors[0] * (errors[0] > FIELD_ROUNDING[1]), errors[1] * (errors[1] > FIELD_ROUNDING[1])


def change_density(iteration: GlobalLocal, state: State, better: State, z: BodyEquilibrium) -> Array:
    """Return the density on S, per area, of the change of a goal from a state to a better state. Collective.

    It has three terms. The first is the work of the interface laws in the adjoint solution z. The work of meshed layers
    with the same displacements of their faces is subtracted. The second is the work of forces that z leaves unbalanced
    on the faces, in the change of the face displacements. The third, for the compliance, is the change of the work of
    loads on the layers.

    Args:
        iteration: the iteration from the interface model to the structure with meshed layers.
        state: the state with interface laws or bonds.
        better: the state of the interface model whose bodies are in equilibrium with the meshed layers.
        z: adjoint solution of the goal.

    Returns:
        (m,) values at the m nodes of S.
    """
    model, layers = iteration.model, iteration.layers
    u, vertex_sums = displacements_of(state, model), np.zeros(len(model.joint.points))
    _add_at_vertices(vertex_sums, model, iteration.nodal_work_of_laws(u, z, bonded=bool(state.model.bonds)))
    if z.load.any():
        loads = state.model.forces.nodal_forces_at(state.model.V, state.t, layers=True)
        _add_at_vertices(vertex_sums, state.model, -loads.array_r * state.u.x.array[: loads.getLocalSize()])
        loads.destroy()
    v, better_v = layers.to_layers(u.x.array), layers.to_layers(better.u.x.array)
    layers.equilibrate_dirichlet(better_v)
    layers.transpose()
    layer_z, z_residual = iteration.layer_unknowns(z), iteration.residual(z)
    layers.transpose()
    w = layers.equilibrate_dirichlet(v)
    work_at_dofs = layers.work_shares(w, layer_z)
    work_at_dofs -= (z_residual * (better_v - v) + z.load * w)[: len(work_at_dofs)]
    layer_joint = layers.model.domain.joint
    layer_sums = np.zeros(len(layer_joint.points))
    _add_at_vertices(layer_sums, layers.model, work_at_dofs)
    _, joint_vertices = cKDTree(model.joint.points).query(layer_joint.reference)
    vertex_sums = model.comm.allreduce(vertex_sums) - np.bincount(joint_vertices, layer_sums, len(vertex_sums))
    return _density(model, vertex_sums)


def work_density(model: Model, work_at_dofs: Array) -> Array:
    """Return the density on S, per area, of work that is given as shares of displacements on S. Collective.

    Args:
        model: the interface model.
        work_at_dofs: (k,) shares of this rank's k displacements.

    Returns:
        (m,) values at the m nodes of S.
    """
    vertex_sums = np.zeros(len(model.joint.points))
    _add_at_vertices(vertex_sums, model, work_at_dofs)
    return _density(model, model.comm.allreduce(vertex_sums))


def _density(model: Model, vertex_sums: Array) -> Array:
    """Return densities (m,) at the m nodes of S for sums at all vertices of the joint."""
    surface, areas = SurfaceMesh(model), np.zeros(len(vertex_sums))
    np.add.at(areas, surface.vertices, surface.areas)
    return np.asarray(vertex_sums[surface.vertices] / areas[surface.vertices])


def _add_at_vertices(sums: Array, model: Model, values: Array) -> None:
    """Add nodal values of a model to sums at the vertices of its joint.

    The value of a node inside an edge, face or cell is divided equally among the vertices of that edge, face or cell.

    Args:
        sums: (vertices,) sums, which are changed in place.
        model: the model.
        values: (m,) values at the displacements of this rank; components at a node are added up.
    """
    V, joint = model.V, model.domain.joint
    node_sums = values.reshape(-1, V.dofmap.bs).sum(axis=1)
    dofs = np.asarray(V.dofmap.list)
    nodes, first_positions = np.unique(dofs.ravel(), return_index=True)
    is_owned = nodes < len(node_sums)
    cell, local = np.divmod(first_positions[is_owned], dofs.shape[1])
    shares = vertex_weights(joint.cell_type, model.structure.degree)[local] * node_sums[nodes[is_owned], None]
    np.add.at(sums, joint.corners[model.domain.original_cells[cell]], shares)
