"""Singular stress field at the corner between a face and the free side of a layer.

Near this corner the layer is a wedge of 90 degrees, 0 < theta < pi/2. It is fixed at theta = 0 and traction-free at
theta = pi/2. Its stresses grow like H r^(lambda - 1) towards the corner (Williams 1952). With Muskhelishvili's
potentials phi = a z^lambda, psi = b z^lambda

    2 mu (u + i v) = kappa phi - z conj(phi') - conj(psi);   kappa = 3 - 4 nu;
    s_xx + s_yy = 4 Re phi';   s_yy - s_xx + 2 i s_xy = 2 (conj(z) phi'' + psi').
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import legendre

from forms.base import Array
from forms.ends.constants import lame_over_mu

ARC_GAUSS_POINTS = 24  # number of Gauss points on an arc around the corner


@dataclass(frozen=True)
class CornerField:
    """Singular field at the corner between a layer's free side and a rigid face, in plane strain; stresses are over mu.

    For plane stress give nu/(1 + nu) of the layer as nu. The polar angle is measured from the face into the layer.

    Attributes:
        nu: Poisson's ratio of the layer, in [0, 0.5].
    """

    nu: float

    def __post_init__(self) -> None:
        lame_over_mu(self.nu)  # raises InputError for a ratio out of range

    @cached_property
    def exponent(self) -> float:
        """Exponent lambda of stresses ~ r^(lambda - 1) near the corner, from 1 at nu = 0 to 0.595 at nu = 0.5.

        r is the distance from the corner. lambda is the only root from 0 to 1 of 4 kappa sin(lambda pi/2)^2 = (kappa +
        1)^2 - 4 lambda^2 with kappa = 3 - 4 nu.
        """
        k = 3 - 4 * self.nu

        def residual(power: float) -> float:
            return 4 * k * math.sin(power * math.pi / 2) ** 2 - (k + 1) ** 2 + 4 * power**2

        from scipy.optimize import brentq  # takes a while to import

        return float(brentq(residual, 0.0, 1.0, xtol=1e-15, rtol=1e-14)) if residual(1.0) > 0 else 1.0

    def _values(self, power: float, coefficients: Array, r: Array, angle: Array) -> tuple[Array, Array]:
        """Displacements (..., 2), for mu = 1, and stresses 11, 22, 12, (..., 3), of a field r^power.

        Args:
            power: exponent of the displacements.
            coefficients: (4,), real and imaginary part of a, then of b, in the potentials a z^power and b z^power.
            r, angle: polar coordinates (...) of the points.
        """
        a, b = coefficients[0] + 1j * coefficients[1], coefficients[2] + 1j * coefficients[3]
        z = r * np.exp(1j * angle)
        phi, d_phi, d2_phi = z**power, power * z ** (power - 1), power * (power - 1) * z ** (power - 2)
        u = ((3 - 4 * self.nu) * a * phi - z * np.conj(a * d_phi) - np.conj(b * phi)) / 2
        trace, deviator = 4 * (a * d_phi).real, 2 * (np.conj(z) * a * d2_phi + b * d_phi)
        stress = np.stack([(trace - deviator.real) / 2, (trace + deviator.real) / 2, deviator.imag / 2], axis=-1)
        return np.stack([u.real, u.imag], axis=-1), stress

    def _mode(self, power: float) -> Array:
        """Coefficients (4,) of a field without displacement on the face and without traction on the free side.

        Args:
            power: exponent of the displacements.
        """
        conditions = np.empty((4, 4))
        for k, unit in enumerate(np.eye(4)):
            face_u, _ = self._values(power, unit, np.array(1.0), np.array(0.0))
            _, side_stress = self._values(power, unit, np.array(1.0), np.array(np.pi / 2))
            conditions[:, k] = [*face_u, side_stress[0], side_stress[2]]
        return np.asarray(np.linalg.svd(conditions)[2][-1])

    @cached_property
    def _coefficients(self) -> Array:
        mode = self._mode(self.exponent)
        return mode / self._values(self.exponent, mode, np.array(1.0), np.array(0.0))[1][1]

    @cached_property
    def _dual_coefficients(self) -> Array:
        return self._mode(-self.exponent)

    def field(self, r: Array, angle: Array) -> tuple[Array, Array]:
        """The singular field with the intensity H = 1, whose normal traction on the face is r^(lambda - 1).

        Args:
            r, angle: polar coordinates (...) of points, from the corner and from the face.

        Returns:
            Displacements (..., 2), for mu = 1, and stresses 11, 22, 12, (..., 3), with axis 1 along the face.
        """
        return self._values(self.exponent, self._coefficients, np.asarray(r), np.asarray(angle))

    @property
    def shear(self) -> float:
        """Ratio of the tangential to the normal traction on the face; axis 1 points away from the corner."""
        return float(self.field(np.array(1.0), np.array(0.0))[1][2])

    @cached_property
    def _arc(self) -> tuple[Array, Array]:
        points, weights = legendre.leggauss(ARC_GAUSS_POINTS)
        return (points + 1) * np.pi / 4, weights * np.pi / 4

    def arc(self, r: float) -> Array:
        """Points (n, 2) on an arc of radius r around the corner, where `strength` takes displacements and stresses."""
        angles = self._arc[0]
        return r * np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def strength(self, r: float, u: Array, stress: Array) -> float:
        """Intensity H of the singular field, from displacements and stresses on an arc around the corner.

        H follows from Betti's reciprocity with the dual field, whose displacements are ~ r^(-lambda).

        The result does not depend on the radius if the face is fixed and the side is traction-free.

        Args:
            r: radius of the arc.
            u: displacements (n, 2) at the points of `arc` relative to the face, times mu.
            stress: stresses 11, 22, 12, (n, 3), at the points of `arc`.

        Returns:
            H, in units of stress times length^(1 - lambda).
        """
        return self._reciprocal(r, u, stress) / self._reciprocal(1.0, *self.field(np.array(1.0), self._arc[0]))

    def _reciprocal(self, r: float, u: Array, stress: Array) -> float:
        """Work of stresses in the dual field's displacements minus work of the dual field's stresses in u, on an arc.

        Args:
            r: radius of the arc.
            u: displacements (n, 2) at its points, times mu.
            stress: stresses 11, 22, 12, (n, 3), at its points.
        """
        angles, weights = self._arc
        dual_u, dual_stress = self._values(-self.exponent, self._dual_coefficients, np.array(r), angles)
        return float(weights @ (_work(stress, angles, dual_u) - _work(dual_stress, angles, u))) * r


def _work(stress: Array, angles: Array, u: Array) -> Array:
    """Work (n,), per length of arc, of the tractions on an arc around the corner in displacements u (n, 2).

    Args:
        stress: stresses 11, 22, 12, (n, 3), at the points.
        angles: polar angles (n,) of the points.
        u: displacements at the points.
    """
    c, s = np.cos(angles), np.sin(angles)
    t_x, t_y = stress[:, 0] * c + stress[:, 2] * s, stress[:, 2] * c + stress[:, 1] * s
    return np.asarray(t_x * u[:, 0] + t_y * u[:, 1])
