"""Nodal forces of forms, of the layer on the bodies, and of contact laws."""

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
    """Nodal forces that the layer (or the other body) exerts on the bodies, at the nodes of the faces of S. Collective.

    r_i = int_body stress(u) : e(phi_i) - L(phi_i). The integral includes the work of the model's further parts, such as
    springs at the end of S. The functions phi_i have degree 1 and jump at the faces of S; with `joined` not at bonds.
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
    """Values of a linear form on the basis functions of a space, ghosts included. Collective."""
    vector = fem.assemble_vector(compiled(form))
    vector.scatter_reverse(dolfinx.la.InsertMode.add)
    vector.scatter_forward()
    values = fem.Function(V)
    values.x.array[:] = vector.array
    return values


def contact_forces(state: State) -> fem.Function:
    """Nodal forces of contact laws on the bodies, in the state's space. Collective."""
    model, forces = state.model, fem.Function(state.model.V)
    for name, law in model.contacts.items():
        nodes = ContactNodes(ContactSurface.of(model, name), gap=law.gaps)
        b = nodes.zero()
        nodes.add_forces(-law.traction(nodes.separation(state.u.x.petsc_vec), state.memory[model.layers[name].key]), b)
        forces.x.array[: b.getLocalSize()] += b.array_r
        destroy(nodes, b)
    forces.x.scatter_forward()
    return forces
