"""Strains, axes of layers and Mandel vectors. In 2D, tensors get zeros in the third direction: plane strain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import ufl
from ufl.core.expr import Expr

from forms.base import Array

SQRT2 = 2.0**0.5


def three_dimensional(a: Expr) -> Expr:
    """Return a vector (2,) or a tensor (2, 2), UFL, filled up with zeros to (3,) or (3, 3).

    A vector (3,) or tensor (3, 3) is returned unchanged.
    """
    if a.ufl_shape[0] == 3:
        return a
    if len(a.ufl_shape) == 1:
        return ufl.as_vector([a[0], a[1], 0])
    return ufl.as_tensor([[a[0, 0], a[0, 1], 0], [a[1, 0], a[1, 1], 0], [0, 0, 0]])


def strain(u: Expr) -> Expr:
    """Return the small strain sym(grad u) (3, 3), UFL, of displacements `u`; Eq. (2) of the paper."""
    return three_dimensional(ufl.sym(ufl.grad(u)))


def jump_strain(w: Expr, n: Expr) -> Expr:
    """Return sym(w (x) n) = (w (x) n + n (x) w)/2, (3, 3), UFL, of a jump `w` and a unit normal `n`.

    Divided by the thickness, it is the strain that the jump causes in a layer.
    """
    return ufl.sym(ufl.outer(three_dimensional(w), three_dimensional(n)))


def scalar_strain(gradient: Expr, value: Expr = 0.0) -> Expr:
    """Return the tensor (3, 3), UFL, in which a scalar field's gradient and value stand for laws as a strain does.

    A flux and a sink in the same places are its stress: scalar_strain(q, b) : scalar_strain(g, T) = q . g + b T.

    Args:
        gradient: gradient (d,) of the field, or flux.
        value: value of the field, or sink.
    """
    g, off_diagonal = three_dimensional(gradient), value / SQRT2
    return ufl.as_tensor([[g[0], off_diagonal, 0], [off_diagonal, g[1], 0], [0, 0, g[2]]])


def scalar_gradient(e: Expr) -> Expr:
    """Return the gradient (3,), UFL, that a tensor of `scalar_strain` contains."""
    return ufl.as_vector([e[0, 0], e[1, 1], e[2, 2]])


def scalar_value(e: Expr) -> Expr:
    """Return the value, UFL, that a tensor of `scalar_strain` contains."""
    return SQRT2 * e[0, 1]


def scalar_gradients(values: Array) -> Array:
    """Return the gradients or fluxes (n, 3) that n tensors (n, 3, 3) of `scalar_strain` contain."""
    return np.asarray(np.einsum("nii->ni", values))


MANDEL_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
VALUE_INDEX = 3  # Mandel component that is the value of a scalar field, or the sink, see `scalar_strain`
# (6, 3, 3) symmetric tensors of norm 1
MANDEL_BASIS = np.array([np.outer(np.eye(3)[i], np.eye(3)[j]) for i, j in MANDEL_PAIRS])
MANDEL_BASIS += MANDEL_BASIS.swapaxes(1, 2)
MANDEL_BASIS /= np.linalg.norm(MANDEL_BASIS, axis=(1, 2), keepdims=True)


def mandel_vectors(tensors: Array) -> Array:
    """Return the Mandel vectors (..., 6) of the symmetric parts of numeric tensors (..., 3, 3).

    The order is 11, 22, 33, sqrt2 12, sqrt2 13, sqrt2 23.
    """
    return np.asarray(np.einsum("...ij,kij->...k", tensors, MANDEL_BASIS))


def mandel_tensors(vectors: Array) -> Array:
    """Return the symmetric tensors (..., 3, 3) of numeric Mandel vectors (..., 6).

    The order of the vectors is 11, 22, 33, sqrt2 12, sqrt2 13, sqrt2 23.
    """
    return np.asarray(np.einsum("...k,kij->...ij", vectors, MANDEL_BASIS))


def mandel_vector(a: Expr, indices: Sequence[int] = range(6)) -> Expr:
    """Return the Mandel vector of a symmetric tensor (3, 3), UFL.

    The order is 11, 22, 33, sqrt2 12, sqrt2 13, sqrt2 23. With the factors sqrt2 the product of two such vectors is the
    product A:B of the tensors.

    Args:
        a: the tensor.
        indices: indices, from 0 to 5, of the components that the vector has; by default all six.
    """
    return ufl.as_vector([a[i, j] if i == j else SQRT2 * a[i, j] for i, j in (MANDEL_PAIRS[k] for k in indices)])


def mandel_tensor(a: Expr) -> Expr:
    """Return the symmetric tensor (3, 3), UFL, of a Mandel vector `a` (6,), in the order of `mandel_vector`."""
    entries = {pair: a[k] if pair[0] == pair[1] else a[k] / SQRT2 for k, pair in enumerate(MANDEL_PAIRS)}
    return ufl.as_tensor([[entries[min(i, j), max(i, j)] for j in range(3)] for i in range(3)])


def isotropic_tensor(lmbda: float, mu: float) -> Array:
    """Return the stiffness tensor of an isotropic material as a matrix (6, 6) of Mandel components, stress."""
    identity_vector = np.repeat([1.0, 0.0], 3)
    return np.asarray(lmbda * np.outer(identity_vector, identity_vector) + 2 * mu * np.eye(6))


def condensed_tangent(C: Array, kept: Sequence[int], eliminated: Sequence[int]) -> Array:
    """Return the tangent of some components of strain if the stresses of other components are zero.

    It is the Schur complement of the tangent, a matrix with one row and column for each kept component.

    Args:
        C: tangent (6, 6) in Mandel's order.
        kept: indices, from 0 to 5, of the components of the result.
        eliminated: indices of the components whose stresses are zero.
    """
    inverse = np.linalg.pinv(C[np.ix_(eliminated, eliminated)])
    return np.asarray(C[np.ix_(kept, kept)] - C[np.ix_(kept, eliminated)] @ inverse @ C[np.ix_(eliminated, kept)])


def average_lame(C: Array) -> tuple[float, float]:
    """Return the Lame moduli lmbda, mu of the isotropic tensor nearest to a tangent C (6, 6) in Mandel's order.

    This is the mean of C over all rotations.
    """
    bulk = C[:3, :3].sum() / 9
    mu = (np.trace(C) - 3 * bulk) / 10
    return float(bulk - 2 * mu / 3), float(mu)


def layer_frame(n: Expr) -> Expr:
    """Return the rotation (3, 3), UFL, whose columns are the axes of a layer with the unit normal `n`.

    The second axis is n (3,). The rotation is that by the smallest angle which takes the second coordinate axis e_2 to
    n. For n = -e_2 this is not unique; the half turn about the third axis is taken. In 2D the first axis is the tangent
    (n_2, -n_1, 0).
    """
    opposite = ufl.lt(n[1], -1 + 1e-12)
    tangential_squared = n[0] * n[0] + n[2] * n[2]
    s_if_downward = (1 - n[1]) / ufl.conditional(opposite, 1, tangential_squared)  # = 1/(1 + n_2) without cancellation
    s = ufl.conditional(ufl.lt(n[1], 0), s_if_downward, 1 / ufl.conditional(ufl.lt(n[1], 0), 1, 1 + n[1]))
    row_1, row_3 = [1 - s * n[0] * n[0], n[0], -s * n[0] * n[2]], [-s * n[0] * n[2], n[2], 1 - s * n[2] * n[2]]
    rot = ufl.as_tensor([row_1, [-n[0], n[1], -n[2]], row_3])
    half_turn = ufl.as_tensor([[-1, 0, 0], [0, -1, 0], [0, 0, 1]])
    return ufl.as_tensor([[ufl.conditional(opposite, half_turn[i, j], rot[i, j]) for j in range(3)] for i in range(3)])
