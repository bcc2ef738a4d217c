"""Stack: a law of sublayers in series; and its interface law of order 1 for isotropic elastic sublayers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate
from typing import ClassVar

import ufl

from forms.base import Array, InputError, is_integer, require
from forms.elastic import LinearElastic
from forms.flux import FluxLaw
from forms.law import ORDER_0_REMEDY, BulkLaw, ChangeParameter
from forms.parameter_fields import ParameterField, ParameterValue
from forms.stations import GAUSS_RULES, AnyStation, Faces, Station
from forms.tensors import Expr, jump_strain, three_dimensional
from forms.traits import Traits, require_valid_declarations


class AveragedElastic(LinearElastic):
    """Isotropic elastic law whose moduli are weighted means of the sublayers' moduli, and may be negative."""

    def check(self) -> None:
        """Check nothing, since the laws of the sublayers have been checked."""


@dataclass(frozen=True)
class EqualTractionLaw(AveragedElastic):
    """Mean law of isotropic elastic sublayers that have the same traction on planes parallel to S.

    All means are over the thickness. Phi_N and Phi_T are functions of the height, from -1/2 at the lower to 1/2 at the
    upper face. The displacements at a height contain the normal jump times Phi_N, and the tangential jump times Phi_T
    (`sublayer_stations`).

    Attributes:
        lmbda, mu: moduli, stress. mu is the harmonic mean of the sublayers' mu, lmbda + 2 mu that of their lmbda + 2
            mu.
        mean_r: mean of r = lmbda/(lmbda + 2 mu), by which a layer with free faces thins per strain along S.
        mean_r_phi_n, mean_r_phi_t: means of r Phi_N and of r Phi_T.
        mean_phi_n, mean_phi_t: means of Phi_N and of Phi_T.
    """

    mean_r: float
    mean_r_phi_n: float
    mean_r_phi_t: float
    mean_phi_n: float
    mean_phi_t: float

    def strain(self, faces: Faces) -> Expr:
        """Return the strain (3, 3), UFL, whose stress by this law has the common traction of the sublayers.

        It is the mean strain across the layer, corrected for the strains along S.

        Args:
            faces: displacements of the faces of the layer.
        """
        n, mean_strain = three_dimensional(faces.n), faces.strain_across() + faces.mean_strain_s
        thinning_strain = faces.with_scaled_jump(self.mean_r_phi_n, self.mean_r_phi_t).strain_difference
        rotation_strain = faces.with_scaled_jump(self.mean_phi_n, self.mean_phi_t).strain_difference
        added_e_N = self.mean_r * ufl.tr(faces.in_plane(mean_strain)) + ufl.tr(faces.in_plane(thinning_strain))
        shear = 2 * ufl.dot(mean_strain + rotation_strain, n)
        shear -= ufl.dot(shear, n) * n
        return (ufl.dot(n, ufl.dot(mean_strain, n)) + added_e_N) * faces.n_dyad + jump_strain(shear, n)


