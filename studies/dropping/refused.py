"""Structures whose estimate is no number, or lacks something, and says so."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from forms import (
    Anisotropic,
    BulkLaw,
    ContactLaw,
    HolonomicCoulomb,
    IncrementalCoulomb,
    LinearElastic,
    Maxwell,
    MohrCoulomb,
    NonMonotone,
    NonMonotoneUnrelaxed,
    Stack,
    VonMises,
)
from geometry import block, faults
from studies.dropping.structures import free, rollers
from studies.problems import FOURIER_BODY
from thinlayer import RangeWarning, State, Structure, ThinLayer, ThinlayerError, estimate, solve

EPS = 1 / 16
ELASTIC = LinearElastic.shear(30.0, 0.3)
SOFTER = LinearElastic.shear(20.0, 0.3)
OPENING = np.array([[0.0, 0.0], [0.0, 1.0]])


@dataclass(frozen=True)
class Refused:
    """A state of which no number can be told, or one that lacks something.

    Attributes:
        name: of the case.
        state: solves it.
        says: words that must be in what the estimate says.
        silent: whether no number may be told.
    """

    name: str
    state: Callable[[], State]
    says: str
    silent: bool = True

    def told(self) -> tuple[str, bool]:
        """What the estimate says, and whether it refuses or has no number of traction and jump."""
        with warnings.catch_warnings(action="ignore", category=RangeWarning):
            try:
                found = estimate(self.state())
            except ThinlayerError as error:
                return str(error), True
        return str(found), bool(np.isnan([found.traction, found.jump]).all())


def _ended(law: BulkLaw) -> Callable[[], State]:
    return lambda: solve(free(EPS).interface(ThinLayer(law, EPS, at=1.0)))


def _rolling(law: BulkLaw) -> Callable[[], State]:
    return lambda: solve(rollers().interface(ThinLayer(law, EPS, at=1.0)))


def _contact(law: ContactLaw) -> Callable[[], State]:
    """A block pushed along a rigid base."""

    def state() -> State:
        joint = block(1.0, 1.0, 1 / 8, structured=True)
        loads = {"TOP": (0.0, -1.0), "LEFT": (0.2, 0.0)}
        pushed = Structure(joint, body=FOURIER_BODY, supports={"RIGHT": {"x": 0.0}}, tractions=loads, element="P1")
        return solve(pushed.interface(law))

    return state


def _tip() -> State:
    """A fault that ends inside a block."""
    joint = faults(1.0, 1.0, {"CUT": ((-0.1, 0.5), (0.6, 0.5))}, 1 / 8)
    cut = Structure(joint, body=FOURIER_BODY, supports={"BOTTOM": 0.0}, tractions={"TOP": (0.3, -1.0)})
    return solve(cut.interface(ThinLayer(ELASTIC, EPS, at=1.0)))


def _varying() -> State:
    """Two blocks that meet on S, and a layer whose thickness varies."""
    layer = ThinLayer(ELASTIC, EPS, profile=lambda x: 1 + 0.3 * x[0], at=1.0)
    return solve(free(EPS).interface(layer))


def refused_cases() -> list[Refused]:
    """The cases."""
    slipping = MohrCoulomb(60.0, 40.0, cohesion=0.1, friction_angle=30.0, elastic_fraction=0.1)
    switching: dict[str, Any] = {"lmbda": 60.0, "mu": 40.0, "alpha": 0.3, "transformation_energy": 1e-3, "chi": OPENING}
    return [
        Refused("yields at a free end", _ended(VonMises(60.0, 40.0, 0.3, hardening=100.0)), "no estimate"),
        Refused("contact", _contact(HolonomicCoulomb(100.0, 40.0, friction=0.0)), "without a thickness"),
        Refused("friction", _contact(IncrementalCoulomb(100.0, 40.0, friction=0.5)), "without a thickness"),
        Refused("Mohr-Coulomb, slips", _rolling(slipping), "no estimate"),
        Refused("non-monotone, relaxed", _rolling(NonMonotone(**switching)), "falls"),
        Refused("non-monotone, pure phases", _rolling(NonMonotoneUnrelaxed(**switching)), "falls"),
        Refused("a tip inside a body", _tip, "tip"),
        Refused("thickness that varies", _varying, "true places"),
        Refused("creeps, nu = .48", _rolling(Maxwell(960.0, 40.0, 0.7)), "lmbda/mu"),
        Refused("changes cancel", _rolling(VonMises(60.0, 40.0, 0.3, hardening=100.0)), "below", silent=False),
        Refused(
            "free ends, as stiff as the bodies", _ended(LinearElastic.shear(300.0, 0.3)), "without edge", silent=False
        ),
        Refused("free ends, anisotropic", _ended(Anisotropic.springs(140.0, 40.0)), "no estimate without edge"),
        Refused("free ends, sublayers", _ended(Stack((0.3, ELASTIC), (0.7, SOFTER))), "no estimate without edge"),
        Refused("order 1 is given", lambda: solve(rollers().interface(ThinLayer(ELASTIC, EPS, 1, at=1.0))), "order=0"),
        Refused(
            "a meshed layer is given", lambda: solve(rollers().full(ThinLayer(ELASTIC, EPS, at=1.0))), "nothing dropped"
        ),
    ]
