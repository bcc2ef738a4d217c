"""The pressure of an incompressible layer: a field on the cells of the meshed layer, or on S."""

from __future__ import annotations

import dolfinx.fem.petsc
import ufl
from dolfinx import fem

from forms.work import Points
from geometry.domain import Domain
from thinlayer.pointwise.quadrature import Region


class Constraint:
    """int q tr e(u) = 0 for all pressures q, continuous of degree 1, beside displacements of degree 2. Collective.

    In the meshed layer this is the pair of Taylor and Hood. On S a multiplier of degree 1 meets jumps of degree 2.

    Attributes:
        region: the cells of the meshed layer, or S.
        space: the pressures.
        G: matrix of int q tr e(v), pressures by displacements.
        volume: a vector of its rows.
    """

    def __init__(self, domain: Domain, V: fem.FunctionSpace, points: Points) -> None:
        self.region = region = Region(domain, points.measure)
        self.space = fem.functionspace(region.mesh, ("Lagrange", 1))
        q, v = region.side(ufl.TestFunction(self.space)), ufl.TrialFunction(V)
        form = q * ufl.tr(points.strain(v)) * points.weight * points.measure
        self.G = dolfinx.fem.petsc.assemble_matrix(fem.form(form, entity_maps=region.maps))
        self.G.assemble()
        self.volume = self.G.createVecLeft()

    def destroy(self) -> None:
        """Free the matrix."""
        self.G.destroy()
        self.volume.destroy()
