"""The pressure of an incompressible layer: a field on the cells of the meshed layer, or on S."""

from __future__ import annotations

import dolfinx.fem.petsc
import ufl
from dolfinx import fem
from petsc4py import PETSc

from forms.work import Term
from thinlayer.pointwise.quadrature import Region


class Constraint:
    """int q tr e(u) = 0 for all pressures q, continuous of degree 1, beside displacements of degree 2. Collective.

    In the meshed layer this is the pair of Taylor and Hood. On S a multiplier of degree 1 meets jumps of degree 2.

    Attributes:
        region: the cells of the meshed layer, or S.
        space: the pressures.
        unit: what G is multiplied by; unknown pressures are over it. 1 until `weigh`.
        G: matrix of int q tr e(v), times the unit, pressures by displacements.
        volume: a vector of its rows.
    """

    def __init__(self, V: fem.FunctionSpace, term: Term) -> None:
        self.region = region = Region(V.mesh, term.measure)
        self.space = fem.functionspace(region.mesh, ("Lagrange", 1))
        q, v = region.side(ufl.TestFunction(self.space)), ufl.TrialFunction(V)
        form = q * ufl.tr(term.strain(v)) * term.weight * term.measure
        self.G = dolfinx.fem.petsc.assemble_matrix(fem.form(form, entity_maps=region.maps))
        self.G.assemble()
        self.unit = 1.0
        self.volume = self.G.createVecLeft()

    def weigh(self, stiffness: float) -> None:
        """Make the rows of G forces, like those of the balance: residuals of both are of one unit then.

        Args:
            stiffness: force over displacement that the bodies answer a node with, > 0.
        """
        unit = stiffness / self.G.norm(PETSc.NormType.INFINITY)
        self.G.scale(unit)
        self.unit *= unit

    def destroy(self) -> None:
        """Free the matrix."""
        self.G.destroy()
        self.volume.destroy()
