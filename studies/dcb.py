"""Double cantilever beam that is peeled apart: a layer that breaks, on S and meshed, against Timoshenko's beams.

Both arms are lifted at their ends, and a crack runs along the glue. The beams are on a foundation which first resists
like springs. Beyond its strength the traction falls linearly to zero. Their equations are linear in three parts: over
the crack, over the fracture zone that softens, and over the sound glue, which is infinitely long.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

from forms import Breaking, LinearElastic
from forms.base import Array
from geometry import sandwich
from thinlayer import ArcLength, Structure, Table, ThinLayer, march, plotting
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.supports import Place, Support
from thinlayer.output.plotting.curves import LAW_COLOUR, MESHED_COLOUR
from thinlayer.running.record import Record
from thinlayer.solving.history import History

LENGTH, ARM, CRACK = 48.0, 3.0, 30.0  # mm: of the specimen, whose width is 1; height of an arm; length of the precrack
E, NU = 70e3, 0.3  # of the arms, MPa
EPS, STRENGTH, TOUGHNESS = 0.1, 20.0, 0.3  # of the glue in opening: mm, MPa, N/mm
MODULUS = 1e3  # MPa, of the glue in opening: its stiffness is MODULUS/EPS
GLUE = Breaking(
    lmbda=0.0, mu=MODULUS / 2, t_N=STRENGTH, t_T=1.5 * STRENGTH, G_I=TOUGHNESS / EPS, G_II=3 * TOUGHNESS / EPS,
    eta=2.0, cracked=lambda x: 1.0 * (x[0] < CRACK),  # type: ignore[arg-type]
)  # fmt: skip
END = 1.5  # mm, largest opening of the ends of the arms
ON_S, MESHED, BEAMS, CLAMPED = "law on S", "meshed layer", "beams", "clamped beams"
MAX_ZONE = 2.0  # longest fracture zone that is looked for, over (bending stiffness / slope of the traction)^(1/4)
BEAM_RTOL = 0.01  # largest distance from beams, relative
MESHED_RTOL = 2e-3  # largest distance of the meshed layer from the law on S, relative


# ---------------------------------------------------------------- closed form
@dataclass(frozen=True)
class Arms:
    """Two beams of unit width on a foundation that softens, by Timoshenko's theory.

    The deflection v, rotation phi, moment M and shear force V of the upper arm are y = (v, phi, M, V). With the traction
    t at the opening 2 v, v' = phi + V/S, phi' = M/B, M' = -V and V' = t. Here x begins at the tip of the crack, where the
    traction is zero, and B and S are the stiffnesses in bending and in shear.

    Attributes:
        bending, shear: stiffnesses B and S per width.
        K: traction per opening of the sound foundation.
        strength: largest traction.
        toughness: area below the traction over the opening.
    """

    bending: float
    shear: float
    K: float
    strength: float
    toughness: float

    @property
    def openings(self) -> tuple[float, float]:
        """Openings at which the foundation begins to soften, and at which it is broken."""
        return self.strength / self.K, 2 * self.toughness / self.strength

    @property
    def slope(self) -> float:
        """Traction per opening by which the foundation softens."""
        onset, end = self.openings
        return self.strength / (end - onset)

    def _matrix(self, slope: float) -> Array:
        """Return A in y' = A y, for a foundation whose traction changes by `slope` per opening."""
        A = np.zeros((4, 4))
        A[0, 1], A[0, 3], A[1, 2], A[2, 3], A[3, 0] = 1.0, 1 / self.shear, 1 / self.bending, -1.0, 2 * slope
        return A

    def lift(self, a: float, zone: float) -> tuple[float, float, float]:
        """Return force, opening of the ends and opening at the tip, for a crack `a` and a fracture zone of a length."""
        onset, end = self.openings
        roots, vectors = np.linalg.eig(self._matrix(self.K))
        decaying = vectors[:, roots.real < 0]
        first = decaying[:, 0]
        parts = np.stack([first.real, first.imag], axis=1) if np.iscomplexobj(first) else decaying
        back, broken = expm(-zone * self._matrix(-self.slope)), np.array([end / 2, 0, 0, 0])
        at_tip, rest = back @ parts, broken - back @ broken
        # factors of both decaying parts and the force P: opening at the end of the zone, M = P a and V = -P at the tip
        A = np.array([[*parts[0], 0.0], [*at_tip[2], -a], [*at_tip[3], 1.0]])
        *factors, P = np.linalg.solve(A, [onset / 2, -rest[2], -rest[3]])
        v, phi, *_ = at_tip @ factors + rest
        bent = P * a**3 / (3 * self.bending) + P * a / self.shear
        return float(P), float(2 * (v - phi * a + bent)), float(2 * v)

    def peel(self, a: float) -> tuple[float, float, float]:
        """Return force, opening of the ends and length of the fracture zone as the crack grows and has the length `a`."""
        zones = np.linspace(0.0, MAX_ZONE, 41) * (self.bending / self.slope) ** 0.25

        def missing(zone: float) -> float:
            return self.lift(a, zone)[2] - self.openings[1]

        end = next(k for k, zone in enumerate(zones) if missing(zone) > 0)
        zone = float(brentq(missing, zones[end - 1], zones[end]))
        return (*self.lift(a, zone)[:2], zone)

    def envelope(self, crack: float, longest: float) -> Table:
        """Return a table of equilibria with a row for each, from the sound glue at a precrack to a longer crack.

        Its columns are "opening", "force", "crack" (its length) and "dissipated".
        """
        zone = self.peel(crack)[2]
        rows = [(*self.lift(crack, share * zone)[:2], crack) for share in np.linspace(0.0, 1.0, 21)]
        rows += [(*self.peel(a)[:2], a) for a in np.linspace(crack, longest, 21)[1:]]
        P, opening, a = np.array([(0.0, 0.0, crack), *rows]).T
        work = np.concatenate([[0.0], np.cumsum((P[1:] + P[:-1]) * np.diff(opening) / 2)])
        return Table.of({"opening": opening, "force": P, "crack": a, "dissipated": work - P * opening / 2})

    def clamped(self, a: float) -> tuple[float, float]:
        """Return force and opening of the ends for clamped beams of length `a` without shear, with P a = sqrt(B G)."""
        P = math.sqrt(self.bending * self.toughness) / a
        return P, 2 * P * a**3 / (3 * self.bending)


