"""FluxLaw: the law of a scalar field, such as a temperature, which gives a flux for the field's gradient and value."""

from __future__ import annotations

from typing import Any, ClassVar, Self

import numpy as np
import ufl

from forms.base import InputError
from forms.law import BulkLaw, Step, require_shape
from forms.tensors import Expr, scalar_gradient, scalar_strain, scalar_value, three_dimensional


class FluxStep(Step):
    """Input of a flux law at one point over a time step: a `Step` with gradients and values in place of strains.

    All vectors have 3 components in 2D, too. `g` and `T` are those at t + theta dt, the time at which fluxes balance.
    """

    @property
    def g(self) -> Expr:
        """Gradient (3,) of the field at t + theta dt."""
        return scalar_gradient(self.mid)

    @property
    def T(self) -> Expr:
        """Value of the field at t + theta dt."""
        return scalar_value(self.mid)

    @property
    def g_end(self) -> Expr:
        """Gradient (3,) of the field at the end of the step."""
        return scalar_gradient(self.e)

    @property
    def T_end(self) -> Expr:
        """Value of the field at the end of the step."""
        return scalar_value(self.e)

    @property
    def T_rate(self) -> Expr:
        """Rate of the field's value in the step.

        Raises:
            InputError: the law does not declare `rate`, or the problem has no time.
        """
        return scalar_value(self.rate)


def _in_ufl(value: Any, power: float) -> Expr:
    """Return a parameter, a number or array, as UFL, which cannot multiply numpy's; `power` is not used."""
    return ufl.as_tensor(value) if np.ndim(value) else ufl.as_ufl(value)


class FluxLaw(BulkLaw):
    """A law of a scalar field: temperature, electric potential, concentration over solubility, or pore pressure.

    Fluxes balance as stresses do, so that bodies, layers, marches and estimates treat the law as one of strains. The
    flux is k grad T, the analogue of the stress: heat flows against it. Subclasses are frozen dataclasses with their
    parameters as fields. They define `flux(step)`, UFL (3,), where `step` is a `FluxStep`. They may define
    `sink(step)`, what a unit of volume takes in per time: heat that it stores, or minus the heat of a source in it.
    A subclass with internal variables also defines `evolve(step)`. If the flux depends on the value T, or the sink on
    the gradient, the tangent is not symmetric: it declares `symmetric = False`.

    If a law defines `potential(step)`, results have its integral as an energy. The derivative of the potential by g_end
    is the flux, that by T_end the sink; a law with `rate` or internal variables returns the rest by `loss(step)`.
    """

    unknown = "scalar field"
    default_order = 1
    methods: ClassVar = ("flux", "evolve")
    renamed: ClassVar = {"stress": "flux", "advance": "evolve", "energy": "potential", "dissipation": "loss"}
    ignored: ClassVar = (*renamed, "elastic_moduli", "end_constants", "stations_at_ends", "plane_stress")

    def _traits_of_methods(self) -> dict[str, bool]:
        return super()._traits_of_methods() | {"has_energy": type(self).potential is not FluxLaw.potential}

    def flux(self, step: FluxStep) -> Expr:
        """Return the flux (3,), UFL, at t + theta dt; for heat it is the conductivity times the gradient."""
        raise InputError(f"{type(self).__name__} has no flux; a flux law needs a method flux(step)")

    def sink(self, step: FluxStep) -> Expr:
        """Return what a unit of volume takes in per time, UFL, at t + theta dt."""
        return ufl.as_ufl(0.0)

    def conductivity_across(self, n: Expr) -> Expr:
        """Return the flux along the unit vector `n` (d,) per gradient along n, UFL; the law must be linear."""
        n = three_dimensional(n)
        law = self.mapped(_in_ufl)
        return ufl.dot(law.flux(FluxStep(scalar_strain(n), n)), n)

    def evolve(self, step: FluxStep) -> dict[str, Expr]:
        """Return the internal variables at the end of the step, UFL by name."""
        names = ", ".join(self.internal)
        raise InputError(f"{type(self).__name__} gives no new {names}; a law with internal needs a method evolve(step)")

    def potential(self, step: FluxStep) -> Expr:
        """Return the potential of flux and sink per unit volume, UFL, at step.g_end and step.T_end."""
        raise InputError(f"{type(self).__name__} declares no potential; it needs a method potential(step) for it")

    def stress(self, step: Step) -> Expr:
        flux_step = FluxStep(*step)
        flux = require_shape(self, "flux", self.flux(flux_step), (3,))
        return scalar_strain(flux, require_shape(self, "sink", self.sink(flux_step), ()))

    def advance(self, step: Step) -> dict[str, Expr]:
        return self.evolve(FluxStep(*step)) if self.internal else {}

    def energy(self, step: Step) -> Expr:
        return self.potential(FluxStep(*step))

    def loss(self, step: FluxStep) -> Expr:
        """Return the loss per unit volume and time, UFL: power of flux and sink that does not change the potential.

        The power of loads in the rate of the field is the rate of the potential plus the loss.
        """
        return ufl.as_ufl(0.0)

    def dissipation(self, step: Step) -> Expr:
        return self.loss(FluxStep(*step))

    def plane_stress(self) -> Self:
        return self
