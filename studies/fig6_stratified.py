"""Figures 5 and 6: a bar on a layer of two elastic sublayers, and tangential traction over displacement along S."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from forms import LinearElastic, Stack
from geometry import block
from studies.problems import BAR_LAW
from thinlayer import Structure, Surface, Table, ThinLayer, plotting, solve
from thinlayer.discretisation.state import State
from thinlayer.running.record import Record
from thinlayer.system.progress import track

EPS = 0.1  # mm
SOFT_LAW, HARD_LAW = (LinearElastic.shear(mu=mu, nu=0.3) for mu in (7.5e3, 10e3))  # MPa
GLUE = Stack((0.5, SOFT_LAW), (0.5, HARD_LAW))
K_T = 1 / (0.5 * EPS / 7.5e3 + 0.5 * EPS / 10e3)  # N/mm^3: compliances add
WIDTH = HEIGHT = 40.0  # mm
INNER_RANGE = (6.0, 30.0)  # mm: away from the ends of the layer, whose influence decays over a few mm
POINT_X = 10.0  # mm, where the deviation is followed as eps -> 0


def run(record: Record, *, eps: Sequence[float] = (0.4, 0.2, 0.1, 0.05), quick: bool = False) -> None:
    """Solve the bar of Fig. 5 at eps = 0.1 mm, then follow the deviation of t_T/u_T from K_T as eps -> 0.

    t_T is the tangential traction, u_T the tangential jump, and K_T the tangential stiffness of the interface law.

    Args:
        record: record of the run, with its folder, tables and checks.
        eps: thicknesses (mm) at which the deviation is computed.
        quick: coarser mesh.
    """
    bar = StratifiedBar(record, *((4.0, 0.5, 0.1) if quick else (2.0, 0.2, 0.02)))
    x, ratio_interface = bar.stiffness_profile(bar.limit)
    full = bar.solve_full(ThinLayer(GLUE, EPS))
    _, ratio_band = bar.stiffness_profile(full)
    record.write("table.csv", Table.of({"x_mm": x, "ratio_band": ratio_band, "ratio_interface": ratio_interface}))
    states, title = {f"meshed layer, eps = {EPS:g} mm": full, "interface law": bar.limit}, "bar on a stratified layer"
    plotting.deformed(states, plotting.View(unit="mm"), save=record.path("deformed.png"), title=title)
    end_view = plotting.View(unit="mm", scale=100, zoom=(-0.15, 0.65, -0.15, 0.45))
    plotting.deformed(states, end_view, save=record.path("layer_end.png"), title=f"{title}: its free end")

    deviation = _deviation_table(record, bar, sorted(eps, reverse=True))
    is_inner = (x >= INNER_RANGE[0]) & (x <= INNER_RANGE[1])
    for model, ratio, tolerance in (("meshed layer", ratio_band, 1e-3), ("interface law", ratio_interface, 1e-6)):
        max_error = np.abs(ratio[is_inner] / K_T - 1).max()
        record.check(f"largest |t_T/u_T / K_T - 1| of the {model}, x in {INNER_RANGE} mm", max_error, high=tolerance)
        stiffness, what = np.interp(POINT_X, x, ratio), f"t_T/u_T of the {model} at {POINT_X:g} mm, N/mm^3"
        record.check_near(what, stiffness, K_T, tolerance)
    if len(eps) > 1:
        what = f"last observed order of the deviation at {POINT_X:g} mm, moduli held"
        record.check(what, deviation["order_moduli_held"][-1], low=0.9, high=1.1)


class StratifiedBar:
    """The bar of Fig. 5 on any layer, and its tangential traction over tangential jump along S.

    Args:
        record: record of the run, which keeps the solver's reports.
        h: size of cells inside the bar, mm.
        h_S: size of cells on S, mm.
        h_ends: size of cells at the ends of S, mm.
    """

    def __init__(self, record: Record, h: float, h_S: float, h_ends: float) -> None:
        self.record, self.joint = record, block(WIDTH, HEIGHT, h, h_S=h_S, h_ends=h_ends)
        loads = {"LEFT": (50.0, 0.0), "TOP": (0.0, -25.0)}
        self.bar = Structure(self.joint, body=BAR_LAW, supports={"RIGHT": {"x": 0.0}}, tractions=loads)
        model = self.bar.interface(ThinLayer(GLUE, EPS))
        self.limit, self.surface = record.add_report(solve(model)), Surface(model)

    def solve_full(self, layer: ThinLayer) -> State:
        """Solve the bar on `layer`, which is meshed."""
        return self.record.add_report(solve(self.bar.full(layer)))

    def stiffness_profile(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Return x (n,), mm, and tangential traction over tangential jump (n,), N/mm^3, at vertices of S in `state`.

        Both fields are projected to functions linear on each facet. The last mm of S, where both are zero, is left out.
        """
        surface = self.surface
        x, u = surface.profile(surface.frame(surface.jump(state)))
        _, t = surface.profile(surface.frame(surface.reaction(state)))
        is_free = x[:, 0] < WIDTH - 1.0
        return x[is_free, 0], t[is_free, 0] / u[is_free, 0]

    def stiffness_deviation(self, layer: ThinLayer, k_t: float) -> float:
        """Solve the bar on the meshed `layer`, and return (t_T/u_T)/`k_t` - 1 at x = 10 mm.

        t_T is the tangential traction, u_T the tangential jump, and `k_t` a stiffness, N/mm^3.
        """
        x, ratio = self.stiffness_profile(self.solve_full(layer))
        return float(np.interp(POINT_X, x, ratio) / k_t - 1)