COLOURS = {BEAMS: "black", ON_S: LAW_COLOUR, MESHED: MESHED_COLOUR, CLAMPED: "0.5"}  # of curves
STIFFNESS = E / (1 - NU**2)  # of arms in plane strain
ARMS = Arms(STIFFNESS * ARM**3 / 12, E / (2 * (1 + NU)) * ARM * 5 / 6, MODULUS / EPS, STRENGTH, TOUGHNESS)


# ---------------------------------------------------------------- the study
def peel_model(kind: str, h_S: float) -> Model:
    """Make the specimen with the law on S or a meshed layer; at time t the ends are 2 t apart. Cells along S are h_S."""
    supports: dict[Place, Support] = {(0, ARM): {"y": lambda x, t: t}, (0, -ARM): {"y": lambda x, t: -t}}
    supports |= {(LENGTH, y): {"x": 0.0} for y in (ARM, -ARM)}
    joint = sandwich(LENGTH, ARM, ARM, ARM / 2, h_S=h_S, cell="quadrilateral", structured=True)
    structure, layer = Structure(joint, body=LinearElastic.young(E, NU), supports=supports), ThinLayer(GLUE, EPS)
    return structure.full(layer, cells_through=1) if kind == MESHED else structure.interface(layer)


def peel(kind: str, h_S: float) -> History:
    """Peel the arms until they are `END` apart, by arc length; the table has the additional column "force"."""
    arc = ArcLength(end=END / 2, first=0.05)
    observe = {"force": lambda state: state.reaction((0, ARM)).force[1]}
    return march(peel_model(kind, h_S), arc, observe=observe, keep="last")


