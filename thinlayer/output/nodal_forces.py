"""Nodal forces: of any linear form, of the layer on the bodies, and of contact laws on the bodies."""

from __future__ import annotations

import dolfinx.la
import ufl
from dolfinx import fem

from forms.tensors import Expr
from thinlayer.discretisation.contact_nodes import ContactNodes
from thinlayer.discretisation.form_compilation import compiled
from thinlayer.discretisation.state import State
from thinlayer.system.ranks import destroy


def layer_forces(state: State, bonds_joined: bool = False) -> fem.Function:
    """Compute the nodal forces on the bodies at S: those of the layer and, where bodies are bonded, of the other body.

    Collective. The force of the shape function phi_i is r_i = int_bodies stress(u) : e(phi_i) - L(phi_i), where L is
    the virtual work of the loads. Virtual work of other parts of the model, such as springs at an end of S, is added.

    Args:
        state: the state.
        bonds_joined: whether the shape functions, of degree 1, are continuous across seams with a `Bond`. If so, the
            forces between bonded bodies cancel. Across other seams the shape functions are never continuous.

    Returns:
        A vector function of degree 1, whose nodal values are the forces r_i.
    """
    model = state.model
    W = model.space(1, broken_at_faces=not bonds_joined)
    v = ufl.TestFunction(W)
    # Separate forms: in a sum DOLFINx 0.9 loses integrals over overlapping sets of regions with different quadratures.
    r = nodal_forces(W, state.work(state.bodies, v))
    if (parts_work := state.work_of_parts(v)).integrals():
        r.x.array[:] += nodal_forces(W, parts_work).x.array
    r.x.array[:] -= nodal_forces(W, model.external_work(v, state.t)).x.array
    return r


def nodal_forces(V: fem.FunctionSpace, form: Expr) -> fem.Function:
    """Assemble a linear form to nodal forces. Collective.

    Args:
        V: space of the form's test function.
        form: UFL form, linear in this test function.

    Returns:
        A function in V. Each of its degrees of freedom is the value of the form for the shape function of this degree
        of freedom. Ghost values are up to date.
    """
    forces = fem.Function(V)
    fem.assemble_vector(forces.x.array, compiled(form))
    forces.x.scatter_reverse(dolfinx.la.InsertMode.add)
    forces.x.scatter_forward()
    return forces


def contact_forces(state: State) -> fem.Function:
    """Compute the nodal forces of contact laws on the bodies, as a function in the displacements' space. Collective."""
    model, forces = state.model, fem.Function(state.model.V)
    for name, law in model.contacts.items():
        nodes = ContactNodes(model.contact_surface(name), gap=law.gaps)
        b = nodes.new_vector()
        nodes.add_forces(-law.traction(nodes.separation(state.u.x.petsc_vec), state.memory[model.layers[name].key]), b)
        forces.x.array[: b.getLocalSize()] += b.array_r
        destroy(nodes, b)
    forces.x.scatter_forward()
    return forces
