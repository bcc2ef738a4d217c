"""Non-monotone layers, mixed and in pure phases: error O(eps) of the interface laws, and floors that wrong ones leave."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import ufl

from forms import NonMonotone, NonMonotoneUnrelaxed, TractionLaw
from forms.kinematics import Expr
from forms.traction import JumpStep
from geometry import sandwich
from geometry.joint import Joint
from studies.problems import FOURIER_BODY, phases_on_s
from studies.sweeping import Floors, Sweep, check_floors, draw_rates, last, last_order, layer_of
from thinlayer import RangeWarning, Surface, Table, ThinLayer, plotting
from thinlayer.running.record import Record
from thinlayer.solving.history import History, Solution

# chi, in the axes t, n of S
OBLIQUE, SHEARED = np.array([[0.0, 0.3], [0.3, 0.5]]), np.array([[0.0, 0.5], [0.5, 0.0]])
# law; amplitudes of shear and pull on the upper side
CASES: dict[str, tuple[NonMonotone, float, float]] = {
    "": (NonMonotone(60.0, 40.0, alpha=1.0, transformation_energy=0.0031, chi=OBLIQUE), 4.0, 1.0),
    "across": (NonMonotone(60.0, 40.0, alpha=0.7, transformation_energy=0.003, chi=np.diag([0.0, 1.0])), 1.0, 1.2),
    "along": (NonMonotone(60.0, 40.0, alpha=0.3, transformation_energy=0.0004, chi=SHEARED), 4.0, 0.4),
}
PURE = NonMonotoneUnrelaxed(60.0, 40.0, alpha=0.6, transformation_energy=0.0025, chi=OBLIQUE)
MOVED, TIMES = (0.04, 0.03), (0.25, 0.5, 0.75, 1.0)
COLUMNS = 16  # number of facets of S, each of which is in one phase
TITLES = {"": "oblique chi", "across": "n (x) n", "along": "sym(t (x) n)", "unrelaxed": "oblique chi, pure phases"}
MESHED, ON_S = "meshed layer", "interface law"
CLOSE = 1e-9  # distance of a phase fraction from a pure phase that counts as rounding
SHARE = 0.15  # least share of S that each phase, and mixtures, must have


@dataclass(frozen=True)
class Formula(TractionLaw):
    """Interface law of `NonMonotone` in 2D, mu w_T + K_N w_N n - phase alpha chi n, with coefficients of one's own.

    Attributes:
        mu, K_N: stiffness along and across S, stress per length.
        alpha, C, G: as of `NonMonotone`, per thickness.
        chi_12, chi_22: chi n in the layer's axes.
        minus: 1, or 0 for Eq. (43) as printed, which has no phase -1.
    """

    mu: float
    K_N: float
    alpha: float
    C: float
    G: float
    chi_12: float
    chi_22: float
    minus: float = 1.0

    @classmethod
    def of(cls, layer: NonMonotone, **changed: float) -> Formula:
        """The interface law of a layer, with some coefficients changed."""
        given = layer.parameters()
        same = {name: given[name] for name in ("mu", "alpha", "G")} | {"C": given["transformation_energy"]}
        same |= {"K_N": layer.lmbda + 2 * layer.mu, "chi_12": layer.chi[0, 1], "chi_22": layer.chi[1, 1]}
        return cls(**same | changed)

    def traction(self, step: JumpStep) -> Expr:
        """Traction, as of any `TractionLaw`."""
        w, n = step.mid, step.n
        w_N, tangent = ufl.dot(w, n), ufl.as_vector([n[1], -n[0], 0])
        stress = self.alpha * (self.chi_12 * tangent + self.chi_22 * n)
        m = ufl.dot(stress, w)
        fraction = ufl.min_value(ufl.max_value((abs(m) - self.C) / (self.alpha**2 * self.G) + 0.5, 0), 1)
        phase = fraction * ufl.conditional(ufl.lt(m, 0), -self.minus, 1)
        return self.mu * (w - w_N * n) + self.K_N * w_N * n - phase * stress


# wrong laws on S: the layer's case, the law (lmbda + mu, no phase -1, 1/(lmbda + 2 mu)), relative errors that stay
WRONG: dict[str, tuple[str, Formula, Floors]] = {
    "printed": ("", Formula.of(CASES[""][0], K_N=100.0), {"traction": (0.13, 0.16), "jump": (0.22, 0.26)}),
    "one_branch": ("", Formula.of(CASES[""][0], minus=0.0), {"traction": (0.12, 0.16), "jump": (0.29, 0.35)}),
    "small_gain": ("across", Formula.of(CASES["across"][0], G=1 / 140), {"traction": (0.018, 0.026)}),
}


def run(record: Record, *, eps: Sequence[float] = (1 / 16, 1 / 32, 1 / 64, 1 / 128), quick: bool = False) -> None:
    """Sweep the thickness; alpha, and the moduli and C per thickness, are held.

    table.csv: relaxed law, chi with a normal and a tangential part; phases -1, 0, 1 and mixtures share S. table_across.csv:
    chi = n (x) n. table_along.csv: chi = sym(t (x) n), whose mixtures have no stiffness along S. Wrong laws on S leave an
    error: table_printed.csv (lambda + mu of Eqs. (41)-(42)), table_one_branch.csv (no phase -1, Eq. (43)),
    table_small_gain.csv (n (x) n, laminates across n alone). table_unrelaxed.csv: pure phases, followed from rest as the
    upper side is moved; columns of the meshed layer switch as facets of S do, at times that differ by O(eps).

    Args:
        record: where to write.
        eps: thicknesses; the blocks are 0.5 high and 2 wide.
        quick: coarser mesh, and fewer thicknesses with wrong laws.
    """
    h, thin = (1 / 8, sorted(eps)[:2]) if quick else (1 / 16, eps)
    sweeps = {
        case: Sweep(record, *blocks(h, shear, pull), partial(ThinLayer, law, at=1.0), cells_through=2)
        for case, (law, shear, pull) in CASES.items()
    }
    tables = {}
    for case, sweep in sweeps.items():
        right = replace(sweep, case=case, more=partial(phases, record, case, max(eps)))
        tables[case] = right.run(eps, (0.9, 1.1), pictured=None if case else max, title="non-monotone layer")
        for share in ("plus", "minus", "mixed"):
            record.check(f"share of S, {share}, {TITLES[case]}", tables[case][share][-1], low=SHARE)
    for name, (case, wrong, floors) in WRONG.items():
        with warnings.catch_warnings(action="ignore", category=RangeWarning):  # with lmbda + mu the stress falls
            found = replace(sweeps[case], case=name, instead=wrong).run(thin, None, pictured=None)
        check_floors(record, name, found, tables[case], floors)
    unrelaxed(record, eps)


def blocks(h: float, shear: float, pull: float, *, moved: bool = False) -> tuple[Joint, dict[str, Any]]:
    """Two blocks, 2 wide and 0.5 high, under (shear sin(pi x), pull cos(pi x/2)) on top; joint, data of its models.

    That is a traction, or, times t, a displacement. The lower side is clamped, the lateral sides are on rollers.
    """
    joint = sandwich(2.0, 0.5, 0.5, h, cell="quadrilateral", structured=True)

    def top(x: Any, t: Any) -> tuple[Any, Any]:
        share = t if moved else 1
        return share * shear * ufl.sin(ufl.pi * x[0]), share * pull * ufl.cos(ufl.pi * x[0] / 2)

    supports: dict[str, Any] = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    moves = {"TOP": {"x": lambda x, t: top(x, t)[0], "y": lambda x, t: top(x, t)[1]}}
    data = {"supports": supports | (moves if moved else {}), "tractions": {} if moved else {"TOP": top}}
    return joint, {"body": FOURIER_BODY} | data


def phases(record: Record, case: str, pictured: float, full: Solution, limit: Solution) -> dict[str, float]:
    """Shares of S in phase 1, in -1, and where they are mixed; columns whose phase in the meshed layer is another one.

    The phases along S are noted for one thickness.
    """
    state = last(limit)
    (x, on_s), (_, meshed) = (phases_on_s(last(one)) for one in (limit, full))
    if layer_of(full).eps == pictured:
        record.write(f"phases_{case}.csv", Table.of({"x": x, MESHED: meshed, ON_S: on_s}))
    mixed = (abs(on_s) > CLOSE) & (abs(on_s) < 1 - CLOSE)
    (row,), differ = Surface(state.model).table(state).rows, abs(meshed - on_s) > 0.5
    shares = {name: float(row[name] or 0.0) for name in ("plus", "minus")}
    return shares | {"mixed": float(mixed.mean()), "differ": float(differ.sum())}


def unrelaxed(record: Record, eps: Sequence[float]) -> None:
    """Sweep the thickness for pure phases; phases, times of snaps and the energy lost in them."""

    def more(full: Solution, limit: Solution) -> dict[str, float]:
        assert isinstance(full, History)
        assert isinstance(limit, History)
        return phases(record, "unrelaxed", max(eps), full, limit) | snaps(full, limit)

    setup, layer = blocks(2 / COLUMNS, *MOVED, moved=True), partial(ThinLayer, PURE, at=1.0)
    sweep = Sweep(record, *setup, layer, cells_through=2, times=TIMES, case="unrelaxed", more=more)
    table = sweep.run(eps, (0.9, 1.1), title="non-monotone layer, pure phases")
    record.check("columns in another phase than on S, unrelaxed, any eps", table["differ"].max(), high=0.0)
    record.check("snaps, unrelaxed", table["snaps"].min(), low=5.0)
    for what, high in {"times": 1.3, "lost": 1.6}.items() if len(eps) > 1 else ():
        record.check(f"last observed order, {what}, of snaps", last_order(table, f"error_{what}"), low=0.85, high=high)


def snaps(full: History, limit: History) -> dict[str, float]:
    """Snaps on S; largest difference of their times from the meshed layer's, and that of energies lost, both relative."""
    meshed, on_s = (np.array([(snap.t, snap.lost) for snap in one.snaps]).reshape(-1, 2) for one in (full, limit))
    if not len(meshed) == len(on_s) > 0:
        return {"snaps": len(on_s), "error_times": np.nan, "error_lost": np.nan}
    times, lost = abs(meshed - on_s)[:, 0].max() / on_s[-1, 0], meshed[:, 1].sum() / on_s[:, 1].sum() - 1
    return {"snaps": len(on_s), "error_times": float(times), "error_lost": float(abs(lost))}


def draw(record: Record) -> None:
    """Draw the rates and the phases along S from the tables."""
    cases = {title: case for case, title in TITLES.items()}
    draw_rates(record, "non-monotone layer", cases | {"lambda + mu on S": "printed"}, apart=True)
    tables = {title: record.load(f"phases_{case}.csv") for title, case in cases.items()}
    parts = {title: {name: (table["x"], table[name]) for name in (MESHED, ON_S)} for title, table in tables.items()}
    plotting.curves(parts, "x", "phase", styles={ON_S: "o"}, columns=2, save=record.path("phases.png"))
