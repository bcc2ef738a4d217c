"""Heat and cure: strips of unequal expansion, shear lag and bending; a layer that shrinks while it hardens.

Strips are in plane strain: their axial modulus is E/(1 - nu^2), their free expansion (1 + nu) alpha dT.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import ufl

from forms import BulkLaw, LinearElastic
from forms.base import Array
from forms.elastic import lame
from forms.kinematics import Expr
from forms.law import Step
from geometry import sandwich
from thinlayer import Structure, Surface, Table, ThermalExpansion, ThinLayer, plotting, solve
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.running.record import Record

Numbers = npt.NDArray[np.floating[Any]]
NU = 0.3
ALUMINIUM, STEEL = LinearElastic.young(E=70e3, nu=NU), LinearElastic.young(E=210e3, nu=NU)  # MPa
ALPHA = {"LOWER": 23e-6, "UPPER": 12e-6}  # 1/K, of aluminium below and steel above
MODULI = {"LOWER": 70e3, "UPPER": 210e3}
HEIGHTS = {"LOWER": 3.0, "UPPER": 2.0}  # mm
COOLING = -80.0  # K
LENGTH = 200.0  # mm, half of the strips: the left end is the middle
EPS = 0.05  # mm
SHEAR = (0.5, 2.0)  # MPa, shear moduli of the soft layers of the shear lag
STIFFENING = (0.03, 0.1, 0.3, 1.0, 10.0, 100.0)  # MPa, of the layers of the bending strip
NEAR_ENDS = 0.95  # share of the half length in which shear stresses are compared


@dataclass(frozen=True)
class Curing(BulkLaw):
    """A resin that hardens: each increment of strain is resisted by the moduli of its time, c(t) times the final ones.

    Attributes:
        lmbda, mu: final moduli, stress.
        tau: time in which the conversion c = 1 - exp(-t/tau) comes to 63 %.
    """

    lmbda: float
    mu: float
    tau: float
    powers: ClassVar = {"lmbda": 1, "mu": 1}
    internal: ClassVar = {"s": (3, 3)}
    varies = True

    def at(self, x: Array, t: float) -> dict[str, Array]:
        """Moduli at places and a time."""
        share = np.full(x.shape[1], LIQUID + conversion(t / self.tau))
        return {"lmbda": self.lmbda * share, "mu": self.mu * share}

    def stress(self, step: Step) -> Expr:
        """The stress before, and that of the increment of strain."""
        return step.q["s"] + lame(self.lmbda, self.mu, step.e - step.e_old)

    def advance(self, step: Step) -> dict[str, Expr]:
        """The stress is what the resin remembers."""
        return {"s": self.stress(step)}


LIQUID = 1e-6  # share of the final moduli that the liquid has
SHRINKAGE, TAU = 0.01, 2.0  # linear shrinkage of full conversion; hours
RESIN = LinearElastic.young(E=3e3, nu=0.35)


def conversion(x: Any) -> Any:
    """Conversion at a time over tau."""
    return 1 - np.exp(-x)


def run(record: Record, *, quick: bool = False) -> None:
    """Four tasks, each with the layer meshed and as an interface law.

    Args:
        record: where to write.
        quick: coarser meshes, fewer steps.
    """
    shear_lag(record, 5.0 if quick else 2.5)
    bending(record, 5.0 if quick else 2.5)
    curing(record, (10, 20) if quick else (20, 40, 80))
    shrinking_freely(record)


# ---------------------------------------------------------------- strips
def strips(h: float, mu: float, supports: dict[Any, Any]) -> dict[str, Model]:
    """The right halves of two cooled strips with a layer of a shear modulus, by the name of the model."""
    joint = sandwich(LENGTH, HEIGHTS["LOWER"], HEIGHTS["UPPER"], h, cell="quadrilateral", structured=True)
    cooled = {name: ThermalExpansion(alpha, COOLING) for name, alpha in ALPHA.items()}
    bodies = {"LOWER": ALUMINIUM, "UPPER": STEEL}
    structure = Structure(joint, body=bodies, supports={"LEFT": {"x": 0.0}} | supports, eigenstrain=cooled)
    return both(structure, ThinLayer(LinearElastic.shear(mu, 0.4), EPS))


def both(structure: Structure, layer: ThinLayer) -> dict[str, Model]:
    """Both models of a structure, by name."""
    return {"meshed layer": structure.full(layer), "interface law": structure.interface(layer)}


def difference() -> float:
    """Free expansion of the upper strip less that of the lower one, in plane strain."""
    return (1 + NU) * (ALPHA["UPPER"] - ALPHA["LOWER"]) * COOLING


def compliances(eps: float = 0.0) -> tuple[float, float]:
    """1/(E h) of both strips in plane strain, summed; and what their bending adds for forces at their inner sides.

    Args:
        eps: distance of the strips, which adds to the lever arm of these forces.
    """
    plane = {name: E / (1 - NU**2) for name, E in MODULI.items()}
    stretch = sum(1 / (plane[name] * h) for name, h in HEIGHTS.items())
    stiffness = sum(plane[name] * h**3 / 12 for name, h in HEIGHTS.items())
    return stretch, arm(eps) ** 2 / stiffness


def arm(eps: float = 0.0) -> float:
    """Distance of the middles of the strips."""
    return sum(HEIGHTS.values()) / 2 + eps


def lag(mu: float, x: Numbers) -> Array:
    """Shear stress on S of strips that do not bend, at places from the middle: Volkersen's shear lag."""
    B = np.sqrt(mu / EPS * compliances()[0])
    return np.asarray(mu * difference() * np.sinh(B * x) / (EPS * B * np.cosh(B * LENGTH)))


