"""The energy of a layer with free ends on meshes: never negative, whatever the cells; one that does not fade is."""

from __future__ import annotations

import dolfinx.fem.petsc
import numpy as np
import pytest
import ufl
from dolfinx import fem

from forms import LinearElastic, Rubber, work
from forms.ends import FreeEnd, free_end
from geometry import sandwich
from geometry.sheet import straight_ends
from thinlayer import Structure, ThinLayer
from thinlayer.discretisation.layer import FacetWeights

pytestmark = pytest.mark.few(5)

EPS = 0.05
BODY = LinearElastic.young(1e3, 0.3)
CELLS = (0.25, 1.0, 4.0, 16.0)  # along S, over the thickness
RIGID = 3  # motions in the plane


def model(law, h, edges):
    """Blocks of one row of cells; S is 4 cells wide, and 8 thicknesses at least."""
    joint = sandwich(EPS * max(4 * h, 8.0), EPS, EPS, h * EPS, cell="quadrilateral", structured=True)
    layer = ThinLayer(law, EPS, order=1, edges=edges, at=1.0)
    return Structure(joint, body=BODY, supports={"BOTTOM": 0.0}, tractions={}).interface(layer)


def eigenvalues(model, more=None):
    """Of the layer's matrix over the displacements that it resists, each over its own diagonal, ascending."""
    u, v = ufl.TrialFunction(model.V), ufl.TestFunction(model.V)
    form = work.work(model.layer_terms, u, v)
    matrix = dolfinx.fem.petsc.assemble_matrix(fem.form(form if more is None else form + more(u, v)))
    matrix.assemble()
    A = matrix[:, :]
    matrix.destroy()
    used = np.abs(A).max(axis=1) > 1e-12 * np.abs(A).max()
    A = A[np.ix_(used, used)]
    return np.linalg.eigvalsh(A / np.sqrt(np.abs(np.diag(A)).mean()) ** 2)


@pytest.mark.parametrize(("nu", "h"), zip([0.0, 0.2, 0.3, 0.45], CELLS, strict=True))
def test_no_displacement_has_a_negative_energy(nu, h):
    law = LinearElastic.shear(1.0, nu)
    free, plain = (eigenvalues(model(law, h, edges)) for edges in ("free", "plain"))
    assert free[0] > -1e-12 * free[-1]
    # beside rigid motions nothing is much softer than in an infinite layer
    assert plain[RIGID - 1] < 1e-12 * plain[-1]
    assert free[RIGID] > 0.3 * plain[RIGID]


@pytest.mark.parametrize("h", CELLS[:3])  # the pressure falls over 6.4 thicknesses
def test_nor_beside_a_pressure(h):
    spectrum = eigenvalues(model(Rubber.shear(1.0, 0.499), h, "free"))
    assert spectrum[0] > -1e-12 * spectrum[-1]


def test_openings_that_are_weaker_alone_are_not_convex():
    """c_N M taken off the stiffness of openings over one thickness, with all of the stress along S: nu = .45."""
    law = LinearElastic.shear(1.0, 0.45)
    plain_model = model(law, 0.25, "plain")
    c_N, layer, sides = free_end(0.45).c_N, plain_model.layers["S"], plain_model.sides_of("S")
    constants = FreeEnd(0.45, c_N, m_N=c_N / 2, rho_N=0.0, c_T=1e-12, m_T=1e-12, kappa=1.0)
    ends = straight_ends(plain_model.applicability["S"].free_rim, layer.sheet)
    weights = FacetWeights.of_ends(ends, layer.sheet, EPS, constants).expressions(plain_model.domain, sides)
    opened = lambda u: ufl.dot(sides.jump(u), sides.n)
    taken = lambda u, v: -weights.a_N * (law.lmbda + 2 * law.mu) * opened(u) * opened(v) * sides.measure
    spectrum = eigenvalues(plain_model, taken)
    assert spectrum[0] < -1e-3 * spectrum[-1]
