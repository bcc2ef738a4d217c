"""Bodies on softening interfaces along their equilibrium paths; as a program, OUT ROW, killed at a row."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import ufl

from forms import LinearElastic
from forms.traction import TractionLaw
from geometry import block
from tests.own_laws import layer_of
from tests.ranks import Ending
from thinlayer import ArcLength, Structure, march

E, HEIGHT, WIDTH = 2.3, 1.7, 0.85


def opening(step):
    """[u].n."""
    return ufl.dot(step.w, step.n)


def across_and_along(w, normal, k_T, step):
    """Traction with the given one across S, and springs k_T along it."""
    return normal * step.n + k_T * (step.mid - w * step.n)


def energy_along(k_T, step):
    along = step.w - opening(step) * step.n
    return k_T * ufl.inner(along, along) / 2


@dataclass(frozen=True)
class Trilinear(TractionLaw):
    """Across S: k w up to w_1, falling by `fall` per length from there to w_2, then rising with k again."""

    k: float
    fall: float
    w_1: float
    w_2: float
    k_T: float

    def sigma(self, w, choose):
        """Traction at an opening w; choose(a, b, x, y) is x where a < b, else y."""
        low = self.k * self.w_1 - self.fall * (self.w_2 - self.w_1)
        falling, rising = self.k * self.w_1 - self.fall * (w - self.w_1), low + self.k * (w - self.w_2)
        return choose(w, self.w_1, self.k * w, choose(w, self.w_2, falling, rising))

    def traction(self, step):
        w = ufl.dot(step.mid, step.n)
        return across_and_along(w, self.sigma(w, chosen), self.k_T, step)

    def energy(self, step):
        w = opening(step)
        a, b, length, peak = w - self.w_1, w - self.w_2, self.w_2 - self.w_1, self.k * self.w_1
        at_1 = peak * self.w_1 / 2
        at_2 = at_1 + peak * length - self.fall * length**2 / 2
        falling = at_1 + peak * a - self.fall * a**2 / 2
        rising = at_2 + (peak - self.fall * length) * b + self.k * b**2 / 2
        normal = chosen(w, self.w_1, self.k * w**2 / 2, chosen(w, self.w_2, falling, rising))
        return normal + energy_along(self.k_T, step)


def chosen(a, b, x, y):
    return ufl.conditional(ufl.lt(a, b), x, y)


@dataclass(frozen=True)
class Damage(TractionLaw):
    """k w exp(-m/w_0) across S, with the largest opening m so far: unloading leads to the origin."""

    k: float
    w_0: float
    k_T: float
    internal: ClassVar = {"most": ()}

    def _most(self, w, step):
        return ufl.max_value(w, step.q["most"])

    def traction(self, step):
        w = ufl.dot(step.mid, step.n)
        return across_and_along(w, self.k * w * ufl.exp(-self._most(w, step) / self.w_0), self.k_T, step)

    def evolve(self, step):
        return {"most": self._most(ufl.dot(step.w, step.n), step)}

    def energy(self, step):
        return self.k * ufl.exp(-step.q["most"] / self.w_0) * opening(step) ** 2 / 2 + energy_along(self.k_T, step)


def bar(law, support=lambda x, t: t, traction=None):
    """A strip on rollers, nu = 0, whose end is moved or pulled: t(end) = w + sigma(w) HEIGHT/E."""
    strip = block(WIDTH, HEIGHT, WIDTH, cell="quadrilateral", structured=True)
    supports = {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    loads = {"TOP": traction} if traction else {}
    if not traction:
        supports = {"TOP": {"y": support}} | supports
    body = LinearElastic.young(E, 0.0)
    return Structure(strip, body=body, supports=supports, tractions=loads, element="Q1").interface(layer_of(law, 0.1))


def tilted(law, cells=8):
    """A block whose top is lifted more on one side than on the other."""
    joint = block(1.0, 0.5, 1 / cells, cell="quadrilateral", structured=True)
    supports = {"TOP": {"x": 0.0, "y": lambda x, t: t * (1 + 0.6 * x[0])}}
    body = LinearElastic.young(E, 0.2)
    return Structure(joint, body=body, supports=supports, element="Q1").interface(layer_of(law, 0.1))


KINKED = Trilinear(k=70.0, fall=7.0, w_1=0.011, w_2=0.12, k_T=30.0)
DAMAGED = Damage(k=70.0, w_0=0.03, k_T=30.0)
PATH = ArcLength(end=0.2, first=0.02)
SHORT = ArcLength(end=0.14, first=0.04)

NEVER = Ending()


def run(out: Path, *, resume: bool = False, ending: Ending = NEVER) -> None:
    """March along both paths, or begin to."""

    def size(state):
        ending.at_row()
        return state.u.x.petsc_vec.norm()

    for name, law, keep in (("kinked", KINKED, "last"), ("damaged", DAMAGED, "all")):
        march(tilted(law, cells=4), SHORT, observe={"size": size}, out=out / name, resume=resume, keep=keep)


if __name__ == "__main__":
    run(Path(sys.argv[1]), ending=Ending(int(sys.argv[2])))
