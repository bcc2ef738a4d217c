"""Figure 4: the bar of section 6.2 on a layer of two phases; its least energy, its snaps, and its limit as eps -> 0.

The bar is a strip on a rigid base: nu = 0, sides on rollers, chi = n (x) n; its end moves by delta. The relaxed law
gives the least energy of all mixtures, Eqs. (45)-(47) of the paper, corrected. If each column of cells through the
layer is in a pure phase, there are several equilibria at the same delta. The layer then keeps its equilibrium until
this no longer exists, and snaps to another one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from forms import LinearElastic, NonMonotone, NonMonotoneUnrelaxed, formulas
from forms.base import Array
from forms.non_monotone import PhaseLaw
from geometry import block
from studies.sweeping import Curves
from thinlayer import Structure, Surface, Table, ThinLayer, march, piecewise, plotting
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.supports import Support
from thinlayer.running.record import Record
from thinlayer.solving.history import History
from thinlayer.system.progress import track
from thinlayer.time.journal import Observers

BAR = formulas.Bar(l=1.0, K=2.0, kbar=3.0, alpha=1.2, cbar=0.9, eps=0.1)
EPS = (BAR.eps, 0.05, 0.01, 0.0)  # thicknesses over the length of the bar; 0: the interface law
END_DELTA = 2.0  # largest prescribed displacement delta
THRESHOLDS = ("delta_0", "delta_1", "up", "down", "loop_area")
ATTRIBUTES = {"up": "snap_elongation", "down": "snap_back_elongation"}  # of `Bar`, where named otherwise
KNOWN_THRESHOLDS = {BAR.eps: (1.2925, 1.6925, 1.7625, 1.2225, 0.275744680851), 0.0: (1.375, 1.775, 1.875, 1.275, 0.288)}
KNOWN_DELTA = 1.6
KNOWN_AT_DELTA = {"U": 0.8575, "boundary": 0.23125 * BAR.eps * BAR.l, "energy": 1.5736875}
FIT_RANGES = ((0.0, 1.25), (1.38, 1.65), (1.78, END_DELTA))  # ranges of delta inside the straight parts, for all eps
RTOL = 1e-9  # largest relative error against closed forms


def run(record: Record, *, quick: bool = False) -> None:
    """Move the end of the bar up and down, with the layer meshed and with its interface law, and check closed forms.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: coarser mesh, longer steps.
    """
    cells, steps = (2, 10) if quick else (4, 20)
    table, loops, thresholds = (record.new_table(name) for name in ("table.csv", "table_loop.csv", "table_limit.csv"))
    for eps in track(EPS, "fig4_bar", "eps = {:g}"):
        strip = Strip(record, eps, cells)
        relaxed, unrelaxed = strip.march(NonMonotone, steps), strip.march(NonMonotoneUnrelaxed, steps)
        table.extend(strip.check_relaxed(relaxed))
        loops.extend(strip.state_rows(unrelaxed))
        thresholds.append(strip.check_thresholds(relaxed, unrelaxed))
        if eps in (BAR.eps, 0.0):
            check_energies(record, strip, relaxed, unrelaxed)
    check_known_values(record, table, thresholds)


class Strip:
    """The bar of Fig. 4 as a strip, 1 wide, with the layer meshed or replaced by its interface law.

    Args:
        record: record of the run, which receives reports and checks.
        eps: thickness of the meshed layer over the length of the bar; 0: the interface law.
        cells: number of cells along each side.
    """

    def __init__(self, record: Record, eps: float, cells: int) -> None:
        self.record, self.bar = record, replace(BAR, eps=eps)
        self.joint = block(1.0, BAR.l, BAR.l / cells, cell="quadrilateral", structured=True)
        self.surface = Surface(self._model(replace(BAR, eps=0.0), NonMonotone))

    def _model(self, bar: formulas.Bar, law: type[PhaseLaw]) -> Model:
        material = law(0.0, bar.kbar / bar.l / 2, bar.alpha, bar.l * bar.cbar, np.diag([0.0, 1.0]))
        displacement = piecewise({0: 0, END_DELTA: END_DELTA, 2 * END_DELTA: 0})
        supports: dict[str, Support] = {"LEFT": {"x": 0}, "RIGHT": {"x": 0}, "TOP": {"x": 0, "y": displacement}}
        layer = ThinLayer(material, (bar.eps or BAR.eps) * bar.l, at=1.0)  # the interface law does not depend on eps
        structure = Structure(self.joint, body=LinearElastic(0.0, bar.K / 2), supports=supports, element="Q1")
        return structure.full(layer, bodies="extended", cells_through=3) if bar.eps else structure.interface(layer)

    def march(self, law: type[PhaseLaw], steps: int) -> History:
        """March while the upper end moves up to delta = 2 and back to 0.

        The table of the history has two more columns than usual: "U", the integral of the normal jump over S, and
        "sigma", the force at the end that moves.

        Args:
            law: class of the layer's law: `NonMonotone` (phases may mix) or `NonMonotoneUnrelaxed` (pure phases).
            steps: number of equal steps in each direction.
        """
        model, times = self._model(self.bar, law), [END_DELTA * k / steps for k in range(1, 2 * steps + 1)]
        observers: Observers = {
            "U": lambda state: self.surface.integral(self.surface.jump(state)[1]),
            "sigma": lambda state: state.reaction("TOP").force[1],
        }
        return self.record.add_report(march(model, times, observe=observers, keep="last"))

    def state_rows(self, history: History) -> Table:
        """Return a table with a row for each state of a march of this strip.

        Its columns are "eps", "delta" (prescribed displacement), "U" (elongation of the layer), "sigma" (force) and
        "energy". Two more are "phase" (fraction of the layer in phase 1) and "lost" (energy lost in a snap to this
        state, else empty).
        """
        lost_energies = {snap.row: snap.lost for snap in history.snaps}
        state_table, delta = history.table, delta_at(history.t)
        columns = {name: state_table[name] for name in ("U", "sigma", "energy")} | {"phase": state_table["plus"]}
        lost_column = [lost_energies.get(k) for k in range(len(state_table))]
        return Table.of({"eps": self.bar.eps, "delta": delta, **columns, "lost": lost_column})

    def check_relaxed(self, history: History) -> Table:
        """Check a march with mixing phases against closed forms, and return the table of its first half, the way up.

        The table has the columns of `state_rows`, except "lost", and "boundary", the height of the boundary between the
        phases. The column "NAME_exact" is the closed form of the column NAME.

        Args:
            history: march with `NonMonotone`.
        """
        rows = self.state_rows(history)
        delta, bar = rows["delta"], self.bar
        exact = {name: getattr(bar, name)(delta) for name in ("U", "sigma", "energy", "phase", "boundary")}
        curves = {name: rows[name] for name in list(exact)[:4]} | {"boundary": bar.eps * bar.l * (1 - rows["phase"])}
        if bar.eps:
            curves["boundary"] = history.table["boundary"]
        errors = [np.abs(curves[name] - values).max() / (values.max() or 1) for name, values in exact.items()]
        self.record.check(f"{self}: relative error of {', '.join(exact)}, relaxed law", max(errors), high=RTOL)
        columns = curves | {f"{name}_exact": values for name, values in exact.items()}
        half = slice(len(rows) // 2 + 1)
        return Table.of({"eps": bar.eps, "delta": delta[half], **{name: col[half] for name, col in columns.items()}})

    def check_thresholds(self, relaxed: History, unrelaxed: History) -> dict[str, float]:
        """Check the displacements delta at which the response changes, and the energy lost in a cycle of pure phases.

        Args:
            relaxed: march with the relaxed law, whose phases may mix.
            unrelaxed: march with pure phases.

        Returns:
            "eps" and the checked numbers: "delta_0" and "delta_1", where the relaxed law's phases begin and end to mix;
            "up" and "down", where pure phases snap; and "loop_area", the energy lost.
        """
        delta, sigma = delta_at(relaxed.t), relaxed.table["sigma"]
        masks = [(delta >= low) & (delta <= high) for low, high in FIT_RANGES]
        line_0, mixed, line_1 = (np.polyfit(delta[mask], sigma[mask], 1) for mask in masks)
        meetings = [float(np.roots(line - mixed)[0]) for line in (line_0, line_1)]
        up, down = delta_at(np.array([snap.t for snap in unrelaxed.snaps]))
        lost = [snap.lost for snap in unrelaxed.snaps]
        row = dict(zip(THRESHOLDS, (*meetings, up, down, sum(lost)), strict=True))
        error = max(abs(value / getattr(self.bar, ATTRIBUTES.get(name, name)) - 1) for name, value in row.items())
        self.record.check(f"{self}: relative error of {', '.join(row)}", error, high=RTOL)
        area = float(np.trapezoid(unrelaxed.table["sigma"], delta_at(unrelaxed.t)))
        self.record.check_near(f"{self}: area of the loop, force over delta", area, self.bar.loop_area, RTOL)
        self.record.check_near(f"{self}: energy lost in the first snap over half of it", 2 * lost[0] / area, 1.0, RTOL)
        return {"eps": self.bar.eps} | row

    def __str__(self) -> str:
        return f"eps = {self.bar.eps:g}" if self.bar.eps else "interface law"


def check_energies(record: Record, strip: Strip, relaxed: History, unrelaxed: History) -> None:
    """Check that the least energy of a layer in one pure phase lies between the energies of two marches.

    With pure phases the layer may be in a local minimum, with more energy than this. With the relaxed law, whose phases
    may mix, the energy is at most as large.

    Args:
        record: record of the run, which receives the checks.
        strip: the strip of both marches.
        relaxed: march with the relaxed law, whose phases may mix.
        unrelaxed: march with pure phases.
    """
    bar, delta, energy = strip.bar, delta_at(unrelaxed.t), unrelaxed.table["energy"]
    excess = energy - bar.layout_responses(delta, 1).of_least_energy().energy
    record.check(f"{strip}: energy of a local minimum less the least one, smallest", excess.min(), low=-RTOL)
    record.check_near(f"{strip}: the same, largest: half of the loop", excess.max(), bar.loop_area / 2, RTOL)
    excess_relaxed = bar.layout_responses(delta_at(relaxed.t), 1).of_least_energy().energy - relaxed.table["energy"]
    record.check(f"{strip}: the least one less the relaxed one", excess_relaxed.min(), low=-RTOL)


def check_known_values(record: Record, table: Table, thresholds: Table) -> None:
    """Check results of the bar against known digits, and that its thresholds are linear in eps.

    Also check that the paper's formula for U before Eq. (47) is wrong.

    Args:
        record: record of the run, which receives the checks.
        table: rows of `Strip.check_relaxed` for all thicknesses.
        thresholds: a row of `Strip.check_thresholds` for each thickness.
    """
    for eps, digits in KNOWN_THRESHOLDS.items():
        for name, value in zip(THRESHOLDS, digits, strict=True):
            record.check_near(f"{name} of the bar, eps = {eps:g}", thresholds[name][EPS.index(eps)], value, RTOL)
    row_number = np.flatnonzero((table["eps"] == BAR.eps) & np.isclose(table["delta"], KNOWN_DELTA))[0]
    for name, value in KNOWN_AT_DELTA.items():
        record.check_near(f"{name} at delta = {KNOWN_DELTA:g}", table[name][row_number], value, RTOL)
    is_pure = (table["eps"] == BAR.eps) & (table["delta"] > 0) & (table["delta"] < BAR.delta_0)
    printed_U = BAR.K * table["delta"] * BAR.R / (1 - BAR.eps)  # before Eq. (47)
    record.check("U before delta_0: printed over computed", (printed_U[is_pure] / table["U"][is_pure]).min(), low=4.0)
    for name in THRESHOLDS[:4]:
        slopes = (thresholds[name][:-1] - thresholds[name][-1]) / thresholds["eps"][:-1]
        record.check_near(f"{name}: slope in eps, largest over smallest", slopes.max() / slopes.min(), 1.0, RTOL)


def delta_at(t: Array) -> Array:
    """Return the prescribed displacement delta (n,) of the bar's end at the times `t` (n,): up to 2 and back to 0."""
    return END_DELTA - np.abs(t - END_DELTA)


