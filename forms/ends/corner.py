"""Singular stress field at the corner between a face and the free side of a layer.

Near this corner the layer is a wedge of 90 degrees, 0 < theta < pi/2. It is fixed at theta = 0 and traction-free at
theta = pi/2. Its stresses grow like H r^(lambda - 1) towards the corner (Williams 1952). lambda is this exponent, not a
modulus. With Muskhelishvili's potentials phi = a z^lambda, psi = b z^lambda

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
    """Singular elastic field at the corner between the free side of a layer and a rigid face, in plane strain.

    For plane stress give nu/(1 + nu) of the layer as nu. Stresses are divided by the layer's shear modulus mu. The
    polar angle is measured from the face into the layer.

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

    def _power_field(self, power: float, coefficients: Array, r: Array, angle: Array) -> tuple[Array, Array]:
        """Return the displacements and stresses of a field whose displacements are proportional to r^power.

        The shear modulus is 1.

        Args:
            power: exponent of the displacements.
            coefficients: (4,) real and imaginary part of a, then of b, in the potentials a z^power and b z^power.
            r, angle: polar coordinates of the points, two arrays of one shape.

        Returns:
            Displacements along and normal to the face, with 2 components on a last axis, and stresses s_xx, s_yy, s_xy,
                with 3.
        """
        a, b = coefficients[0] + 1j * coefficients[1], coefficients[2] + 1j * coefficients[3]
        z = r * np.exp(1j * angle)
        phi, d_phi, d2_phi = z**power, power * z ** (power - 1), power * (power - 1) * z ** (power - 2)
        u = ((3 - 4 * self.nu) * a * phi - z * np.conj(a * d_phi) - np.conj(b * phi)) / 2
        trace, deviator = 4 * (a * d_phi).real, 2 * (np.conj(z) * a * d2_phi + b * d_phi)
        stress = np.stack([(trace - deviator.real) / 2, (trace + deviator.real) / 2, deviator.imag / 2], axis=-1)
        return np.stack([u.real, u.imag], axis=-1), stress

    def _mode_coefficients(self, power: float) -> Array:
        """Return coefficients (4,) with which displacements on the face and tractions on the free side are zero.

        The coefficients are those of `_power_field`, up to a common factor. `power` is the displacements' exponent.
        """
        boundary_matrix = np.empty((4, 4))
        for k, unit_vector in enumerate(np.eye(4)):
            face_u, _ = self._power_field(power, unit_vector, np.array(1.0), np.array(0.0))
            _, side_stress = self._power_field(power, unit_vector, np.array(1.0), np.array(np.pi / 2))
            boundary_matrix[:, k] = [*face_u, side_stress[0], side_stress[2]]
        return np.asarray(np.linalg.svd(boundary_matrix)[2][-1])

    @cached_property
    def _coefficients(self) -> Array:
        coefficients = self._mode_coefficients(self.exponent)
        return coefficients / self._power_field(self.exponent, coefficients, np.array(1.0), np.array(0.0))[1][1]

    def unit_field(self, r: Array, angle: Array) -> tuple[Array, Array]:
        """Return displacements and stresses of the singular field whose normal traction on the face is r^(lambda - 1).

        Its intensity H is 1, and the shear modulus is 1. Axis 1 points along the face, axis 2 into the layer.

        Args:
            r: distances of points from the corner.
            angle: angles of the points from the face, radians, an array of the shape of `r`.

        Returns:
            Displacements, with 2 components on a last axis, and stresses s_11, s_22, s_12, with 3 components on it.
        """
        return self._power_field(self.exponent, self._coefficients, np.asarray(r), np.asarray(angle))

    @property
    def t_ratio(self) -> float:
        """Ratio of the tangential to the normal traction on the face.

        A positive tangential traction points away from the corner.
        """
        return float(self.unit_field(np.array(1.0), np.array(0.0))[1][2])

    @cached_property
    def _arc_rule(self) -> tuple[Array, Array]:
        points, weights = legendre.leggauss(ARC_GAUSS_POINTS)
        return (points + 1) * np.pi / 4, weights * np.pi / 4

    def arc_points(self, r: float) -> Array:
        """Return points (n, 2) on an arc of radius `r` around the corner; `intensity` needs the fields there.

        The first coordinate is the distance from the corner along the face, the second the distance from the face.
        """
        angles = self._arc_rule[0]
        return r * np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def intensity(self, r: float, u: Array, stress: Array) -> float:
        """Return the intensity H of the singular field in a solution, from values on an arc around the corner.

        H follows from Betti's reciprocity with the dual field, whose displacements are proportional to r^(-lambda). It
        does not depend on the radius if the face is fixed and the free side has no traction.

        Args:
            r: radius of the arc.
            u: displacements (n, 2) at the points of `arc_points`, minus those of the face, times mu.
            stress: stresses s_11, s_22, s_12, (n, 3), at the points of `arc_points`.

        Returns:
            H, in units of stress times length^(1 - lambda).
        """
        return self._betti_sum(r, u, stress) / self._betti_sum(1.0, *self.unit_field(np.array(1.0), self._arc_rule[0]))

    def _betti_sum(self, r: float, u: Array, stress: Array) -> float:
        """Return the integral over an arc of traction times dual displacement minus dual traction times displacement.

        "Dual" are the values of the field with displacements proportional to r^(-lambda). The tractions are those on
        the arc.

        Args:
            r: radius of the arc.
            u: displacements (n, 2) at the points of `arc_points`, times mu.
            stress: stresses s_11, s_22, s_12, (n, 3), at the points of `arc_points`.
        """
        (angles, weights), dual = self._arc_rule, self._mode_coefficients(-self.exponent)
        dual_u, dual_stress = self._power_field(-self.exponent, dual, np.array(r), angles)
        return float(weights @ (_work_density(stress, angles, dual_u) - _work_density(dual_stress, angles, u))) * r


def _work_density(stress: Array, angles: Array, u: Array) -> Array:
    """Return the work (n,) per length of an arc around the corner that the tractions on it do in given displacements.

    Args:
        stress: stresses s_11, s_22, s_12, (n, 3), at n points of the arc.
        angles: polar angles (n,) of the points, radians.
        u: displacements (n, 2) at the points.
    """
    c, s = np.cos(angles), np.sin(angles)
    t_x, t_y = stress[:, 0] * c + stress[:, 2] * s, stress[:, 2] * c + stress[:, 1] * s
    return np.asarray(t_x * u[:, 0] + t_y * u[:, 1])