def sublayer_stations(sublayers: tuple[tuple[float, BulkLaw], ...]) -> list[AnyStation]:
    """Return the stations of the interface law of order 1 for isotropic elastic sublayers.

    The displacements at a height in the layer are <u> + Phi [u], with the mean <u> and the jump [u] of the faces. Phi
    is Phi_N for the jump along n, and Phi_T for the jump along S. Both grow from -1/2 to 1/2, with derivatives
    proportional to 1/(lmbda + 2 mu) and to 1/mu. Each sublayer thus has the same part of the jump as in the law of
    order 0.

    Each sublayer gets a small additional strain across S. It makes the tractions on planes parallel to S equal in all
    sublayers; without it a nearly incompressible sublayer would lock. The stress is the sum of two: one with this
    traction, and one due to the strains along S. Their energies add up.

    The first station is `EqualTractionLaw`. The other three have the strains along S at Phi_T = -1/2, 0 and 1/2.
    The energy of the strains along S is quadratic in Phi_T. Weighted means of the moduli at the three stations make its
    integral over the sublayers exact.

    Args:
        sublayers: fraction of the thickness and law of each sublayer, from the lower to the upper face.

    Raises:
        InputError: a sublayer is not isotropic linear elastic.
    """
    fractions, moduli = [a for a, _ in sublayers], [law.elastic_moduli() for _, law in sublayers]

    def mean(values: Iterable[float]) -> float:
        return sum(a * value for a, value in zip(fractions, values, strict=True))

    M_values, mu = [lmbda + 2 * mu for lmbda, mu in moduli], [mu for _, mu in moduli]
    M_mean, mu_mean = 1 / mean(1 / modulus for modulus in M_values), 1 / mean(1 / modulus for modulus in mu)
    r = [lmbda / modulus for (lmbda, _), modulus in zip(moduli, M_values, strict=True)]
    steps_n = [a * M_mean / modulus for a, modulus in zip(fractions, M_values, strict=True)]
    steps_t = [a * mu_mean / mu_i for a, mu_i in zip(fractions, mu, strict=True)]
    # for each sublayer: means of Phi_N, Phi_T and Phi_T^2
    phi_n_means, phi_t_means = ([at + step / 2 for at, step in _start_and_step(steps)] for steps in (steps_n, steps_t))
    phi_t_square_means = [at * at + at * step + step * step / 3 for at, step in _start_and_step(steps_t)]

    def product(first: list[float], second: list[float]) -> list[float]:
        return [a * b for a, b in zip(first, second, strict=True)]

    def station_at(phi: float, weights: list[float]) -> AnyStation:
        law = AveragedElastic(2 * mean(product(product(weights, r), mu)), mean(product(weights, mu)))
        return Station(law, 1, lambda law, faces: faces.in_plane(faces.mean_strain_s + phi * faces.strain_difference))

    means = map(mean, (r, product(r, phi_n_means), product(r, phi_t_means), phi_n_means, phi_t_means))
    across_law = EqualTractionLaw(M_mean - 2 * mu_mean, mu_mean, *means)
    moments = list(zip(phi_t_square_means, phi_t_means, strict=True))
    low, middle = [2 * p - q for p, q in moments], [1 - 4 * p for p in phi_t_square_means]
    in_plane_stations = station_at(-0.5, low), station_at(0.0, middle), station_at(0.5, [2 * p + q for p, q in moments])
    return [Station(across_law, 1, EqualTractionLaw.strain), *in_plane_stations]


def conducting_stations(stack: Stack) -> list[AnyStation]:
    """Return the stations of the interface law for sublayers that conduct a scalar field, two in each sublayer.

    The field at a height is <T> + Phi [T], with the mean <T> and the jump [T] of the faces. Phi grows from -1/2 to 1/2,
    with a derivative proportional to 1/k, where k is the conductivity across the layer: the flux is uniform through
    the layer, as in the law of order 0. Where conductivities vary along S, Phi does, and the gradient along S contains
    [T] grad_S Phi.

    Args:
        stack: the law of the layer.

    Raises:
        InputError: a sublayer is not linear, so that its part of the jump is not known beforehand.
    """
    for law in (law for law in stack.laws if not law.traits.linear):
        reason = "is not linear, so its part of the jump is unknown; mesh the layer (structure.full)"
        raise InputError(f"Stack: {type(law).__name__} {reason}")

    def station_at(i: int, z: float) -> AnyStation:
        height = sum(stack.fractions[:i]) + (z + 0.5) * stack.fractions[i] - 0.5

        def strain(laws: Sequence[FluxLaw], faces: Faces) -> Expr:
            conductivities = [law.conductivity_across(faces.n) for law in laws]
            resistances = [a / k for a, k in zip(stack.fractions, conductivities, strict=True)]
            phi = sum(resistances[:i], (z + 0.5) * resistances[i]) / sum(resistances) - 0.5
            slope = resistances[i] / sum(resistances) / stack.fractions[i]
            e = slope * faces.strain_across(height) + faces.mean_strain_s + phi * faces.strain_difference
            gradient_along = faces.gradient_along if stack.fields else None
            return e + faces.across(faces.jump, gradient_along(phi)) if gradient_along else e

        return Station(stack.laws[i], stack.fractions[i] / 2, strain, strain_laws=stack.laws)

    return [station_at(i, z) for i in range(len(stack.laws)) for z, _ in GAUSS_RULES[2]]


