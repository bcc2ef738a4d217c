"""Stations through the thickness: their energies against tensors in numpy, in 2D and 3D, and what a law may say of them."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scipy.spatial.transform import Rotation

from forms import LinearElastic, Stack
from forms.base import InputError
from forms.work import Interface, energy, s_terms

SUBLAYERS = [(0.3, 400.0, 20.0), (0.3, 20.0, 60.0), (0.4, 60.0, 5.0)]  # fraction, lmbda, mu
ONE = [(1.0, 60.0, 5.0)]
EPS = 0.07
TURN = {2: np.array([[0.8, -0.6], [0.6, 0.8]]), 3: Rotation.from_rotvec([0.4, -0.7, 0.2]).as_matrix()}


class Facet:
    """An interior facet of a turned mesh of simplices, with the measure dS of it alone.

    Attributes:
        normal: unit normal out of its "-" cell, (d,).
        upper: the "+" cell.
        places, weights: quadrature of degree 2 on it.
    """

    def __init__(self, d: int) -> None:
        cells = (1,) * d
        self.mesh = (mesh.create_unit_square if d == 2 else mesh.create_unit_cube)(MPI.COMM_SELF, *cells)
        self.mesh.geometry.x[:, :d] = self.mesh.geometry.x[:, :d] @ TURN[d].T
        self.mesh.topology.create_connectivity(d - 1, d)
        links = self.mesh.topology.connectivity(d - 1, d)
        inside = next(f for f in range(links.num_nodes) if len(links.links(f)) == 2)
        tags = mesh.meshtags(self.mesh, d - 1, np.array([inside], np.int32), np.array([1], np.int32))
        self.dS = ufl.Measure("dS", domain=self.mesh, subdomain_data=tags)(1)
        p = self.mesh.geometry.x[mesh.entities_to_geometry(self.mesh, d - 1, tags.indices)[0], :d]
        area = self.integral(1.0)
        number = fem.Function(fem.functionspace(self.mesh, ("DG", 0)))
        number.x.array[:] = np.arange(len(number.x.array))
        self.upper = np.rint([self.integral(number("+")) / area]).astype(np.int32)
        n = ufl.FacetNormal(self.mesh)("-")
        self.normal = np.array([self.integral(n[i]) for i in range(d)]) / area
        share = 0.5 - 12**-0.5
        pairs = [(0, 1, share), (1, 0, share)] if d == 2 else [(0, 1, 0.5), (1, 2, 0.5), (2, 0, 0.5)]
        self.places = [p[i] + y * (p[j] - p[i]) for i, j, y in pairs]
        self.weights = [area / len(pairs)] * len(pairs)

    def integral(self, f) -> float:
        return fem.assemble_scalar(fem.form(f * fem.Constant(self.mesh, 1.0) * self.dS))


def exact(sublayers, w, mean, slope, n):
    """Energy per area of sublayers with the strains along S of the shared jump, and equal tractions on planes along S.

    With the jump w, its gradient and that of the mean, (d, d), and acoustic tensors: the shares are R_i (mean of R)^-1.
    """
    identity = np.eye(len(n))
    sym = lambda a: (a + a.T) / 2
    stress = lambda lmbda, mu, e: lmbda * np.trace(e) * identity + 2 * mu * e
    R = [np.linalg.inv(mu * identity + (lmbda + mu) * np.outer(n, n)) for _, lmbda, mu in sublayers]
    K = np.linalg.inv(sum(a * r for (a, *_), r in zip(sublayers, R, strict=True)))
    places, phi = [], -identity / 2
    for (a, *moduli), r in zip(sublayers, R, strict=True):
        for y in (0.5 - 12**-0.5, 0.5 + 12**-0.5):
            along = (mean + (phi + y * a * r @ K) @ slope) @ (identity - np.outer(n, n))
            places.append((a / 2, moduli, r, sym(along)))
        phi = phi + a * r @ K
    t = K @ (w / EPS + sum(share * r @ stress(*moduli, e) @ n for share, moduli, r, e in places))
    whole = [e + sym(np.outer(r @ (t - stress(*moduli, e) @ n), n)) for _, moduli, r, e in places]
    pairs = zip(places, whole, strict=True)
    return sum(EPS * share * np.sum(e * stress(*moduli, e)) / 2 for (share, moduli, *_), e in pairs)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("sublayers", [SUBLAYERS, ONE], ids=["stack", "one law"])
def test_energy_of_the_stations(d, sublayers):
    """Of linear displacements on both sides of a tilted facet."""
    facet, random = Facet(d), np.random.default_rng(3)
    A, b, C, c = (random.normal(size=shape) for shape in ((d, d), d, (d, d), d))
    V = fem.functionspace(facet.mesh, ("DG", 1, (d,)))
    both, above = fem.Function(V), fem.Function(V)
    both.interpolate(lambda x: C @ x[:d] + c[:, None])
    above.interpolate(lambda x: A @ x[:d] + b[:, None], cells0=facet.upper)
    laws = [(a, LinearElastic(lmbda, mu)) for a, lmbda, mu in sublayers]
    terms = s_terms(Stack(*laws) if len(laws) > 1 else laws[0][1], Interface.between_bodies(facet.dS), EPS, 1)
    pairs = [*zip(facet.places, facet.weights, strict=True)]
    wanted = sum(weight * exact(sublayers, A @ x + b, C + A / 2, A, facet.normal) for x, weight in pairs)
    assert fem.assemble_scalar(fem.form(energy(terms, both + above))) == pytest.approx(wanted, rel=1e-11)


# ---------------------------------------------------------------- what laws say
def test_functions_need_sides_that_know_them():
    facet, law = Facet(2), LinearElastic(lambda x: 60 + x[0], 40.0)
    with pytest.raises(InputError, match=r" as functions of the place: use it in a Model"):
        s_terms(law, Interface.between_bodies(facet.dS), EPS, 1)
