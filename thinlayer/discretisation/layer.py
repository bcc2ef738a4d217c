"""Layers: a law of strains with a thickness, or a law on S alone, of jumps or of nodes; what such a law is at rest."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh

from forms.base import is_number
from forms.contact import ContactLaw
from forms.kinematics import MANDEL, ROOT2
from forms.law import BulkLaw, LawError
from forms.planes import Kinematics
from forms.series import folded
from forms.tangent import (
    Array,
    average_lame,
    is_checked_at_rest,
    known_at_rest,
    require_stable,
    tangent_over,
)
from forms.traction import TractionLaw
from geometry.joint import Joint, Profile
from geometry.refusals import unknown
from thinlayer.discretisation.given_strains import StrainGiven
from thinlayer.errors import ModelError, Refused

# keys of what laws remember and store, in states and in files
BY_LAW = "law"  # last part of the keys of laws that act where a layer is not meshed
LAYER, CONTACT, BODY, PRESSURE = "layer", "contact", "body", "pressure"
BODIES = "bodies"  # name of all bodies together, beside the names of seams
EDGES = (None, "free", "plain")
LawOnS = TractionLaw | ContactLaw  # laws without a thickness: of jumps, or of nodes


@dataclass(frozen=True)
class ThinLayer:
    """A soft layer between two bodies, or between a body and a rigid base.

    Attributes:
        law: the law of the layer's material. Sublayers in series: `Stack((fraction, law), ...)` from the lower to the
            upper face.
        eps: thickness, a length > 0; multiplied by the profile if it varies along S.
        at: thickness at which the law's parameters hold, a length > 0; None: eps. A family of layers for eps -> 0 has one
            `at` and one interface law: its parameters are those of `law` times (eps/at)**power, see `BulkLaw.powers`.
        order: of the interface law. 0: the limit, error O(eps). 1: the next term too, error O(eps^2) where the sides
            of the layer are on rollers, and away from its free ends where these are corrected, see `edges`; needs elements
            of degree 2, and bodies="extended" where S is curved or the thickness varies; a Stack of `LinearElastic`
            sublayers alone; other laws than `LinearElastic` and `Rubber` with lmbda/mu <= 12 at rest.
        profile: shape of a thickness that varies along S, a numpy function of coordinates x (d, n) that returns n numbers
            > 0: the thickness at the vertices of S is eps * profile(x), linear in between. The law's parameters do not vary
            with it.
        eigenstrain: strain that the layer would have without stress, as for bodies, see `Structure`; uniform through the
            thickness. On S the strain is [u] (x) n/eps less it, so that it enters the tractions of a soft layer at order
            eps: it changes the limit only if it is itself of the size of [u]/eps.
        edges: at free ends of S, straight ones, the interface law of order 1 is corrected by what a layer lacks there, so
            that its error is O(eps^2) away from them, too (`forms.ends.weights`): for `LinearElastic` with nu from 0 to
            0.45, `Rubber` and `Incompressible` between much stiffer bodies. None: where that holds
            (`InterfaceModel.free_ends` has the reason if not). "free": always; a model where it does not hold is refused.
            "plain": never.

    Raises:
        LawError: a law of jumps or of nodes, which is a layer by itself; eps, order or edges out of range; a law without
            one of order 1.
    """

    law: BulkLaw
    eps: float
    order: int = 0
    profile: Profile | None = None
    eigenstrain: StrainGiven | None = None
    edges: str | None = None
    at: float | None = None

    def __post_init__(self) -> None:
        if isinstance(self.law, LawOnS):
            raise LawError(
                f"{type(self.law).__name__} is a law on S and has no thickness: give it alone, structure.interface(law)"
            )
        if not isinstance(self.law, BulkLaw):
            raise LawError(f"the layer's law is {self.law!r}; it must be a law of strains, such as forms.LinearElastic")
        object.__setattr__(self, "law", folded(self.law))
        _check_thickness("layer's thickness eps", self.eps)
        if self.at is not None:
            _check_thickness("thickness at which the law's parameters hold, at,", self.at)
        if self.order not in (0, 1) or not is_number(self.order):
            raise LawError(f"the order of the interface law is {self.order!r}; allowed: 0, 1")
        if self.order == 1:
            self.law.stations()  # raises errors of laws without one of order 1
        if self.profile is not None and not callable(self.profile):
            raise LawError(f"the thickness profile is {self.profile!r}; it must be a function of coordinates")
        if self.edges not in EDGES:
            raise LawError(f"edges is {self.edges!r}; allowed: {', '.join(map(repr, EDGES))}")
        if self.edges == "free" and self.order != 1:
            raise LawError("edges='free' corrects the interface law of order 1; use order=1")

    @property
    def material(self) -> BulkLaw:
        """The law with the parameters of the layer's thickness."""
        return self.law.scaled(1.0 if self.at is None else float(self.eps) / float(self.at))

    @property
    def fractions(self) -> tuple[float, ...]:
        """Thickness fractions of the sublayers, from the lower to the upper face; () for a single layer."""
        fractions = tuple(a for a, _ in self.law.sublayers)
        return fractions if len(fractions) > 1 else ()


@dataclass(frozen=True)
class Gap:
    """An open joint of some width: nothing acts between its sides, and nothing keeps them from overlapping.

    A meshed model leaves the gap empty, an interface model knows no width: `Gap(eps)` is the same as None there.

    Attributes:
        eps: width, a length > 0.

    Raises:
        LawError: eps out of range.
    """

    eps: float

    def __post_init__(self) -> None:
        _check_thickness("gap's width eps", self.eps)