# ---------------------------------------------------------------- pictures
CUT_DELTAS = (1.0, 1.6, 2.0)  # delta of the three intersections
N_ELEMENTS = 8
ENERGY, FORCE = "energy of the layer", "force"  # panels
DELTAS = np.linspace(0.0, END_DELTA, 401, dtype=np.float64)


def draw(record: Record) -> None:
    """Draw energies and forces over the layer's elongation, and force over displacement.

    The data are read from the tables in the folder of `record`; the pictures are energies.svg and response.svg.
    """
    by_eps = record.load("table.csv").split("eps")
    draw_energies(record, by_eps[BAR.eps])
    draw_response(record, by_eps[BAR.eps], record.load("table_loop.csv").split("eps")[BAR.eps])


def draw_energies(record: Record, relaxed: Table) -> None:
    """Draw energies of the layer over its elongation, as in Fig. 4, and in a second panel forces of layer and bar.

    `record` has the folder of the picture; `relaxed` are the rows of `Strip.check_relaxed` for one thickness.
    """
    U = np.linspace(0, 1.35, len(DELTAS), dtype=np.float64)
    (_, least_energy, _), (force, envelope, _) = BAR.layer_response(U, 0), BAR.layer_response(U, 1)
    phase_0 = BAR.kbar / BAR.l * U**2 / 2
    phase_1 = phase_0 - BAR.alpha * U + BAR.l * BAR.cbar
    layer_force = BAR.kbar / BAR.l * U - np.where(phase_0 < phase_1, 0.0, BAR.alpha)
    lines = {f"body, delta = {delta:g}": (U, BAR.K / (BAR.l * (1 - BAR.eps)) * (delta - U)) for delta in CUT_DELTAS}
    is_cut = np.isclose(relaxed["delta"][:, None], CUT_DELTAS).any(axis=1)
    computed = f"computed, eps = {BAR.eps:g}"
    hull_label, phases = "CW_min, convex envelope", ("W_1, phase 0", "W_2, phase 1")
    layer_curves = zip((*phases, "W_min", hull_label), (phase_0, phase_1, least_energy, envelope), strict=True)
    energies = {name: (U, y) for name, y in layer_curves}
    forces = {"W_min": (U, layer_force), hull_label: (U, force), **lines}
    forces[computed] = relaxed["U"][is_cut], relaxed["sigma"][is_cut]
    panels, units = {ENERGY: energies, FORCE: forces}, {ENERGY: "over K l²/2", FORCE: "over K l/2"}
    styles, limits = ("--", "--", "-", "-", ":", ":", ":", "o"), {ENERGY: (0.0, 2.2), FORCE: (0.0, 3.2)}
    options = {"styles": styles, "colours": {"W_min": "0.6", hull_label: "black", computed: "black"}, "ylim": limits}
    plotting.curves(panels, "U, elongation of the layer, over l", units, save=record.path("energies.svg"), **options)


