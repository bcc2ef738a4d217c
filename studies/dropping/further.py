"""Further cases: bodies, surfaces, laws and supports of other kinds."""

from __future__ import annotations

from forms import KelvinVoigt, LinearElastic, Maxwell, Norton, Rubber, Stack
from studies.dropping.case import Case
from studies.dropping.known import of, of_real, soft
from studies.dropping.structures import (
    channel,
    corner,
    disc,
    freely,
    heated,
    on_base,
    plated,
    rings,
    tilted,
    tube,
    two_seams,
)
from thinlayer import Structure, ThinLayer, goals

young = LinearElastic.young
SUBLAYERS = Stack((0.3, LinearElastic(60.0, 40.0)), (0.7, LinearElastic(600.0, 20.0)))
VISCOUS = Norton(lmbda=50.0, mu=30.0, eta=1500.0, p=3.0)


def _channel(eps: float) -> Structure:
    return channel()


def _rings(eps: float) -> Structure:
    return rings()


def _tube(eps: float) -> Structure:
    return tube()


def _two(eps: float) -> dict[str, ThinLayer]:
    """A layer, and a thinner one above it."""
    return {"LOW": soft(30.0, 0.3)(eps), "HIGH": soft(10.0, 0.2)(eps / 2)}


def further_cases() -> list[Case]:
    """The cases."""
    work, moved = goals.Compliance(), goals.Displacement((0.3, 0.35), (0.6, 0.8))
    ends, middle = (work, moved), (work, moved, goals.MeanTraction((1.0, 0.0)))
    unlike = freely(load=(-0.6, 0.4), heights=(0.4, 0.7), lower=young(50.0, 0.2), upper=young(200.0, 0.35))
    sheet = freely(load=(0.5, -0.6), plane="stress")
    bonded = freely(load=(0.3, -1.0))
    return [
        Case("two stiffnesses", unlike, soft(15.0, 0.35), asked=ends),
        Case("tilted S", tilted, soft(30.0, 0.25)),
        Case("rigid base", on_base, soft(25.0, 0.3), asked=ends),
        Case("plane stress", sheet, soft(30.0, 0.3), asked=ends),
        Case("springs and a plate", plated, soft(30.0, 0.3), asked=ends),
        Case("two seams", two_seams, _two),
        Case("a body expands", heated, soft(30.0, 0.3), asked=(moved,)),
        Case("fixed moduli", bonded, of_real(young(3.0, 0.35)), asked=ends),
        Case("sublayers", _channel, of(SUBLAYERS), asked=middle),
        Case("rubber, rollers", _channel, of(Rubber.shear(20.0, 0.49)), asked=middle),
        Case("Norton, p = 3", _channel, of(VISCOUS), step=0.02, asked=middle),
        Case("Kelvin-Voigt", _channel, of(KelvinVoigt(60.0, 40.0, 0.3, 0.5)), step=0.2, asked=middle),
        Case("Maxwell", _channel, of(Maxwell(60.0, 40.0, 0.7, 1.5)), step=0.5, asked=middle),
        Case("rings", _rings, of(LinearElastic(60.0, 40.0)), bodies="extended"),
        Case("tubes", _tube, soft(30.0, 0.35)),
        Case("a disc", disc, soft(30.0, 0.3)),
        Case("a corner in 3D", corner, soft(30.0, 0.3), solid=True),
    ]
