"""Constants of the free end of a layer between rigid faces, in plane strain on the half strip x > 0, 0 < y < 1.

The faces y = 0 and y = 1 are moved by -w/2 and w/2, across the layer (N) or along it (T). The end x = 0 is free. Far
from it the strain is uniform; near it the layer is weaker. Lengths are relative to the thickness, stresses to mu.

A few quadrilaterals shrink towards the singular corner, with displacements of a high degree p and pressures of degree
p - 2. The pressures are discontinuous, so that nothing locks up to an incompressible material.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import basix.ufl
import dolfinx.mesh
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI
from scipy.sparse.linalg import splu

import thinlayer.system.compat  # noqa: F401  # before any form is compiled
from forms.base import Array
from forms.ends.constants import FreeEnd, flow_factor, lame_over_mu
from forms.tensors import Expr
from geometry.domain import create_mesh
from geometry.topology import BoolArray

MIDDLE_Y = 0.5  # y of the middle line; the half of the strip below it is solved
FAR_X = 14.0  # x at which fields that decay over the thickness are negligible
GRADING_RATIO = 0.2  # ratio of sizes of cells that shrink towards the corner
LEVELS, DEGREE = 10, 10  # number of times that cells shrink, and degree of displacements: constants to nine digits
SPLIT_LMBDA = -0.5  # first Lame modulus over mu of the stress without the pressure, which stays positive definite


def compute_free_end(nu: float, degree: int = DEGREE, levels: int = LEVELS) -> FreeEnd:
    """Compute the constants of a layer's free end, by finite elements on a half strip between rigid faces.

    Args:
        nu: Poisson's ratio, in [0, 0.5].
        degree: polynomial degree of the displacements, >= 3.
        levels: number of times that the size of cells decreases by the factor 0.2 towards the corner.

    Returns:
        The constants; lengths are relative to the thickness, stresses to the shear modulus.

    Raises:
        InputError: nu out of range.
    """
    lmbda = lame_over_mu(nu)
    delta = math.sqrt(lmbda / 12) if lmbda < math.inf else 0.0  # decay length of the pressure in case N
    mesh = _half_strip_mesh(levels, max(FAR_X, 24 * delta), 2 * delta)
    cell, variants = "quadrilateral", basix.LagrangeVariant
    u_element = basix.ufl.element("P", cell, degree, lagrange_variant=variants.gll_warped, shape=(2,))
    p_element = basix.ufl.element("P", cell, degree - 2, lagrange_variant=variants.legendre, discontinuous=True)
    W = fem.functionspace(mesh, basix.ufl.mixed_element([u_element, p_element]))
    (u, p), (v, q), x = ufl.TrialFunctions(W), ufl.TestFunctions(W), ufl.SpatialCoordinate(mesh)
    quadrature = {"quadrature_degree": 2 * degree + 5}
    dx = ufl.Measure("dx", domain=mesh, metadata=quadrature)
    end_facets = dolfinx.mesh.locate_entities_boundary(mesh, 1, lambda x: x[0] < GRADING_RATIO ** (levels + 1))
    tags = dolfinx.mesh.meshtags(mesh, 1, end_facets, np.ones(len(end_facets), np.int32))
    ds_end = ufl.Measure("ds", domain=mesh, subdomain_data=tags, metadata=quadrature)(1)

    def stress(u: Expr, p: Expr) -> Expr:
        return (SPLIT_LMBDA * ufl.div(u) + p) * ufl.Identity(2) + 2 * ufl.sym(ufl.grad(u))

    compliance = fem.Constant(mesh, 1 / (lmbda - SPLIT_LMBDA))
    form = ufl.inner(stress(u, p), ufl.grad(v)) * dx + q * (ufl.div(u) - compliance * p) * dx
    K = fem.assemble_matrix(fem.form(form)).to_scipy().tocsr()

    def locate_dofs(space: fem.FunctionSpace, where: Callable[[Array], BoolArray]) -> npt.NDArray[np.int32]:
        return np.asarray(fem.locate_dofs_geometrical((space, space.collapse()[0]), where)[0])

    face_dofs = locate_dofs(W.sub(0), lambda x: (x[1] < 1e-13) | np.isclose(x[0], x[0].max()))

    def solve_loaded(traction: Expr, zero_component: int) -> tuple[float, Callable[[Expr], float]]:
        """Solve the half strip with fixed faces under a traction on its end x = 0.

        Args:
            traction: the traction (2,), a function of the place.
            zero_component: displacement component that is zero on the middle line by symmetry, 0 for x, 1 for y.

        Returns:
            The work of the traction in its displacements; and a function that integrates f(stress) over the solved half
            of the strip, where f maps the stress (2, 2) to a UFL scalar.
        """
        load = fem.assemble_vector(fem.form(ufl.inner(traction, v) * ds_end)).array
        bc_dofs = np.union1d(face_dofs, locate_dofs(W.sub(0).sub(zero_component), lambda x: np.isclose(x[1], MIDDLE_Y)))
        free_dofs, w = np.setdiff1d(np.arange(len(load)), bc_dofs), fem.Function(W)
        w.x.array[free_dofs] = splu(K[free_dofs][:, free_dofs].tocsc()).solve(load[free_dofs])
        s = stress(*ufl.split(w))
        return float(load @ w.x.array), lambda f: float(fem.assemble_scalar(fem.form(f(s) * dx)))

    X, Y, zero = x[0], x[1] - MIDDLE_Y, 0 * x[0]
    # T: u_x is odd in y - 1/2; the end is pushed by mu w, which cancels the traction of the uniform strain
    work, integrate = solve_loaded(ufl.as_vector([zero, zero + 1]), zero_component=0)
    c_T, m_T = 2 * work, -2 * integrate(lambda s: s[0, 1] * X + s[0, 0] * Y)
    if nu == 0.5:
        # Poiseuille's flow out of the end, 1/8 - (y - 1/2)^2/2 with the pressure x, has a shear stress on it
        work, _ = solve_loaded(ufl.as_vector([zero, -Y]), zero_component=1)
        return FreeEnd(nu, math.inf, math.inf, math.inf, c_T, m_T, 1 / (1 - 24 * work))
    # N: u_y is odd in y - 1/2; the end is pressed by lmbda w, here by 1
    work, integrate = solve_loaded(ufl.as_vector([zero + 1, zero]), zero_component=1)
    M = lmbda + 2
    c_N, rho_N = 2 * work * lmbda**2 / M, -2 * integrate(lambda s: s[0, 0])
    m_N = -2 * lmbda / M * integrate(lambda s: s[1, 1] * X + s[0, 1] * Y)
    kappa = flow_factor(delta, c_N * M / lmbda - delta) if lmbda else 0.0
    return FreeEnd(nu, c_N, m_N, rho_N, c_T, m_T, kappa)


def _half_strip_mesh(levels: int, length: float, max_length: float) -> dolfinx.mesh.Mesh:
    """Mesh the half of the strip below its middle line, from x = 0 to `length`.

    Cells shrink `levels` times by the factor 0.2 towards the corner (0, 0). Far from the end x = 0 they are at most
    `max_length` long. Lengths are relative to the strip's height.
    """
    points, cells = [(0.0, 0.0)], []
    for size in MIDDLE_Y * GRADING_RATIO ** np.arange(levels, -1, -1.0):  # a square, then pairs of trapezoids around it
        k = len(points)
        points += [(size, 0.0), (0.0, size), (size, size)]
        cells += [[0, 1, 2, 3]] if k == 1 else [[k - 2, k - 1, k + 1, k + 2], [k - 3, k, k - 1, k + 2]]
    right_vertices, cell_length = [len(points) - 3, len(points) - 1], MIDDLE_Y
    while points[-1][0] < length:
        if points[-1][0] > FAR_X / 2:
            cell_length = max(cell_length, min(1.5 * cell_length, max_length))
        x, k = points[-1][0] + cell_length, len(points)
        points += [(x, 0.0), (x, MIDDLE_Y)]
        cells.append([right_vertices[0], k, right_vertices[1], k + 1])
        right_vertices = [k, k + 1]
    return create_mesh(MPI.COMM_SELF, np.array(points), np.array(cells), "quadrilateral")