def shear_lag(record: Record, h: float) -> None:
    """Strips between smooth plates."""
    table = record.table("shear_lag.csv")
    for mu in SHEAR:
        models = strips(h, mu, {"BOTTOM": {"y": 0.0}, "TOP": {"y": 0.0}})
        surface = Surface(models["interface law"])
        for name, model in models.items():
            x, t = surface.profile(surface.traction(record.solved(solve(model))))
            exact = lag(mu, x[:, 0])
            table.extend(Table.of({"model": name, "mu": mu, "x": x[:, 0], "tau": t[:, 0], "closed_form": exact}))
    for mu, of_mu in table.split("mu").items():
        for name, part in of_mu.split("model").items():
            inside = (part["x"] > 0.1 * LENGTH) & (part["x"] < NEAR_ENDS * LENGTH)
            error = np.abs(part["tau"] / part["closed_form"] - 1)[inside].max()
            record.check(f"shear lag, mu = {mu:g} MPa, {name}: largest relative error inside", error, high=0.02)
            other = np.abs(part["tau"] / lag(1.2 * mu, part["x"]) - 1)[inside].max()
            what = f"shear lag of 1.2 mu, mu = {mu:g} MPa, {name}: largest relative error inside"
            record.check(what, other, low=0.02)


def timoshenko(eps: float = 0.0) -> float:
    """Curvature of two bonded strips (Timoshenko 1925), at some distance from one another."""
    stretch, bend = compliances(eps)
    return float(-difference() * bend / arm(eps) / (stretch + bend))


def bent(mu: float, eps: float = 0.0) -> float:
    """Curvature in the middle with a layer in between (Suhir 1986): axial forces grow over the shear lag."""
    k = np.sqrt(mu / EPS * sum(compliances(eps)))
    return float(timoshenko(eps) * (1 - 1 / np.cosh(min(k * LENGTH, 700.0))))


def curvature(surface: Surface, state: State) -> float:
    """Curvature near the middle of the strips: that of the parabola through the mean displacements of both sides of S."""
    x, v = surface.profile(surface.displacements(state).mean(axis=0))
    near = x[:, 0] < 0.1 * LENGTH
    return float(2 * np.polyfit(x[near, 0] ** 2, v[near, 1], 1)[0])


def bending(record: Record, h: float) -> None:
    """Strips that are free to bend, with layers that are stiffer and stiffer."""
    table, supports = record.table("bending.csv"), {(0.0, -HEIGHTS["LOWER"]): {"y": 0.0}}
    apart = {"meshed layer": EPS, "interface law": 0.0}  # the interface law leaves the layer's part of the arm out
    for mu in STIFFENING:
        models = strips(h, mu, supports)
        surface = Surface(models["interface law"])
        found = {name: curvature(surface, record.solved(solve(model))) for name, model in models.items()}
        closed = {f"{name}, closed form": bent(mu, eps) for name, eps in apart.items()}
        table.append({"mu": mu, **found, **closed})
    for name in apart:
        ratio = table[name] / table[f"{name}, closed form"]
        record.check(f"curvature with a shear lag, {name}: largest relative error", abs(ratio - 1).max(), high=0.02)
        ratio = table[name][-1] / timoshenko()
        record.check_near(f"curvature of the stiffest layer over Timoshenko's, {name}", ratio, 1.0, 0.02)


# ---------------------------------------------------------------- cure
def plates(eigenstrain: Any, law: BulkLaw, top: dict[Any, Any]) -> dict[str, Model]:
    """Stiff plates between smooth walls, and a layer with an eigenstrain, by the name of the model."""
    joint = sandwich(4.0, 2.0, 2.0, 1.0, cell="quadrilateral", structured=True)
    walls = {"BOTTOM": {"y": 0.0}, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}} | top
    structure = Structure(joint, body=LinearElastic.young(E=1e9, nu=NU), supports=walls)
    return both(structure, ThinLayer(law, EPS, eigenstrain=eigenstrain))