def draw_response(record: Record, relaxed: Table, loop: Table) -> None:
    """Draw the force over the displacement of the bar's end, computed and in closed form.

    There are lines for the least energy, and for pure phases, whose snaps form a loop. All equilibria of a layer of
    eight elements, each in a pure phase, are in the background.

    Args:
        record: record of the run, which has the folder of the picture.
        relaxed: rows of `Strip.check_relaxed` for one thickness.
        loop: rows of a march with pure phases for the same thickness.
    """
    layouts = BAR.layout_responses(DELTAS, N_ELEMENTS)
    equilibria = np.where(layouts.is_local_minimum, layouts.sigma, np.nan)
    equilibria[-1] = np.nan  # a gap between the lines
    delta = np.array([[0.0, BAR.snap_elongation], [BAR.snap_back_elongation, END_DELTA]])
    pure_force = np.array([BAR.responses_at(ends, phase).sigma for phase, ends in enumerate(delta)])
    lost_text = ", ".join(f"{energy:.4f}" for energy in loop["lost"][~np.isnan(loop["lost"])])
    all_label = f"pure phases in {N_ELEMENTS} elements, all equilibria"
    run_label = f"the same, computed; energies lost in snaps: {lost_text}"
    lines: Curves = {all_label: (np.tile(DELTAS, equilibria.shape[1]), equilibria.T.ravel())}
    lines["least energy, closed form"] = DELTAS, BAR.sigma(DELTAS)
    lines["relaxed law, computed"] = relaxed["delta"], relaxed["sigma"]
    lines["one phase, kept while it holds, closed form"] = np.insert(delta, 2, np.nan), np.insert(pure_force, 2, np.nan)
    lines[run_label] = loop["delta"], loop["sigma"]
    labels, save = ("delta, displacement of the end, over l", "sigma, force, over K l/2"), record.path("response.svg")
    options = {"styles": ("-", "-", "o", "-", "s--"), "colours": {all_label: "0.75", run_label: "black"}, "save": save}
    plotting.curves(lines, *labels, title="a bar on a layer of two phases: pure ones snap", **options)
