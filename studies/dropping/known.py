"""Cases whose effectivities another program has found, as far as their description goes.

What it does not say is chosen here: the layer's modulus and the load on unequal bodies with nu = 0.45, the load on the
bearing, the size of the cubic term, the strength and hardening of the plastic layer, the moduli and heights of the box.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import ufl

from forms import BulkLaw, LinearElastic, Norton, Rubber, VonMises
from forms.elastic import lame
from forms.kinematics import Expr
from forms.law import Step
from studies.dropping.case import Case
from studies.dropping.structures import box, displaced, freely, rollers
from thinlayer import Structure, ThinLayer, goals

COARSE, FINE = 1 / 16, 1 / 64
STEEL = LinearElastic.young(E=1e4, nu=0.3)
SOFT = LinearElastic.young(E=70.0, nu=0.3)
BEARING = Rubber.shear(0.01, 0.4999)  # moduli of a layer of any thickness
VISCOUS = Norton(lmbda=60.0, mu=40.0, eta=5.0, p=1.5)
STEP = 0.01


@dataclass(frozen=True)
class Hardening(BulkLaw):
    """Isotropic elasticity and a stress c (e:e) e."""

    lmbda: float
    mu: float
    c: float
    powers: ClassVar = {"lmbda": 1, "mu": 1, "c": 3}

    def stress(self, step: Step) -> Expr:
        """The stress."""
        return lame(self.lmbda, self.mu, step.e) + self.c * ufl.inner(step.e, step.e) * step.e

    def energy(self, step: Step) -> Expr:
        """Its potential."""
        square = ufl.inner(step.e, step.e)
        return self.lmbda / 2 * ufl.tr(step.e) ** 2 + self.mu * square + self.c / 4 * square**2


def of(law: BulkLaw) -> Callable[[float], ThinLayer]:
    """Thickness -> the layer of a family that has the parameters of this law at the thickness 1."""
    return lambda eps: ThinLayer(law, eps, at=1.0)


def of_real(law: BulkLaw) -> Callable[[float], ThinLayer]:
    """Thickness -> a layer of this material."""
    return lambda eps: ThinLayer(law, eps)


def soft(mu: float, nu: float) -> Callable[[float], ThinLayer]:
    """Thickness -> an elastic layer; mu is the shear modulus over the thickness."""
    return of(LinearElastic.shear(mu, nu))


def _rollers(eps: float) -> Structure:
    return rollers()


def _box(eps: float) -> Structure:
    return box()


WAVES = (goals.Compliance(), goals.Displacement((0.3, 0.4), (0.0, 1.0)))
ENDS = (goals.Compliance(), goals.Displacement((0.3, 0.4), (0.6, 0.8)))


def known_cases() -> list[Case]:
    """The cases; numbers as that program gave them, for the law that is the better one here."""
    R = Rubber.shear
    unequal = freely(load=(1.0, 0.0), lower=SOFT)
    steel = freely(load=(0.3, -1.0), lower=STEEL, upper=STEEL)
    hardening, plastic = Hardening(60.0, 40.0, 3e5), VonMises(60.0, 40.0, 0.3, hardening=100.0)
    rolling = {
        "1 rollers, nu = .3": (soft(40.0, 0.3), ((0.996, 1.01, None), (0.999, 1.0, None))),
        "3 rollers, nu = .45": (of(R(4.0, 0.45)), None),
        "4 rollers, nu = .499": (soft(40.0, 0.499), ((1.02, 1.005, 1.0), (1.005, 1.001, 0.999))),
        "5 rollers, nu = .4999": (soft(0.4, 0.4999), ((1.001, 1.001, 1.001), (1.0, 1.0, 1.0))),
        "14 cubic hardening": (of(hardening), ((0.996, 1.014, None), (0.999, 1.003, None))),
        "16 plastic": (of(plastic), ((0.987, 0.99, None), (0.997, 0.998, None))),
    }
    ended = {
        "6 free ends, nu = .3": (freely(), soft(40.0, 0.3), ((0.965, 0.987, 0.975), (0.993, 0.998, 0.995))),
        "8 unequal bodies, nu = .45": (unequal, soft(20.0, 0.45), ((0.94, 0.96, 0.92), (0.995, 0.989, 0.984))),
        "10 free ends, nu = .45": (freely(), of(R(40.0, 0.45)), ((1.008, 0.994, 1.025), (0.999, 0.999, 1.008))),
        "11 free ends, nu = .499": (freely(), soft(40.0, 0.499), ((1.045, 0.993, 1.04), (1.003, 0.999, 1.01))),
        "12 bearing, loaded": (steel, of_real(BEARING), ((1.02, 1.02, 1.02), (1.001, 1.002, 1.001))),
    }
    pressed = Case(
        "12d bearing, displaced",
        partial(displaced, body=STEEL),
        of_real(BEARING),
        asked=(goals.Reaction("TOP", (0.0, 1.0)), goals.MeanTraction((0.0, 1.0))),
        known=_at(((0.999, 0.999, 1.0), (0.997, 0.997, 0.998))),
        inner=True,
    )
    viscous = of(VISCOUS)
    return [
        *(Case(name, _rollers, one, asked=WAVES, known=_at(known)) for name, (one, known) in rolling.items()),
        *(
            Case(name, structure, one, asked=ENDS, known=_at(known), inner=True)
            for name, (structure, one, known) in ended.items()
        ),
        pressed,
        Case(
            "13 Norton",
            _rollers,
            viscous,
            step=STEP,
            asked=WAVES,
            known=_at(((1.002, 1.004, 1.003), (1.0, 1.001, 1.001))),
        ),
        Case(
            "15 Norton, free ends",
            freely(),
            viscous,
            step=STEP,
            asked=ENDS,
            known=_at(((1.001, 0.997, 0.996), (0.993, 0.998, 0.994))),
            inner=True,
        ),
        Case(
            "18 box, nu = .35",
            _box,
            of(R(40.0, 0.35)),
            known=_at(((1.004, 1.015, None), (0.995, 0.998, None))),
            solid=True,
        ),
        Case(
            "18 box, nu = .49",
            _box,
            soft(40.0, 0.49),
            known=_at(((1.01, 1.014, 0.997), (0.997, 1.001, 0.994))),
            solid=True,
        ),
    ]


def _at(
    known: tuple[tuple[float | None, ...], tuple[float | None, ...]] | None,
) -> dict[float, tuple[float | None, ...]]:
    return {} if known is None else dict(zip((COARSE, FINE), known, strict=True))
