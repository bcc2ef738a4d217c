"""Spaces of vector functions that jump where a mesh is cut, and repeat where it is periodic."""

from __future__ import annotations

import basix.ufl
import numpy as np
from dolfinx import fem

from geometry.domain import Domain
from geometry.joint import Joint
from geometry.topology import Splitting
from thinlayer.discretisation.broken import Keys, broken_space


def vector_space(domain: Domain, cut: Splitting, degree: int, family: str) -> fem.FunctionSpace:
    """Vector functions (d,) on a domain. Collective.

    Args:
        domain: the domain.
        cut: where its mesh is cut.
        degree: polynomial degree.
        family: basix family.
    """
    mesh, dim, comm = domain.mesh, domain.joint.dim, domain.comm
    element = basix.ufl.element(family, mesh.basix_cell(), degree, shape=(dim,))
    if domain.joint.periods:
        of_entities = [domain.on_cells(of_dim) for of_dim in cut.keys]
        return broken_space(comm, Keys.of_entities(comm, mesh, element, of_entities))
    used = [any(map(len, of_dim)) for of_dim in element.basix_element.entity_dofs]
    none = np.empty((0, 0), np.int64)
    components = [domain.on_cells(cut.components(k)) if used[k] else none for k in range(dim)]
    return broken_space(comm, Keys.of_components(comm, mesh, element, components))


def cut_at_faces(joint: Joint) -> Splitting:
    """The joint's mesh, cut along S, or at both faces of the meshed layer."""
    if joint.band is None:
        return joint.splitting
    facets = [joint.facets[name] for name in joint.band.faces]
    return joint.split_along(np.unique(joint.table.index(np.concatenate(facets))))
