"""Choice of the method that solves a model with contact laws, and which methods suit a model."""

from __future__ import annotations

import numpy as np

from thinlayer.discretisation.model import Model
from thinlayer.solving.contact.condensed import CondensedContact
from thinlayer.solving.contact.contact_solver import ContactSolver
from thinlayer.solving.contact.multigrid import MultigridContact
from thinlayer.solving.contact.paper_relaxation import ContactRelaxation

SOLVER_OF_METHOD = dict[str, type[ContactSolver]](
    condensed=CondensedContact, multigrid=MultigridContact, relaxation=ContactRelaxation
)
MAX_CONDENSED_DOFS = {2: 4000, 3: 1200}  # dimension -> displacements at S up to which "condensed" is the default


def default_method(model: Model) -> str:
    """Return the name of the default method for a model with contact laws: "condensed", "multigrid" or "newton".

    "newton" is chosen in any of these cases: bodies that are not linear, user-defined contact laws, inclined supports,
    rigid plates, periodic joints, or seams without contact.

    Otherwise "condensed" is chosen on one rank if there are few displacement unknowns on S. If several seams share
    bodies, the unknowns are counted for each body alone. In all other cases "multigrid" is chosen.
    """
    joint = model.joint
    n_all = len(np.unique(joint.surface)) * (1 if joint.rigid_base else 2)
    dofs_per_node = joint.dim * model.structure.degree ** (joint.dim - 1)
    is_small = (_max_vertices(model) if _is_network(model) else n_all) * dofs_per_node <= MAX_CONDENSED_DOFS[joint.dim]
    suited_methods = (method for method in ("condensed", "multigrid") if not why_unsuited(model, method))
    candidates = (method for method in suited_methods if not model.layer_terms and (is_small or method != "condensed"))
    return next(candidates, "newton")


def _max_vertices(model: Model) -> int:
    """Return the number of vertices on S of the body that has the most of them."""
    joint = model.joint
    cell, corner = np.nonzero(np.isin(joint.corners, joint.surface))
    piece_vertices = np.unique(np.column_stack([model.split_mesh.pieces[cell], joint.corners[cell, corner]]), axis=0)
    return int(np.bincount(piece_vertices[:, 0]).max())


def _is_network(model: Model) -> bool:
    """Whether there are several seams, or S branches, so that one node may belong to several pairs of nodes."""
    return len(model.joint.seams) > 1 or model.joint.seams_meet


def _is_linear(model: Model) -> bool:
    """Whether the model without its contact laws is linear.

    The only unknowns must then be displacements, with a constant and symmetric stiffness from UFL forms.
    """
    if model.constraints.T is not None:
        return False  # with T the unknowns are not the displacements
    traits = [term.law.traits for term in model.terms]
    by_laws = all(each.symmetric and not (each.constrained or each.compiled) for each in traits)
    return by_laws and all(part.has_work and part.is_linear(model) and part.is_symmetric(model) for part in model.parts)


def why_unsuited(model: Model, method: str) -> str:
    """Say why a method of contact does not suit the model; "" if it does.

    Args:
        model: the model.
        method: "condensed", "multigrid" or "relaxation".

    Returns:
        The reason, worded such that it can follow the method's name, as "is for one rank, not 2; ...".
    """
    law_names = [type(law).__name__ for law in model.contacts.values() if law.numbers is None]
    if model.contact is None:
        return "is for contact laws; the model has none"
    if method != "multigrid" and model.comm.size > 1:
        return f"is for one rank, not {model.comm.size}; use method='multigrid'"
    if model.joint.periods:
        return "is not for periodic joints; use method='newton'"
    if method == "relaxation" and _is_network(model):
        return "is for one seam without branches, whose jumps are independent of each other; use another method"
    if not _is_linear(model):
        supports = "and no inclined supports or rigid plates; use method='newton'"
        return f"needs linear bodies without stresses at rest, linear, symmetric parts and layers, {supports}"
    return f"needs one of the laws of forms.contact, not {law_names[0]}; use method='newton'" if law_names else ""
