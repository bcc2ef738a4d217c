"""Values, options, laws and models that have no equilibrium path by arc length are refused."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from forms import (
    Cohesive,
    HolonomicCoulomb,
    Incompressible,
    KelvinVoigt,
    LinearElastic,
    Maxwell,
    MohrCoulomb,
    NonMonotoneUnrelaxed,
    VonMises,
)
from forms.base import InputError
from forms.traction import TractionLaw
from geometry import block
from tests.refused import refused
from tests.softening_bars import HEIGHT, STEEP, WIDTH, E, bar
from thinlayer import ArcLength, Structure, ThinLayer, march


def test_bad_values():
    for values, message in [
        ({"end": math.inf}, "end is inf; allowed: a number$"),
        ({"first": 0.0}, "first is 0.0; allowed: a number > 0"),
        ({"largest": 0.1, "smallest": 0.2}, "largest is 0.1; allowed: >= smallest = 0.2"),
        ({"steps": 0}, "steps is 0; allowed: a whole number > 0"),
    ]:
        refused(InputError, f"ArcLength: {message}", ArcLength, **{"end": 1.0, "first": 0.1} | values)


def test_bad_paths(tmp_path):
    for path, options, message in [
        (ArcLength(0.0, 0.1), {}, "end is 0; it must come after start = 0"),
        (ArcLength(1.0, 0.1, back=0.5), {}, "back is 0.5; it must be less than start = 0"),
        (ArcLength(1.0, 0.1), {"theta": 0.5}, "theta = 1"),
        (ArcLength(1.0, first=1e-200), {}, "lost in rounding"),
        (ArcLength(1e17 + 64, first=16.0), {"start": 1e17}, "lost in rounding"),
        (ArcLength(1.0, 0.1), {"options": {"ksp_nonsense": 1}}, "not read"),
    ]:
        refused(InputError, message, march, bar(STEEP), path, out=tmp_path / "out", **options)
        assert not (tmp_path / "out").exists()


@dataclass(frozen=True)
class Creeping(TractionLaw):
    """A spring and a dashpot in series, which declares no rate."""

    k: float
    tau: float
    internal: ClassVar = {"flow": (3,)}

    def evolve(self, step):
        x = step.dt / self.tau
        return {"flow": (step.q["flow"] + x * step.w) / (1 + x)}

    def traction(self, step):
        return self.k * (step.mid - self.evolve(step)["flow"])


def test_laws_that_have_no_path():
    for law, message in [
        (KelvinVoigt(60.0, 40.0, 0.3, 0.5), "KelvinVoigt depends on rates, and t is not a time on a path"),
        (Maxwell(60.0, 40.0, t1=0.7), "Maxwell creeps or relaxes, and t is not a time on a path"),
        (Creeping(7.0, 0.3), "Creeping creeps or relaxes"),
        (NonMonotoneUnrelaxed(60.0, 40.0, 0.2, 0.02, np.eye(2)), "NonMonotoneUnrelaxed has pure phases"),
        (MohrCoulomb(60.0, 40.0, 0.1, 30.0), "MohrCoulomb bounds stresses: on a path loads stay"),
    ]:
        refused(InputError, message, march, bar(law), ArcLength(1.0, 0.1))


def test_models_that_have_no_path():
    strip = block(WIDTH, HEIGHT, WIDTH, cell="quadrilateral", structured=True)
    setup = {"body": LinearElastic.young(E, 0.2), "supports": {"TOP": 0.0}}
    soft = Structure(strip, **setup).interface(ThinLayer(Incompressible(40.0), 0.1, at=1.0))
    with pytest.raises(InputError, match="Incompressible is incompressible: paths have displacements alone"):
        march(soft, ArcLength(1.0, 0.1))
    contact = Structure(strip, element="Q1", **setup).interface(HolonomicCoulomb(7.0, 3.0, friction=0.4))
    refused(
        InputError, "HolonomicCoulomb is a contact law: .*; march in time", lambda: march(contact, ArcLength(1.0, 0.1))
    )


def test_what_breaks_beside_what_yields():
    """Neither a path nor a march in time suits; the message names both laws."""
    body, joint = VonMises.young(70e3, 0.3, 200.0), block(1.0, 0.5, 0.25)
    structure = Structure(joint, body=body, supports={"TOP": {"x": 0, "y": lambda x, t: t}})
    model = structure.interface(Cohesive(1e4, 1e4, 20, 20, 0.3, 0.3))
    for times in ([0.01], ArcLength(0.01, 0.001)):
        refused(InputError, "VonMises bounds .*; Cohesive softens, which", march, model, times)
