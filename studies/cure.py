"""A resin that cures between two plates: reaction heat, and the stress that shrinkage leaves as it gels.

The reaction is hottest in the middle of the resin, where the law of order 2 knows the temperature, and order 1 does not.
Both laws are of this file: one of heat with a degree of cure X as internal variable, one of mechanics whose stiffness
follows X.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
import ufl

from forms import BulkLaw, FluxLaw, Heat, LinearElastic
from forms.base import Array
from forms.elastic import lame_stress
from forms.flux import FluxStep
from forms.law import ChangeParameter, Step
from forms.tensors import Expr
from geometry import sandwich
from thinlayer import Film, Probe, Structure, Surface, Table, ThermalExpansion, ThinLayer, march, plotting
from thinlayer.discretisation.state import State
from thinlayer.discretisation.supports import Support
from thinlayer.running.record import Record
from thinlayer.solving.history import History


@dataclass(frozen=True)
class Curing(FluxLaw):
    """Heat in a resin with dX/dt = A exp(-theta/T) (1 - X), which sets free the heat H dX/dt; T in kelvin.

    Attributes:
        k: conductivity.
        c, H: capacity, and heat of the whole reaction, per volume.
        A: rate of the reaction at infinite temperature, 1/time.
        theta: activation energy over the gas constant, kelvin.
    """

    k: float
    c: float
    H: float
    A: float
    theta: float
    rate = True
    symmetric = False
    internal: ClassVar = {"X": ()}

    def flux(self, step: FluxStep) -> Expr:
        """Return the flux (3,)."""
        return self.k * step.g

    def sink(self, step: FluxStep) -> Expr:
        """Return the heat that a unit of volume takes in per time: stored, minus that of the reaction."""
        return self.c * step.T_rate - self.H * (self.evolve(step)["X"] - step.q["X"]) / step.dt

    def evolve(self, step: FluxStep) -> dict[str, Expr]:
        """Return the degree of cure at the end of the step."""
        growth = step.dt * (self.A * ufl.exp(-self.theta / step.T_end))
        return {"X": (step.q["X"] + growth) / (1 + growth)}


@dataclass(frozen=True)
class Gelling(BulkLaw):
    """Resin whose stress grows with the strain from the gel point on, with a stiffness proportional to X - gel.

    Attributes:
        lmbda, mu: Lame's moduli, a stress, of resin that has cured (X = 1).
        gel: degree of cure at the gel point.
        X: degree of cure, a function of n places (d, n) and a time.
    """

    lmbda: float
    mu: float
    gel: float
    X: Callable[[Array, float], Array]
    varies = True
    functions: ClassVar = ("X",)
    internal: ClassVar = {"sigma": (3, 3), "X_old": ()}

    def parameters(self) -> dict[str, object]:
        """Return parameters by name, with NaN for the function X."""
        return super().parameters() | ({"X": np.nan} if callable(self.X) else {})

    def mapped(self, change: ChangeParameter) -> Self:
        """Return a copy with changed numbers, and the same X."""
        return super().mapped(change).with_parameters({"X": self.X})

    def at(self, x: Array, t: float) -> dict[str, Array]:
        """Return the degrees of cure at places and a time."""
        return {"X": self.X(x, t)}

    def _stress(self, step: Step, e: Expr) -> Expr:
        # before the gel point a small stiffness is left, so that the layer's tangent is not singular
        share = ufl.max_value((self.X + step.q["X_old"]) / 2 - self.gel, 1e-4) / (1 - self.gel)
        return step.q["sigma"] + share * lame_stress(self.lmbda, self.mu, e - step.e_old)

    def stress(self, step: Step) -> Expr:
        """Return the stress (3, 3) at the time at which forces balance."""
        return self._stress(step, step.mid)

    def advance(self, step: Step) -> dict[str, Expr]:
        """Return the stress and the degree of cure at the end of the step."""
        return {"sigma": self._stress(step, step.e), "X_old": ufl.as_ufl(self.X)}


RESIN = Curing(k=2e-4, c=1.9e-3, H=0.3, A=2e4, theta=6000.0)  # W, mm, J, s, K; c and H per mm3
STEEL, PLATES = Heat(k=50e-3, c=3.6e-3), LinearElastic.young(E=210e3, nu=0.3)
SHRINKAGE, GEL, LMBDA, MU = 0.02, 0.4, 3e3, 1e3  # linear; degree of cure; MPa
OVEN, ROOM, FILM = 420.0, 300.0, 1e-4  # kelvin; W/(mm2 K)
THICKNESSES, DURATION = (4.0, 2.0), 1200.0  # mm, s
MODELS = {"meshed": ("full", 1), "order 1": ("interface", 1), "order 2": ("interface", 2)}  # kind, order of the law
JOINT = sandwich(10, 5, 5, h=2.5, cell="quadrilateral")


def cure(name: str, eps: float, times: Array) -> History:
    """March the temperature of plates and resin, in an oven, with one of the `MODELS`."""
    kind, order = MODELS[name]
    films = [Film(name, FILM, OVEN) for name in ("BOTTOM", "TOP")]
    heated = Structure(JOINT, body=STEEL, supports={}, parts=films, initial=ROOM)
    return march(getattr(heated, kind)(ThinLayer(RESIN, eps, order=order)), [*map(float, times)])


def middle(surface: Surface, state: State) -> float:
    """Return the temperature in the middle of the resin, halfway along the plates."""
    if surface.model.broken:
        return float(surface.value_in_layer(state, 0.0).mean())
    return float(Probe(state).value(surface.in_layer(np.array([[5.0, 0.0]]), np.zeros(1)))[0])


def mechanics(name: str, eps: float, warm: History) -> History:
    """March the stress of the resin, which shrinks with its degree of cure in `warm` and cannot come closer."""
    surface = Surface(warm.model)
    X = surface.function(np.stack([surface.internal(state, "X") for state in warm]), warm.t)
    rollers: dict[str, Support] = {"BOTTOM": 0, "TOP": {"y": 0}, "LEFT": {"x": 0}, "RIGHT": {"x": 0}}
    shrinking = ThermalExpansion(-SHRINKAGE, X, reference=0)
    layer = ThinLayer(Gelling(LMBDA, MU, GEL, X), eps, eigenstrain=shrinking)
    plates = Structure(JOINT, body=PLATES, supports=rollers)
    return march(getattr(plates, MODELS[name][0])(layer), [*map(float, warm.t[1:])])


def run(record: Record) -> None:
    """Cure resin of two thicknesses between plates, on S and meshed: temperature, degree of cure, stress.

    Args:
        record: record of the run, with its folder, tables and checks.
    """
    table, times = record.new_table("table.csv"), np.arange(1.0, 61) * DURATION / 60
    for eps in THICKNESSES:
        for name in MODELS:
            warm = record.add_report(cure(name, eps, times))
            cooled = record.add_report(mechanics(name, eps, warm))
            surface, stresses = Surface(warm.model), Surface(cooled.model)
            for state, other in zip(warm, cooled, strict=True):
                T, X = surface.displacements(state).mean(), surface.internal(state, "X").mean()
                stress = stresses.traction(other)[1].mean()
                data = {"T": T, "rise": middle(surface, state) - T, "X": X, "stress": stress}
                table.append({"eps": eps, "model": name, "t": state.t, **data})
    for eps, rows in Table(table.rows).split("eps").items():
        meshed, linear, on_s = (rows.split("model")[name] for name in MODELS)
        for column, high in (("T", 0.1), ("rise", 1.0), ("X", 2e-3)):
            error, larger = (abs(rows[column] - meshed[column]).max() for rows in (on_s, linear))
            record.check(f"eps = {eps}: largest error of {column}", error, high=high)
            record.check(f"eps = {eps}: that of order 1 over it", larger / error, low=20)
        ratio = on_s["stress"][-1] / meshed["stress"][-1]
        record.check_near(f"eps = {eps}: stress at the end over that of meshed resin", ratio, 1.0, 0.002)
        ratio = on_s["stress"][-1] / closed_stress(float(eps), on_s["X"][-1])
        record.check_near(f"eps = {eps}: stress at the end over the closed form", ratio, 1.0, 0.01)


def closed_stress(eps: float, X: float) -> float:
    """Return the stress of resin that has shrunk up to the cure X, and that plates kept in place from the gel point on."""
    s, a = (X - GEL) / (1 - GEL), (LMBDA + 2 * MU) / eps * 10 / (PLATES.lmbda + 2 * PLATES.mu)  # resin over plates
    return (3 * LMBDA + 2 * MU) * SHRINKAGE * (1 - GEL) * (s / a - np.log1p(a * s) / a**2)


def draw(record: Record) -> None:
    """Draw temperature, cure and stress over time, from table.csv in the folder of `record`."""
    panels = {"rise": "T, middle minus faces (K)", "X": "cure X", "stress": "stress (MPa)"}
    tables = {eps: rows.split("model") for eps, rows in record.load("table.csv").split("eps").items()}
    lines = {
        title: {
            f"{eps} mm, {name}": (rows["t"], rows[column]) for eps, of in tables.items() for name, rows in of.items()
        }
        for column, title in panels.items()
    }
    plotting.curves(
        lines, "time (s)", save=record.path("cure.svg"), title="resin cures between steel plates in an oven"
    )
