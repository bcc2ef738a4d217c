"""Nodal forces: of any linear form, of the layer on the bodies, and of contact laws on the bodies."""

from __future__ import annotations

import dolfinx.la
import ufl
from dolfinx import fem

from forms.tensors import Expr
from thinlayer.discretisation.contact_nodes import ContactNodes, ContactSurface
from thinlayer.discretisation.form_compilation import compiled
from thinlayer.discretisation.state import State
from thinlayer.system.ranks import destroy


def layer_forces(state: State, joined: bool = False) -> fem.Function:
    """Nodal forces that the layer (at a bond: the other body) exerts on each body at S. Collective.

    They are r_i = int_bodies stress(u) : e(phi_i) - L(phi_i), where L is the virtual work of the loads. The work of
    further parts of the model, such as springs at an end of S, is added to the integral.

    Args:
        state: the state.
        joined: whether the shape functions phi_i, of degree 1, are continuous across bonds. They always jump at other
            parts of S; with False, also at bonds.

    Returns:
        A function of the space of the phi_i, whose nodal values are the forces r_i.
    """
    model = state.model
    W = model.space(1, broken_at_faces=not joined)
    v = ufl.TestFunction(W)
    # Separate forms: in a sum DOLFINx 0.9 loses integrals over overlapping sets of regions with different quadratures.
    r = nodal_forces(W, state.work(state.bodies, v))
    if (added := model.added_work_in(state, v)).integrals():
        r.x.array[:] += nodal_forces(W, added).x.array
    r.x.array[:] -= nodal_forces(W, model.external_work(v, state.t)).x.array
    return r


def nodal_forces(V: fem.FunctionSpace, form: Expr) -> fem.Function:
    """Assemble a linear form into a function of its test space V, whose ghost values are up to date. Collective."""
    vector = fem.assemble_vector(compiled(form))
    vector.scatter_reverse(dolfinx.la.InsertMode.add)
    vector.scatter_forward()
    values = fem.Function(V)
    values.x.array[:] = vector.array
    return values


def contact_forces(state: State) -> fem.Function:
    """Nodal forces that contact laws exert on the bodies, as a function of the displacements' space. Collective."""
    model, forces = state.model, fem.Function(state.model.V)
    for name, law in model.contacts.items():
        nodes = ContactNodes(ContactSurface.of(model, name), gap=law.gaps)
        b = nodes.zero()
        nodes.add_forces(-law.traction(nodes.separation(state.u.x.petsc_vec), state.memory[model.layers[name].key]), b)
        forces.x.array[: b.getLocalSize()] += b.array_r
        destroy(nodes, b)
    forces.x.scatter_forward()
    return forces