def _deviation_table(record: Record, bar: StratifiedBar, eps: Sequence[float]) -> Table:
    """Tabulate the deviation of t_T/u_T from K_T for the thicknesses `eps`, with observed rates of convergence.

    t_T is the tangential traction, u_T the tangential jump, and K_T the tangential stiffness of the interface law.
    There are two series. In "ratios_held" moduli are proportional to the thickness, and K_T is constant. In
    "moduli_held" moduli are constant, and K_T is proportional to 1/eps. `record` writes the table to deviation.csv.
    """
    table = Table()
    for e in track(eps, "fig6_stratified", "eps = {:g} mm"):
        row = {"eps_mm": e, "deviation_ratios_held": bar.stiffness_deviation(ThinLayer(GLUE, e, at=EPS), K_T)}
        table.append(row | {"deviation_moduli_held": bar.stiffness_deviation(ThinLayer(GLUE, e), K_T * EPS / e)})
    orders = {f"order_{way}": table.orders(f"deviation_{way}", of="eps_mm") for way in ("ratios_held", "moduli_held")}
    table = Table.of({name: table[name] for name in table.columns} | orders)
    record.write("deviation.csv", table)
    return table


def draw(record: Record) -> None:
    """Draw Fig. 6, tangential traction over tangential jump along S, from table.csv in the folder of `record`."""
    table = record.load("table.csv")
    x, law = table["x_mm"], table["ratio_interface"] / 1e3
    lines = {"meshed layer": (x, table["ratio_band"] / 1e3), "interface law": (x[::8], law[::8])}
    lines[f"harmonic mean, {K_T / 1e3:.2f}"] = x, 0 * x + K_T / 1e3
    lines["arithmetic mean, 87.50"] = x, 0 * x + (7.5 + 10) / 2 / EPS
    title, x_label = "two sublayers: their stiffness is the harmonic mean", "x (mm), from the free end to the held one"
    options = {"title": title, "styles": ("-", "o", "--", ":"), "ylim": (82, 90), "save": record.path("ratio.svg")}
    plotting.curves(lines, x_label, "t_T / u_T (10^3 N/mm³)", **options)