def upper_share(stack: Stack, laws: Sequence[FluxLaw], n: Expr) -> Expr:
    """Return the share of a source, uniform through a stack, that goes into the upper face; UFL.

    It is the mean of the value at a height over the layer, if the lower face has the value 0 and the upper one 1.

    Args:
        stack: the law of the layer.
        laws: laws of its sublayers on S, which are linear, with UFL expressions as parameters.
        n: unit normal of S.
    """
    resistances = [a / law.conductivity_across(n) for a, law in zip(stack.fractions, laws, strict=True)]
    starts = accumulate(resistances[:-1], initial=ufl.as_ufl(0.0))
    parts = zip(stack.fractions, starts, resistances, strict=True)
    return sum(a * (start + R / 2) for a, start, R in parts) / sum(resistances)


def _start_and_step(steps: list[float]) -> Iterator[tuple[float, float]]:
    """Yield, for each sublayer from the lower face on, the value of Phi at its lower side and the increment over it.

    Phi is one of the functions in `sublayer_stations`, from -1/2 at the lower to 1/2 at the upper face. `steps` are its
    increments over the sublayers.
    """
    return zip(accumulate(steps[:-1], initial=-0.5), steps, strict=True)


@dataclass(frozen=True)
class Stack(BulkLaw):
    """Law of sublayers in series between the faces: tractions and in-plane strains are equal, jumps add up.

    Sublayers that conduct a scalar field must be linear on S; the flux across them is equal, and jumps add up.

    The meshed layer has cells for each sublayer. On S, with the mean strain e at a point, sublayer i has the strain e +
    sym(g_i (x) n). The vectors g_i are such that tractions are equal and sum_i a_i g_i = 0, with the fractions a_i of
    the thickness. The g_i are computed at each point. Each law has its own internal variables. A layer of equal linear
    sublayers has their common law.

    The compliances of linear elastic sublayers add up: K = (sum_i a_i K_i^-1)^-1. K_i is the stiffness that the layer
    would have with the law of sublayer i alone. For isotropic sublayers this gives the harmonic means of mu and of
    lmbda + 2 mu. Equation (52) of the paper prints these sums as stiffnesses, and averages lmbda alone.

    Attributes:
        fractions: fractions of the layer's thickness, from the lower to the upper face, > 0; their sum is 1.
        laws: laws of the sublayers, in the same order. A Stack among them is replaced by its sublayers.

    Raises:
        InputError: fractions are out of range, or a law cannot be a sublayer.

    Example:
        >>> from forms import LinearElastic, Stack
        >>> stiff, soft = LinearElastic(lmbda=8.0, mu=6.0), LinearElastic(lmbda=2.0, mu=1.0)
        >>> [share for share, _ in Stack((0.7, stiff), (0.3, soft)).sublayers]
        [0.7, 0.3]
    """

    fractions: tuple[float, ...]
    laws: tuple[BulkLaw, ...]
    ignored: ClassVar = ("stress", "advance", "energy", "dissipation", "dissipated")

    def __init__(self, *sublayers: tuple[float, BulkLaw]) -> None:
        try:
            nested_sublayers = [(float(a), getattr(law, "sublayers", ((1.0, law),))) for a, law in sublayers]
        except (TypeError, ValueError) as error:
            raise InputError(f"Stack needs pairs (fraction, law): {error}") from error
        sublayer_list = [(a * b, law) for a, inner in nested_sublayers for b, law in inner]
        vars(self).update(fractions=tuple(a for a, _ in sublayer_list), laws=tuple(law for _, law in sublayer_list))
        self.check()
        require_valid_declarations(self)

    def check(self) -> None:
        self.require(len(self.laws) > 0, "number of sublayers", ">= 1", 0)
        self.require(min(self.fractions) > 0, "fractions", "each > 0")
        total, allowed = sum(self.fractions), "laws that give a stress for a strain, point by point"
        self.require(abs(total - 1) < 1e-12, "sum of the fractions", "1", total)
        for law in self.laws:
            self.require(isinstance(law, BulkLaw) and law.traits.stackable, "a sublayer", allowed, law)
        unknowns = sorted({law.unknown for law in self.laws})
        self.require(len(unknowns) == 1, "sublayers", "laws of one unknown", f"laws of {' and '.join(unknowns)}")
        softening = [type(law).__name__ for law in self.laws if law.traits.softens]
        allowed = "at most one: of several, only the weakest would break, and equal ones would break together"
        self.require(len(softening) <= 1, "sublayers that soften", allowed, " and ".join(softening))

    @classmethod
    def graded(cls, law: Callable[[float], BulkLaw], n: int) -> Stack:
        """Return a stack of n equally thick sublayers for a layer whose law changes continuously through the thickness.

        Args:
            law: function that returns the law at a height, from 0 at the lower to 1 at the upper face of the layer. It
                is called for the middle of each sublayer, so that the error is O(1/n^2).
            n: number of sublayers, >= 1.
        """
        require(is_integer(n, 1), "Stack.graded: the number of sublayers", n, "allowed: whole numbers >= 1")
        return cls(*((1 / int(n), law((k + 0.5) / int(n))) for k in range(int(n))))

    @property
    def sublayers(self) -> tuple[tuple[float, BulkLaw], ...]:
        return tuple(zip(self.fractions, self.laws, strict=True))

    @property
    def unknown(self) -> str:  # type: ignore[override]  # a class attribute of other laws
        """Name of the unknown of the sublayers' laws."""
        return self.laws[0].unknown

    @property
    def default_order(self) -> int:  # type: ignore[override]
        """Order of the interface law if the user chooses none."""
        return self.laws[0].default_order

    @property
    def break_times(self) -> set[float]:
        return set().union(*(law.break_times for law in self.laws))

    @property
    def memory(self) -> int:
        return (3 * len(self.laws) if len(self.laws) > 1 else 0) + sum(law.memory for law in self.laws)

    @cached_property
    def traits(self) -> Traits:
        traits = Traits.of_series(law.traits for law in self.laws)
        return replace(traits, varies=True) if self.fields else traits

    @property
    def fields(self) -> dict[str, ParameterField]:
        return {f"{k}.{name}": parameter for k, law in enumerate(self.laws) for name, parameter in law.fields.items()}

    def fields_at(self, x: Array) -> dict[str, Array]:
        return {f"{k}.{name}": values for k, law in enumerate(self.laws) for name, values in law.fields_at(x).items()}

    def at_places(self, x: Array) -> Iterator[Stack]:
        for laws in zip(*(law.at_places(x) for law in self.laws), strict=True):
            yield self.with_laws(laws)

    def check_at(self, x: Array) -> None:
        for law in self.laws:
            law.check_at(x)

    def homotopy(self, parameter: float) -> Stack:
        return self.with_laws([law.homotopy(parameter) for law in self.laws])

    def stations(self) -> list[AnyStation]:
        if len(self.laws) == 1:
            return self.laws[0].stations()
        if self.unknown == FluxLaw.unknown:
            return conducting_stations(self)
        if self.fields:
            subject = "order=1 of a Stack with parameters that are functions"
            raise InputError(f"{subject}: the sublayers' shares of the jump would change along S; {ORDER_0_REMEDY}")
        return sublayer_stations(self.sublayers)

    def with_laws(self, laws: Sequence[BulkLaw]) -> Stack:
        """Return a stack with the same fractions of the thickness and the given laws, which are not checked."""
        return self.with_parameters({"laws": tuple(laws)})

    def mapped(self, change: ChangeParameter) -> Stack:
        return self.with_laws([law.mapped(change) for law in self.laws])

    def parameters(self) -> dict[str, ParameterValue]:
        """Return the parameters of all sublayers by name.

        "0.mu" is the parameter mu of the lowest sublayer, "1.mu" that of the next one.
        """
        return {f"{k}.{name}": value for k, law in enumerate(self.laws) for name, value in law.parameters().items()}

    def at(self, x: Array, t: float) -> dict[str, Array]:
        return {f"{k}.{name}": value for k, law in enumerate(self.laws) for name, value in law.at(x, t).items()}

    def check_dimension(self, d: int) -> None:
        for law in self.laws:
            law.check_dimension(d)

    def plane_stress(self) -> Stack:
        return self.with_laws([law.plane_stress() for law in self.laws])
