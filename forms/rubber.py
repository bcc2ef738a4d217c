"""Layers with a pressure field: incompressible and nearly incompressible elasticity."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

from forms.base import Array
from forms.elastic import IsotropicLaw, LinearElastic, LinearLaw, lame_stress, poisson_ratio
from forms.ends.constants import FreeEnd, free_end
from forms.ends.weights import EndWeights
from forms.law import Step, require_positive
from forms.stations import AnyStation, Faces, Station
from forms.tensors import Expr, isotropic_tensor


class PressureLaw(LinearLaw):
    """Base of isotropic elastic laws with a pressure field p, stress = 2 mu e + p I; p > 0 is tension."""

    mu: float
    constrained = True
    _nu = 0.5  # Poisson's ratio

    def stress(self, step: Step) -> Expr:
        """Return the stress (3, 3), UFL, without the term p I of the pressure field."""
        return lame_stress(0, self.mu, step.mid)

    def stations(self) -> list[AnyStation]:
        """Return the two stations of the interface law of order 1, which has a pressure field on S.

        The first one has the mean strain through the thickness; there a gradient of the pressure lets the layer flow
        along S. The second one has the in-plane strain at the upper face minus that at the lower face. The stress of
        this change has no traction on planes parallel to S. Its law is therefore that of plane stress.
        """
        mean = Station(
            self, 1, lambda _, faces: faces.strain_across() + faces.mean_strain_s, lambda law: 1 / (12 * law.mu)
        )
        return [mean, Station(self.plane_stress(), 1 / 12, lambda _, faces: faces.in_plane(faces.strain_change))]

    def end_constants(self) -> FreeEnd | None:
        """Return the constants of a free end without those for openings; None if parameters vary along the layer.

        The pressure is zero at the free end, which already makes the law less stiff against openings there.
        """
        return None if self.fields else free_end(self._nu)._replace(c_N=0.0, rho_N=0.0)

    def stations_at_ends(self, weights: EndWeights) -> list[AnyStation]:
        """Return three stations near free ends.

        Two are those of `stations`; of these the first has the changed shear strain and flow. The third one has the
        second strain of `EndWeights.shear_strains`.

        Args:
            weights: changes of the interface law near free ends, UFL on S.
        """
        mean, in_plane = self.stations()

        def end_strain(law: PressureLaw, faces: Faces) -> Expr:
            return mean.strain(law, faces) + weights.shear_strains(faces)[0]

        end_station = replace(mean, strain=end_strain, mobility=lambda law: weights.flow_factor * mean.mobility(law))
        return [end_station, Station(in_plane.law, 1, lambda _, faces: weights.shear_strains(faces)[1]), in_plane]


@dataclass(frozen=True)
class Incompressible(PressureLaw):
    """Incompressible elasticity, stress = 2 mu e + p I with tr e = 0; the pressure p is an unknown field.

    As a layer's law with the jump w: w_N = 0, t_N = p is unknown, t_T = mu/eps w_T. The paper gives only the
    constraint, Eqs. (25)-(29). There is no penalty: tr e = 0 holds weakly, tested with all pressures of degree 1, in
    the meshed layer and on S. The interface law of order 1 is the limit of `Rubber` for infinite lmbda: a gradient of p
    makes the layer flow along S.

    Attributes:
        mu: shear modulus, stress; > 0.

    Raises:
        InputError: mu out of range.
    """

    mu: float
    powers: ClassVar = {"mu": 1}

    def check(self) -> None:
        require_positive(self, "mu")

    def plane_stress(self) -> LinearElastic:
        """Return the law of plane stress, which is linear elastic without a pressure field: in-plane strains are free.

        Incompressibility gives e_33 = -(e_11 + e_22), and sigma_33 = 0 gives p = 2 mu (e_11 + e_22).
        """
        return LinearElastic(1.0, 1.0).with_parameters({"lmbda": 2 * self.mu, "mu": self.mu})

    def stiffness(self, n: Array) -> Array:
        return isotropic_tensor(0.0, float(self.mu))


@dataclass(frozen=True)
class Rubber(PressureLaw, IsotropicLaw):
    """Isotropic elasticity with a pressure field: stress = 2 mu e + p I with p = lmbda tr e, for any lmbda/mu > 0.

    The material is that of `LinearElastic`. Here the pressure is an unknown field of degree 1 in the meshed layer and
    on S. Therefore nothing locks as lmbda/mu grows. In the interface law of order 1 (`ThinLayer(order=1)`) p is
    continuous on S and zero at free ends. Between stiff bodies it evens out over the length eps sqrt(lmbda/(12 mu)). It
    solves

        (eps/lmbda) p - div_S(eps^3/(12 mu) grad_S p) = [u_N] + eps div_S <u>,

    where [u_N] is the normal jump and <u> the mean displacement of both faces. The stiffness of the layer in shear is
    added to this (`forms.work.s_terms`). The error is O(eps^2) for all Poisson's ratios in (0, 1/2).

    Attributes:
        lmbda: first Lame modulus, stress; > 0.
        mu: shear modulus, stress; > 0.

    Raises:
        InputError: a modulus out of range.

    Example:
        >>> from forms import Rubber
        >>> from thinlayer import ThinLayer
        >>> bearing = ThinLayer(Rubber(lmbda=2000.0, mu=1.0), eps=0.2, order=1)
        >>> bearing.order
        1
    """

    @classmethod
    def young(cls, E: float, nu: float) -> Rubber:
        """Return the law with Young's modulus E > 0 (stress) and Poisson's ratio 0 < nu < 1/2."""
        return cls.shear(E / (2 * (1 + nu)), nu)

    @classmethod
    def shear(cls, mu: float, nu: float) -> Rubber:
        """Return the law with shear modulus mu > 0 (stress) and Poisson's ratio 0 < nu < 1/2."""
        return cls(LinearElastic.shear(mu, nu).lmbda, mu)

    def check(self) -> None:
        self.require(0 < self.lmbda < math.inf, "lmbda", "> 0 (other layers: LinearElastic)")
        require_positive(self, "mu")

    @property
    def _nu(self) -> float:  # type: ignore[override]
        return poisson_ratio(self)

    @property
    def volume_compliance(self) -> Expr:
        return 1 / self.lmbda

    def plane_stress(self) -> LinearElastic:
        return LinearElastic(1.0, 1.0).with_parameters(self.parameters()).plane_stress()