def cured(t: Numbers) -> Array:
    """Stress of a held layer: the integral of (3 lmbda + 2 mu) c de with e = SHRINKAGE c, half of that of a hard resin."""
    final = (3 * RESIN.lmbda + 2 * RESIN.mu) * SHRINKAGE
    c = conversion(t / TAU)
    return np.asarray(final * c**2 / 2)


def curing(record: Record, steps: tuple[int, ...]) -> None:
    """A layer that shrinks while it hardens between plates that do not move; backward Euler has order 1."""
    table, errors = record.table("curing.csv"), {}
    law = Curing(RESIN.lmbda, RESIN.mu, TAU)
    shrinkage = ThermalExpansion(-SHRINKAGE, lambda x, t: 1 - ufl.exp(-t / TAU))
    models = plates(shrinkage, law, {"TOP": {"y": 0.0}})
    surface = Surface(models["interface law"])
    for n in steps:
        for name, model in models.items():
            history = record.march(model, [*map(float, np.linspace(0, 4 * TAU, n + 1)[1:])], f"{name} {n}")
            found = np.array([surface.integral(surface.frame(surface.traction(one))[1]) / 4.0 for one in history])
            exact = cured(history.t)
            errors[name, n] = found[-1] / exact[-1] - 1
            table.extend(Table.of({"model": name, "steps": n, "t": history.t, "t_N": found, "closed_form": exact}))
    for name in models:
        first, last = errors[name, steps[-2]], errors[name, steps[-1]]
        record.check(f"stress of cure, {name}: observed order in time", np.log2(first / last), low=0.9, high=1.1)
        record.check(f"stress of cure, {name}: error extrapolated to short steps", abs(2 * last - first), high=2e-3)


def shrinking_freely(record: Record) -> None:
    """A layer that shrinks across itself, under a plate that follows: what stress is left is rounding."""
    models = plates(((0.0, 0.0), (0.0, -SHRINKAGE)), RESIN, {})
    surface = Surface(models["interface law"])
    scale = (RESIN.lmbda + 2 * RESIN.mu) * SHRINKAGE
    for name, model in models.items():
        state = record.solved(solve(model))
        t = surface.traction(state)
        record.check(f"free shrinkage, {name}: traction over that of a held layer", surface.norm(t) / scale, high=1e-8)
        closing = surface.integral(surface.jump(state)[1]) / 4.0
        record.check_near(f"free shrinkage, {name}: closing over eps e", closing / (-EPS * SHRINKAGE), 1.0, 1e-8)


# ---------------------------------------------------------------- pictures
def draw(record: Record) -> None:
    """Draw shear lag and cure, at every few places and times, and bending, from the tables."""
    lines: dict[str, tuple[Any, Any]] = {}
    for mu, of_mu in record.load("shear_lag.csv").split("mu").items():
        for name, part in of_mu.split("model").items():
            lines[f"{name}, G = {mu:g} MPa"] = part["x"][::4], part["tau"][::4]
        grid = np.linspace(0, LENGTH, 200)
        lines[f"closed form, G = {mu:g} MPa"] = grid, lag(mu, grid)
    title, save = "two strips of unequal expansion, cooled by 80 K, held flat", record.path("shear_lag.png")
    plotting.curves(
        lines, "x from the middle (mm)", "shear stress on S (MPa)", title=title, styles=2 * ("s", ".", "-"), save=save
    )
    table, grid = record.load("bending.csv"), np.geomspace(min(STIFFENING), max(STIFFENING), 200)
    lines = {name: (table["mu"], 1e3 * table[name]) for name in ("meshed layer", "interface law")}
    lines["closed form"] = grid, np.array([1e3 * bent(float(mu)) for mu in grid])
    lines["Timoshenko"] = grid, np.full(len(grid), 1e3 * timoshenko())
    title, save = "two strips of unequal expansion, cooled by 80 K, free to bend", record.path("bending.png")
    modulus, styles = "shear modulus of the layer (MPa)", ("s", "o", "-", ":")
    plotting.curves(lines, modulus, "curvature (1/m)", title=title, styles=styles, log="x", save=save)
    finest, grid = [*record.load("curing.csv").split("steps").values()][-1], np.linspace(0, 4 * TAU, 200)
    lines = {name: (part["t"][::4], part["t_N"][::4]) for name, part in finest.split("model").items()}
    lines["closed form"] = grid, cured(grid)
    lines["a resin that is hard from the start"] = grid, 2 * cured(grid) / np.maximum(conversion(grid / TAU), 1e-9)
    title, save = "a layer that shrinks by 1 % while it hardens between stiff plates", record.path("curing.png")
    plotting.curves(lines, "hours", "normal traction on S (MPa)", title=title, styles=("s", ".", "-", "--"), save=save)
