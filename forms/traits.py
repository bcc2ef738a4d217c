"""Traits: the properties of a law by which models and solvers choose their methods."""

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
    """A field of `Traits`: `fold` makes the trait of a Stack from those of its sublayers; `default` if not declared."""
    return field(default=default, metadata={"fold": fold})


@dataclass(frozen=True)
class Traits:
    """Properties of a law. A class of laws declares a trait as an attribute, `linear = True`, or as a property.

    A Stack has a trait if `all` or if `any` of its sublayers have it; each field says which.

    Attributes:
        linear: the stress is affine in the strain at the end of a step.
        symmetric: the tangent is symmetric, as for every law with an energy.
        quadratic: the stored energy is a quadratic function of strain and internal variables.
        rate: the stress depends on the strain rate, so strains cannot jump in time. Without this trait a law responds to a
            sudden load at once.
        constrained: the pressure p is a separate unknown field; tr e is p times the law's `volume_compliance`, perhaps 0.
        bounded: the stress is bounded in some direction, so there may be a limit load.
        singular: the tangent may be singular for some strains; Newton's method adds a Levenberg-Marquardt term.
        isochoric: the law flows without a change of volume, which elements must not prevent.
        softens: the stress falls as strains grow, so strains in a meshed layer would localise.
        plateau: strains across the layer may grow at constant stress, so they may be non-uniform through the layer.
        varies: parameters vary along the layer or in time; the law's `at` gives their values.
        phases: the internal variable "phase", a scalar in [-1, 1], is the share of the layer in phase 1, or -1.
        switches: each column of the layer is in one phase, which is fixed during a solve and may switch after it.

    Traits that follow from the methods of a law:
        has_energy: stored energy and dissipation are declared.
        eases: `eased` gives laws whose equilibrium is easier to find, for continuation.
        in_series: the law can be a sublayer of a Stack.
        remembers: the law has internal variables.
        in_ufl: the equations are written in UFL.
        of_jumps: the law is a function of jumps, not of strains, and has no thickness.
        nodal: the law acts at the nodes of S.
        compiled: the law is compiled and evaluated on arrays of points; otherwise its stress is a part of a UFL form.
    """

    linear: bool = trait(all)
    symmetric: bool = trait(all, default=True)
    quadratic: bool = trait(all)
    rate: bool = trait(any)
    constrained: bool = trait(any)
    bounded: bool = trait(any)
    singular: bool = trait(any)
    isochoric: bool = trait(any)
    softens: bool = trait(any)
    plateau: bool = trait(any)
    varies: bool = trait(any)
    phases: bool = trait(any)
    switches: bool = trait(any)
    has_energy: bool = trait(all)
    eases: bool = trait(any)
    in_series: bool = trait(all)
    remembers: bool = trait(any)
    in_ufl: bool = trait(all)
    of_jumps: bool = trait(any)
    nodal: bool = trait(any)
    compiled: bool = trait(always)

    @classmethod
    def of(cls, law: object, **of_methods: bool) -> Traits:
        """The traits that a law declares, and those that follow from its methods (`of_methods`).

        Raises:
            LawError: a declaration that is neither True nor False.
        """
        declared = {f.name: getattr(law, f.name, f.default) for f in fields(cls) if f.name not in of_methods}
        for name, value in declared.items():
            if not isinstance(value, (bool, np.bool_)):
                raise LawError(f"{type(law).__name__}: {name} is {value!r}; a trait is True or False")
        return cls(**{name: bool(value) for name, value in (declared | of_methods).items()})

    @classmethod
    def of_series(cls, sublayers: Iterable[Traits]) -> Traits:
        """The traits of sublayers in series."""
        known = list(sublayers)
        return cls(**{f.name: f.metadata["fold"](getattr(one, f.name) for one in known) for f in fields(cls)})
