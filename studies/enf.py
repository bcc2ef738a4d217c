"""End-notched flexure: a bent beam with a crack that slides and closes, against Euler's beams on glue that softens.

The lower and the upper half of a beam on two supports slide on each other, and the crack grows in shear. Its sides press
on each other near the support. Beyond a peak the path turns back in force and displacement. In beams without shear strains
the slip s of both halves obeys s'' = 8 t/(E h) - 6 V/(E b h^2) with the traction t(s), the shear force V = P/2 left of
the load and -P/2 right of it, and halves of height h and width b. Slip and deflection are computed exactly in four parts:
over the crack, over the fracture zone that softens, and over the sound glue on both sides of the load.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from forms import Cohesive, LinearElastic
from forms.base import Array
from geometry import sandwich
from thinlayer import ArcLength, Structure, Table, march, plotting
from thinlayer.discretisation.supports import Place, Support
from thinlayer.output.plotting.curves import LAW_COLOUR
from thinlayer.running.record import Record
from thinlayer.solving.history import History

HALF_SPAN, ARM, WIDTH, CRACK = 50.0, 1.5, 25.0, 25.0  # mm: of the beam; height of a half; width; length of the precrack
E = 120e3  # MPa, of the beam, whose Poisson's ratio is 0
K, STRENGTH, TOUGHNESS = 1e5, 60.0, 1.5  # of the glue: MPa/mm, MPa, N/mm
GLUE = Cohesive(
    K, K, STRENGTH, STRENGTH, TOUGHNESS, TOUGHNESS,
    cracked=lambda x: 1.0 * (x[0] < CRACK),  # type: ignore[arg-type]
)  # fmt: skip
END = 3.6  # mm, deflection at which the path ends after its turn
ON_S, BEAMS, SHARP = "law on S", "beams", "beams with a sharp crack"
COLOURS = {BEAMS: "black", ON_S: LAW_COLOUR, SHARP: "0.5"}
CHECKED, LONGEST = (30.0, 35.0), 38.0  # mm: cracks that are compared with beams; longest crack of beams
RTOL = 0.03  # largest distance from beams, relative


# ---------------------------------------------------------------- closed form
@dataclass(frozen=True)
class SlipPart:
    """Slip s = s_0 + A f(x) + B g(x) along a part of the beam, of a length, where x begins at its left end.

    The functions f and g are cos and sin (m x), or the exponentials exp(-m x) and exp(m (x - length)).

    Attributes:
        m: root of the equation, per length.
        length: length of the part.
        softens: whether f and g are cos and sin.
        rest: s_0 per force P, and s_0 at no force.
    """

    m: float
    length: float
    softens: bool
    rest: tuple[float, float]

    def basis(self, x: float) -> Array:
        """Return f and g (row 0), and their slopes (row 1), at x."""
        if self.softens:
            c, s = math.cos(self.m * x), math.sin(self.m * x)
            return np.array([[c, s], [-self.m * s, self.m * c]])
        a, b = math.exp(-self.m * x), math.exp(self.m * (x - self.length))
        return np.array([[a, b], [-self.m * a, self.m * b]])

    def integral(self, P: float, factors: Array) -> float:
        """Return the integral of s over the part."""
        slopes = self.basis(self.length)[1] - self.basis(0.0)[1]  # f'' and g'' are f and g times -m^2 or m^2
        curved = float(factors @ slopes) / self.m**2
        return (self.rest[0] * P + self.rest[1]) * self.length + (-curved if self.softens else curved)


def bend(a: float, zone: float) -> tuple[float, float, float]:
    """Return force, deflection under the load and slip at the tip, for a crack `a` and a fracture zone of a length."""
    onset, end = STRENGTH / K, 2 * TOUGHNESS / STRENGTH
    fall = STRENGTH / (end - onset)
    load = 3 / (E * WIDTH * ARM**2)  # 6 V/(E b h^2) per force P
    stiff, soft = math.sqrt(8 * K / (E * ARM)), math.sqrt(8 * fall / (E * ARM))
    parts = [
        SlipPart(soft, zone, True, (-load / soft**2, end)),
        SlipPart(stiff, HALF_SPAN - a - zone, False, (load / stiff**2, 0.0)),
        SlipPart(stiff, HALF_SPAN, False, (-load / stiff**2, 0.0)),
    ]
    # rows: the slope -load P a at the tip, as in the crack; slip and slope where parts meet, with the
    # slip of the onset between the first two; the slope 0 at the right end. Columns: A, B of each part; the force P
    A, b = np.zeros((7, 7)), np.zeros(7)
    A[0, :2], A[0, 6] = parts[0].basis(0.0)[1], a * load
    for k in (0, 1):
        left, right = parts[k].basis(parts[k].length), parts[k + 1].basis(0.0)
        rows = slice(1 + 3 * k, 3 + 3 * k)
        A[rows, 2 * k : 2 * k + 2], A[rows, 2 * k + 2 : 2 * k + 4] = left, -right
        A[1 + 3 * k, 6], b[1 + 3 * k] = parts[k].rest[0] - parts[k + 1].rest[0], parts[k + 1].rest[1] - parts[k].rest[1]
    A[3, 2:4], A[3, 6], b[3] = parts[1].basis(0.0)[0], parts[1].rest[0], onset - parts[1].rest[1]
    A[6, 4:6] = parts[2].basis(HALF_SPAN)[1]
    *factors, P = np.linalg.solve(A, b)
    ABs = np.reshape(factors, (3, 2))
    tip = parts[0].rest[0] * P + parts[0].rest[1] + float(parts[0].basis(0.0)[0] @ ABs[0])
    over_crack = tip * a + 2 * load * P * a**3 / 6  # integral of tip + load P (a^2 - x^2)/2
    before, after, beyond = (part.integral(P, AB) for part, AB in zip(parts, ABs, strict=True))
    # a beam without slip, and the slip's curvature -3 s'/(4 h), times the moment 1/2 x of a unit load
    sound = P * HALF_SPAN**3 / (4 * E * WIDTH * ARM**3)
    return float(P), float(sound + 3 / (8 * ARM) * (over_crack + before + after - beyond)), float(tip)


def full_zone(a: float) -> float:
    """Return the length of the fracture zone as a crack of length `a` grows: the slip at its tip is that of broken glue."""
    end = 2 * TOUGHNESS / STRENGTH
    root = math.sqrt(8 * STRENGTH / (E * ARM * (end - STRENGTH / K)))
    zones = np.linspace(0.0, min(0.95 * math.pi / root, HALF_SPAN - a), 61)[:-1]

    def missing(zone: float) -> float:
        return bend(a, zone)[2] - end

    k = next(k for k, zone in enumerate(zones) if missing(zone) > 0)
    return float(brentq(missing, zones[k - 1], zones[k]))


def beam_table() -> Table:
    """Return equilibria of beams: no force, those with the precrack and a fracture zone that grows, longer cracks."""
    zones = np.linspace(0.0, full_zone(CRACK), 21)
    longer = np.linspace(CRACK, LONGEST, 31)[1:]
    cases = [*((CRACK, zone) for zone in zones), *((a, full_zone(a)) for a in longer)]
    P, deflection, _ = np.array([(0.0, 0.0, 0.0), *(bend(a, zone) for a, zone in cases)]).T
    return Table.of({"deflection": deflection, "force": P, "crack": np.array([CRACK, *(a for a, _ in cases)])})


def sharp_crack(a: Sequence[float]) -> tuple[Array, Array]:
    """Return force and deflection for sharp cracks of lengths `a` in a beam without slip elsewhere (Russell 1982)."""
    lengths = np.array(a, float)
    P: Array = 4 * WIDTH / (3 * lengths) * math.sqrt(E * ARM**3 * TOUGHNESS)
    return P, np.asarray(P * (2 * HALF_SPAN**3 + 3 * lengths**3) / (8 * E * WIDTH * ARM**3), float)


# ---------------------------------------------------------------- the study
def bend_beam(h_S: float) -> History:
    """Bend the beam with the law on S until its deflection is `END` behind the turn of the path.

    The table of the history has the additional column "force". Cells along S are `h_S` long.
    """
    halves = sandwich(2 * HALF_SPAN, ARM, ARM, ARM / 2, h_S=h_S, cell="quadrilateral", structured=True)
    supports: dict[Place, Support] = {(0, -ARM): {"y": 0.0}, (2 * HALF_SPAN, -ARM): {"x": 0.0, "y": 0.0}}
    supports |= {(HALF_SPAN, ARM): {"y": lambda x, t: -t}}
    model = Structure(halves, body=LinearElastic.young(E, 0.0), supports=supports).interface(GLUE)
    observe = {"force": lambda state: -WIDTH * state.reaction((HALF_SPAN, ARM)).force[1]}
    return march(model, ArcLength(end=END, first=0.2, largest=4), observe=observe, keep="last")


def run(record: Record, *, quick: bool = False) -> None:
    """Bend the beam until the path has turned back and forth, and compare it with beams on glue that softens.

    table.csv has rows for the law on S and for beams: deflection, force and length of the crack.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: cells of 1 mm along S, not of 0.5 mm.
    """
    rows, beams = record.add_report(bend_beam(1.0 if quick else 0.5)).table, beam_table()
    columns = {"deflection": rows["t"], "force": rows["force"], "crack": 2 * HALF_SPAN * rows["broken"]}
    path, table = Table.of(columns), record.new_table("table.csv")
    for name, curve in ((BEAMS, beams), (ON_S, path)):
        table.extend({"curve": name, **row} for row in curve.rows)
    stiffness = [curve["force"][1] / curve["deflection"][1] for curve in (path, beams)]
    record.check_near("stiffness of the sound beam over that of beams", stiffness[0] / stiffness[1], 1.0, RTOL)
    record.check_near("largest force over that of beams", path["force"].max() / beams["force"].max(), 1.0, RTOL)
    for a in CHECKED:
        P, deflection, _ = bend(a, full_zone(a))
        k = int(np.argmax(path["crack"] >= a))
        share = (a - path["crack"][k - 1]) / (path["crack"][k] - path["crack"][k - 1])
        values = [path[name][k - 1] + share * np.diff(path[name])[k - 1] for name in ("force", "deflection")]
        for name, value, expected in zip(("force", "deflection"), values, (P, deflection), strict=True):
            record.check_near(f"crack of {a:g} mm: {name} over that of beams", value / expected, 1.0, RTOL)
    turns = [-np.minimum(np.diff(curve["deflection"]), 0).sum() for curve in (path, beams)]
    record.check_near("deflection by which the path turns back, over that of beams", turns[0] / turns[1], 1.0, 0.2)
    energy = rows["dissipated"].sum()
    bounds = [TOUGHNESS * (columns["crack"][-1] - CRACK + zone) for zone in (0.0, full_zone(columns["crack"][-1]))]
    record.check("dissipated energy per width", energy, low=bounds[0], high=bounds[1])
    excess = sharp_crack(CHECKED)[0] / [bend(a, full_zone(a))[0] for a in CHECKED] - 1
    record.check("force of sharp cracks of the same lengths over that of beams, less 1", excess.min(), low=0.1)


def draw(record: Record) -> None:
    """Draw force over deflection, from table.csv in the folder of `record`."""
    curves = record.load("table.csv").split("curve")
    lines = {curve: (curves[curve]["deflection"], curves[curve]["force"]) for curve in (BEAMS, ON_S)}
    force, deflection = sharp_crack([CRACK + k / 3 for k in range(40)])
    lines[SHARP] = deflection, force
    panels = {"a crack of 25 mm": lines, "its growth": lines}
    limits = {"xlim": dict(zip(panels, ((0.0, 4.1), (3.4, 3.65)), strict=True))}
    limits["ylim"] = dict(zip(panels, ((0.0, 1000.0), (600.0, 920.0)), strict=True))
    axes, look = ("deflection under the load (mm)", "force (N)"), {"styles": ("-", "o", ":"), "colours": COLOURS}
    plotting.curves(panels, *axes, title="end-notched flexure", save=record.path("enf.svg"), **limits, **look)
