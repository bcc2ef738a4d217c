"""Fields that come from the joint: the layer's thickness and director, the bodies' shifts."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from forms.kinematics import Expr
from geometry.domain import Domain
from geometry.joint import Profile
from geometry.seam import S


def cellwise(domain: Domain, element: tuple[Any, ...], values: npt.NDArray[np.float64]) -> fem.Function:
    """A function given by its degrees of freedom on each cell of the joint, (n_cells, dofs per cell, components)."""
    f = fem.Function(fem.functionspace(domain.mesh, element))
    dofs = f.function_space.dofmap.list
    f.x.array.reshape(-1, values.shape[2])[dofs.ravel()] = domain.on_cells(values).reshape(-1, values.shape[2])
    return f


def relative_thickness(domain: Domain, profile: Profile, name: str = S) -> fem.Function:
    """The thickness profile on a seam, or on S, of degree 1 between vertices; its values elsewhere have no meaning."""
    joint = domain.joint
    return cellwise(domain, ("Lagrange", 1), joint.relative_thickness(profile, name)[joint.corners][..., None])


def director(domain: Domain) -> Expr:
    """Unit normal of S in the cells of the meshed layer, (d,), from the lower to the upper body; zero in bodies."""
    joint, band = domain.joint, domain.joint.band
    assert band is not None
    values = np.zeros((*joint.corners.shape, joint.dim))
    values[-len(band.director) :] = band.director
    n = cellwise(domain, ("DG", 1, (joint.dim,)), values)
    return n / ufl.sqrt(ufl.dot(n, n))


def shift(domain: Domain) -> fem.Function:
    """Displacement (d,) of each place by inflating: rigid for the bodies, away from S for the layer."""
    joint = domain.joint
    return cellwise(domain, ("Lagrange", joint.degree, (joint.dim,)), (joint.points - joint.reference)[joint.cells])
