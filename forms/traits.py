"""Traits: what a law is like, in one value that models and solvers choose their methods by."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from forms.declarations import LawError


def always(_: Iterable[bool]) -> bool:
    """Fold of a trait that every Stack has, whatever its sublayers."""
    return True


def trait(fold: Callable[[Iterable[bool]], bool], default: bool = False) -> Any:
    """A field of `Traits`: how those of sublayers make that of their Stack, and what holds of laws that say nothing."""
    return field(default=default, metadata={"fold": fold})


@dataclass(frozen=True)
class Traits:
    """What a law is like. A class of laws declares a trait as an attribute, `linear = True`, or as a property.

    Each field says by `all` or `any` how the traits of sublayers make that of their Stack.

    Attributes:
        linear: the stress is affine in the strain at the end of a step.
        symmetric: the tangent is symmetric, as that of a law with an energy.
        quadratic: the stored energy is a quadratic function of strain and internal variables.
        rate: the stress depends on the strain rate. Such a law has no instantaneous response, and its strains do not jump
            in time; the others answer a sudden load at once.
        constrained: the strain has no trace, and a pressure is a field of its own.
        bounded: stresses are bounded in some direction, so that loads may have a limit.
        singular: the tangent of a law with an energy may vanish along some strains.
        softens: stresses fall as strains grow, so that a meshed layer would localise.
        plateau: strains across the layer may grow at constant stress, so that they need not be uniform through it.
        varies: parameters vary along the layer or in time; the law's `at` gives their values.
        phases: the internal variable "phase", a scalar in [-1, 1], is the share of the layer in phase 1, or -1.
        switches: phases are pure, one for each column of the layer, held in a solve and switched after it.

    Traits that the methods of a law tell:
        has_energy: the stored energy is declared, and so is the dissipation.
        eases: `eased` gives laws whose equilibria are found more easily.
        relaxes: `gradient` gives the strain that grows through the layer, for the interface law of order 1.
        in_series: the law can be a sublayer of a Stack.
        remembers: the law has internal values.
        in_ufl: its equations are written in UFL.
        of_jumps: the law is one of jumps, not of strains: there is no thickness in it.
        nodal: the law acts at the nodes of S.
        compiled: the law is compiled and acts on arrays of points, step by step; otherwise its stress is a part of a form.
    """

    linear: bool = trait(all)
    symmetric: bool = trait(all, default=True)
    quadratic: bool = trait(all)
    rate: bool = trait(any)
    constrained: bool = trait(any)
    bounded: bool = trait(any)
    singular: bool = trait(any)
    softens: bool = trait(any)
    plateau: bool = trait(any)
    varies: bool = trait(any)
    phases: bool = trait(any)
    switches: bool = trait(any)
    has_energy: bool = trait(all)
    eases: bool = trait(any)
    relaxes: bool = trait(all)
    in_series: bool = trait(all)
    remembers: bool = trait(any)
    in_ufl: bool = trait(all)
    of_jumps: bool = trait(any)
    nodal: bool = trait(any)
    compiled: bool = trait(always)

    @classmethod
    def of(cls, law: object, **told: bool) -> Traits:
        """The traits that a law declares, beside those that its methods tell.

        Raises:
            LawError: a declaration that is neither True nor False.
        """
        declared = {f.name: getattr(law, f.name, f.default) for f in fields(cls) if f.name not in told}
        for name, value in declared.items():
            if not isinstance(value, (bool, np.bool_)):
                raise LawError(f"{type(law).__name__}: {name} is {value!r}; a trait is True or False")
        return cls(**{name: bool(value) for name, value in (declared | told).items()})

    @classmethod
    def of_series(cls, sublayers: Iterable[Traits]) -> Traits:
        """The traits of sublayers in series."""
        known = list(sublayers)
        return cls(**{f.name: f.metadata["fold"](getattr(one, f.name) for one in known) for f in fields(cls)})