@dataclass(frozen=True)
class Bond:
    """A perfect bond in place of a layer: both sides of its seam move as one, and a rigid base holds its side.

    Interface models alone take it; in a meshed one leave the seam out of the joint.
    """


Layer = ThinLayer | LawOnS
OnSeam = Layer | Gap | Bond | None
Layers = Layer | Bond | Mapping[str, OnSeam]


def _check_thickness(what: str, eps: Any) -> None:
    if not (is_number(eps) and math.isfinite(eps) and eps > 0):
        raise LawError(f"the {what} is {eps!r}; allowed: > 0")


def on_seams(joint: Joint, given: Any) -> dict[str, Any]:
    """What is on each seam: one layer or bond for all, or {name of a seam: it; None or a `Gap` for an open joint}.

    They are in the order of the joint's seams, so that the order in which they are given makes no difference.

    Raises:
        ModelError: a seam has no layer, or a layer no seam.
    """
    if not isinstance(given, Mapping):
        return dict.fromkeys(joint.seams, given)
    for name in given:
        if name not in joint.seams:
            raise ModelError(f"layer: {unknown('seam', name, joint.seams)}")
    for name in joint.seams:
        if name not in given:
            raise ModelError(f"the seam {name!r} has no layer; give layer={{{name!r}: ..., ...}}")
    return {name: given[name] for name in joint.seams}


def layers_of(given: Mapping[str, Any]) -> dict[str, Any]:
    """The layer of each seam that has one."""
    return {name: layer for name, layer in given.items() if not isinstance(layer, Gap | Bond | None)}


def real_law(layer: Layer, kinematics: Kinematics) -> BulkLaw:
    """A layer's law for these kinematics; a law of jumps as one of strains."""
    return kinematics.law(layer.material) if isinstance(layer, ThinLayer) else layer.of_strains()


def constants(law: BulkLaw, mesh: Mesh) -> BulkLaw:
    """A law whose parameters are Constants, so that forms are compiled once for all their values.

    A law with parameters that are functions is given back as it is: `placed` makes what forms need.
    """
    return law if law.fields else law.mapped(lambda value, _: fem.Constant(mesh, np.asarray(value, float)))


def for_terms(law: BulkLaw, mesh: Mesh) -> BulkLaw:
    """A law as the terms on S have it: compiled, with its numbers, or with Constants in UFL forms."""
    return law.for_points() if law.fields else law if law.traits.compiled else constants(law, mesh)


class AtRest:
    """The law of a layer, or those of its sublayers, under small strains from rest.

    Args:
        law: law of the layer, with real parameters.
        n: mean normal of S, (d,).

    Attributes:
        sublayers: (share of the thickness, law, tangent at rest) of each sublayer, or of the layer if it has none. The
            tangent is (6, 6), or None if it is not known.
    """

    def __init__(self, law: BulkLaw, n: Array) -> None:
        self.law, self.n = law, n
        self.sublayers = [(share, one, known_at_rest(one, n)) for share, one in law.sublayers]

    def over(self, dt: float) -> list[Array | None]:
        """Tangents of the sublayers under loads that have lasted dt > 0; None: it is not known, or that at rest."""
        if dt not in self._over:
            self._over[dt] = [
                tangent_over(law, self.n, dt) if law.traits.compiled else None for _, law, _ in self.sublayers
            ]
        return self._over[dt]

    @cached_property
    def _over(self) -> dict[float, list[Array | None]]:
        return {}

    def through(self, y: Array) -> tuple[Array, Array]:
        """Phi_N and Phi_T at heights -1/2 <= y <= 1/2: displacements <u> + Phi [u] of sublayers in series.

        Linear where a tangent is not known.
        """
        n = np.pad(self.n, (0, 3 - len(self.n)))
        t = np.cross(n, np.eye(3)[np.abs(n).argmin()])
        shares, found = np.array([share for share, _, _ in self.sublayers]), []
        knots = np.concatenate([[0.0], np.cumsum(shares)]) - 0.5
        for way in (n, t / np.linalg.norm(t)):
            e = np.array([(way[i] * n[j] + way[j] * n[i]) / 2 * (1 if i == j else ROOT2) for i, j in MANDEL])
            stiffness = [1.0 if C is None else float(e @ C @ e) for _, _, C in self.sublayers]
            grown = np.concatenate([[0.0], np.cumsum(shares / stiffness)])
            found.append(np.interp(y, knots, grown / grown[-1] - 0.5))
        return found[0], found[1]

    def require_stable(self) -> None:
        """Raise LawError if a stiffness at rest is negative: equilibria would be unstable."""
        for _, law, C in self.sublayers:
            if is_checked_at_rest(law):
                require_stable(law, C, self.n)

    def locks(self) -> Refused | None:
        """Why the law of order 1 locks, as displacements are linear through the layer; None: it does not."""
        largest = min(station.largest_ratio for station in self.law.stations())
        for _, law, C in self.sublayers:
            lmbda, mu = (0.0, 1.0) if C is None else average_lame(C)
            if lmbda > largest * mu:
                ratios = [f"{x:.4g} (nu = {x / (x + 1) / 2:.4f})" for x in (lmbda / mu, largest)]
                reason = (
                    f"order=1 of {type(law).__name__} with lmbda/mu = {ratios[0]} at rest locks; allowed: {ratios[1]}"
                )
                elastic = not (law.traits.remembers or law.traits.rate)
                rubber = ", or Rubber or LinearElastic if it is isotropic" if elastic else ""
                return Refused("locks", reason, f"use order=0, or mesh the layer (structure.full){rubber}")
        return None
