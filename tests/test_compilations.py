"""Forms and kernels are compiled once per law: not again for other thicknesses, parameters, steps or meshes."""

from __future__ import annotations

import dolfinx.jit
import pytest
import ufl

from forms.laws import Incompressible, KelvinVoigt, LinearElastic, Maxwell, Norton, Stack
from studies.problems import fourier
from thinlayer import Model, ThinLayer, compare, march


@pytest.fixture
def modules(monkeypatch):
    """Names of the compiled modules, one for each time that the compiler was asked."""
    names = []
    compiled = dolfinx.jit.ffcx_jit

    def recorded(*arguments, **options):
        found = compiled(*arguments, **options)
        names.append(found[1].__name__)
        return found

    monkeypatch.setattr(dolfinx.jit, "ffcx_jit", recorded)
    return names


def run(law, eps: float, times, h: float = 1 / 4, theta: float = 1.0, factor: float = 1.0) -> None:
    """Both models marched, and compared."""
    joint, setup = fourier(h, cell="quadrilateral")
    setup["tractions"] = {"TOP": lambda x, t: (0.1 * t, ufl.cos(ufl.pi * x[0]))}
    setup["body"] = LinearElastic.young(100.0 * factor, 0.3)
    layer = ThinLayer(law, eps)
    compare(*(march(build(joint, layer=layer, **setup), times, theta=theta) for build in (Model.full, Model.interface)))


@pytest.mark.parametrize(
    ("law", "other"),
    [
        (LinearElastic(60.0, 40.0), LinearElastic(50.0, 30.0)),
        (KelvinVoigt(60.0, 40.0, 0.3, 0.5), KelvinVoigt(50.0, 30.0, 0.2, 0.4)),
        (Maxwell(60.0, 40.0, 0.7), Maxwell(50.0, 30.0, 0.5, 2.0)),
        (Norton(60.0, 40.0, 5.0, 1.5), Norton(50.0, 30.0, 7.0, 3.0)),
        (Incompressible(40.0), Incompressible(30.0)),
        (
            Stack((0.4, Maxwell(60.0, 40.0, 0.7)), (0.6, KelvinVoigt(60.0, 40.0, 0.3, 0.5))),
            Stack((0.3, Maxwell(50.0, 30.0, 0.5)), (0.7, KelvinVoigt(50.0, 30.0, 0.2, 0.4))),
        ),
        (
            Stack((0.5, LinearElastic(60.0, 40.0)), (0.5, LinearElastic(30.0, 20.0))),
            Stack((0.2, LinearElastic(50.0, 40.0)), (0.8, LinearElastic(30.0, 10.0))),
        ),
    ],
    ids=lambda law: type(law).__name__,
)
def test_compiled_once(law, other, modules):
    run(law, 0.1, [0.1])
    first = set(modules)
    assert len(first) > 5
    for change in (
        dict(law=law, eps=0.05, times=[0.1, 0.2, 0.5], h=1 / 8),
        dict(law=other, eps=0.1, times=[0.1, 0.2], theta=0.5, factor=2.0),
    ):
        run(**change)
        assert set(modules) == first, change


@pytest.mark.parametrize("law", [Maxwell(60.0, 40.0, 0.7), Norton(60.0, 40.0, 5.0, 1.5), Incompressible(40.0)], ids=str)
@pytest.mark.parametrize("build", [Model.full, Model.interface])
def test_steps_ask_for_nothing(build, law, modules):
    """After the first state of a march nothing is asked of the compiler, not even what it has on the disk."""
    joint, setup = fourier(1 / 4, cell="quadrilateral")
    asked = []
    observe = {"asked": lambda state: asked.append(len(modules)) or 0.0}
    march(build(joint, layer=ThinLayer(law, 0.1), **setup), [0.1, 0.2, 0.3, 0.4], observe=observe)
    assert len(asked) == 5
    assert asked[0] > 0
    assert len(set(asked)) == 1


def test_a_stack_shares_the_kernels_of_its_laws(modules):
    """A stack of laws that were used alone asks for no new kernel on S."""
    joint, setup = fourier(1 / 4, cell="quadrilateral")

    def interface(law):
        march(Model.interface(joint, layer=ThinLayer(law, 0.1), **setup), [0.1])

    one, two = Maxwell(60.0, 40.0, 0.7), KelvinVoigt(60.0, 40.0, 0.3, 0.5)
    interface(one)
    interface(two)
    alone = set(modules)
    interface(Stack((0.4, one), (0.6, two)))
    assert set(modules) == alone