def run(record: Record, *, quick: bool = False) -> None:
    """Peel the arms of a double cantilever beam, with the law on S and with a meshed layer.

    table.csv has rows for both and for beams: the opening of the ends, the force per width, the length of the crack and
    the dissipated energy per width up to then.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: four cells along the fracture zone, not eight.
    """
    table = record.new_table("table.csv")
    beams = ARMS.envelope(CRACK, 1.25 * CRACK)
    curves = {BEAMS: beams}
    for kind in (ON_S, MESHED):
        rows = record.add_report(peel(kind, 1.0 if quick else 0.5)).table
        columns = {"opening": 2 * rows["t"], "force": rows["force"], "crack": LENGTH * rows["broken"]}
        curves[kind] = Table.of(columns | {"dissipated": np.cumsum(rows["dissipated"])})
    for name, curve in curves.items():
        table.extend({"curve": name, **row} for row in curve.rows)
    check_curves(record, curves)


def check_curves(record: Record, curves: Mapping[str, Table]) -> None:
    """Check forces and energy of the models against beams and against each other, and evaluate the test.

    Tests are evaluated by clamped beams, which have the toughness (P a)^2/B for a force P and a crack a. Beams on glue are
    softer. So the crack must be that of clamped beams with the measured opening and force, not the real one.
    """
    beams, on_s, meshed = (curves[name] for name in (BEAMS, ON_S, MESHED))
    peeled = np.array([ARMS.peel(a)[:2] for a in (CRACK, 1.1 * CRACK, 1.2 * CRACK)])
    forces = {kind: np.interp(peeled[:, 1], curves[kind]["opening"], curves[kind]["force"]) for kind in (ON_S, MESHED)}
    stiffness = on_s["force"][1] / on_s["opening"][1] / (beams["force"][1] / beams["opening"][1])
    record.check_near("stiffness of the sound specimen over that of beams", stiffness, 1.0, BEAM_RTOL)
    record.check_near("largest force over that of beams", on_s["force"].max() / beams["force"].max(), 1.0, BEAM_RTOL)
    error = abs(forces[ON_S] / peeled[:, 0] - 1).max()
    record.check("law on S: largest relative error of the force as the crack grows", error, high=BEAM_RTOL)
    distance = abs(forces[MESHED] / forces[ON_S] - 1).max()
    record.check("meshed layer: the same, from the law on S", distance, high=MESHED_RTOL)
    dissipated = np.interp(END, beams["opening"], beams["dissipated"])
    record.check_near("dissipated energy over that of beams", on_s["dissipated"][-1] / dissipated, 1.0, BEAM_RTOL)
    ratio = meshed["dissipated"][-1] / on_s["dissipated"][-1]
    record.check_near("dissipated energy of the meshed layer over that of the law on S", ratio, 1.0, MESHED_RTOL)
    opening, force, crack = (on_s[name][-1] for name in ("opening", "force", "crack"))
    effective_crack = (1.5 * ARMS.bending * opening / force) ** (1 / 3)
    by_crack, by_opening = ((force * a) ** 2 / ARMS.bending / TOUGHNESS for a in (crack, effective_crack))
    record.check("toughness by clamped beams from force and crack length, over the true one", by_crack, high=0.8)
    record.check_near("toughness by clamped beams from force and opening, over the true one", by_opening, 1.0, 0.02)


def draw(record: Record) -> None:
    """Draw force and dissipated energy over the opening, from table.csv in the folder of `record`."""
    curves = record.load("table.csv").split("curve")
    clamped = np.array([ARMS.clamped(a) for a in np.linspace(0.9 * CRACK, 1.25 * CRACK, 30)]).T
    panels = {
        title: {curve: (curves[curve]["opening"], curves[curve][column]) for curve in COLOURS if curve in curves}
        for title, column in (("force (N/mm)", "force"), ("dissipated energy (N mm/mm)", "dissipated"))
    }
    panels["force (N/mm)"][CLAMPED] = (clamped[1], clamped[0])
    options = {"styles": ("-", "o", ".", ":"), "colours": COLOURS, "xlim": (0.0, END)}
    title = "a double cantilever beam with a crack of 30 mm is peeled"
    plotting.curves(panels, "opening of the ends (mm)", title=title, save=record.path("dcb.svg"), **options)
