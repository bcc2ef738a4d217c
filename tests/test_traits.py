"""What a law is like: one value, which sublayers in series fold into that of their Stack."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from forms import KelvinVoigt, LinearElastic, MohrCoulomb, NonMonotone, Stack
from forms.base import InputError
from forms.traits import Traits
from tests.own_laws import AgeingSpring
from tests.refused import refused

STIFF = LinearElastic(30.0, 20.0)
ACROSS = np.array([[0.0, 0.0], [0.0, 1.0]])


def halves(law, other):
    return Stack((0.5, law), (0.5, other))


def test_stacks_fold_every_trait():
    """Also the stored energy's, that of a plateau, and parameters that vary."""
    assert halves(LinearElastic(1.0, 1.0), STIFF).traits.has_quadratic_energy
    assert not halves(NonMonotone(0.0, 1.0, 1.0, 1.0, ACROSS), STIFF).traits.has_quadratic_energy
    assert halves(NonMonotone(0.0, 1.0, 1.0, 1.0, ACROSS), STIFF).traits.plateau
    assert halves(AgeingSpring(2.0, 0.5), STIFF).traits.varies
    mixed = halves(KelvinVoigt(1.0, 1.0, 1.0, 1.0), MohrCoulomb(1.0, 1.0, 1.0, 30.0)).traits
    has = "rate", "remembers", "bounded", "has_homotopy", "compiled", "has_energy", "has_quadratic_energy", "stackable"
    assert mixed == Traits(**dict.fromkeys(has, True), symmetric=False)


def test_a_stack_gives_the_parameters_of_its_sublayers_that_vary():
    x = np.array([[0.0, 1.0], [0.0, 0.0]])
    stack = halves(STIFF, AgeingSpring(2.0, 0.5, along=1.0))
    assert {name: value.tolist() for name, value in stack.at(x, 2.0).items()} == {"1.mu": [4.0, 8.0]}
    assert stack.parameters() == {"0.lmbda": 30.0, "0.mu": 20.0, "1.mu": 2.0, "1.growth": 0.5, "1.along": 1.0}


def test_traits_are_those_of_the_law_with_numbers():
    """Whatever stands for the numbers: symbols, constants, those of a real layer."""
    law = NonMonotone(3.0, 1.0, 1.0, 1.0, ACROSS, mixing=0.5)
    assert law.traits.softens
    assert law.with_parameters({"mixing": None}).traits == law.mapped(lambda value, _: None).traits == law.traits


def test_a_trait_is_true_or_false():
    vague = type("Vague", (LinearElastic,), {"linear": "yes"})
    refused(InputError, r"Vague: linear is .*; a trait is True or False", vague, 1.0, 1.0)


def test_every_trait_says_how_sublayers_fold():
    assert {f.metadata["fold"]([True, False]) for f in fields(Traits)} == {True, False}
    assert Traits.of_series([Traits(), Traits()]) == Traits(compiled=True)
