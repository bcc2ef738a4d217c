"""Figures 7 and 8: a bar pushed along a rigid base; contact status and tangential jump for three stiffnesses."""

from __future__ import annotations

import math

import numpy as np

from forms import HolonomicCoulomb
from studies.problems import sliding_bar
from studies.sweeping import Curves
from thinlayer import Structure, Surface, plotting, solve
from thinlayer.running.record import Record

FRICTION = 1.0
N = 31  # squares along AB: 32 nodes with the fixed corner B
MODULI = ((15e8, 5e8), (15e4, 5e4), (15.0, 5.0))  # lmbda, mu per thickness, N/mm^3
PAPER_COUNTS = ((3, 15, 13), (2, 14, 15), (0, 0, 31))  # separated, sliding, stick; the paper counts B among the last 31
LEVELS = "separated", "sliding", "stick", "pinned"
STATUS, DISPLACEMENT = "status of the nodes (Fig. 7)", "tangential displacement (mm, Fig. 8)"
PANEL_COLUMNS = {"pressure (MPa)": "p_MPa", "friction (MPa)": "t_MPa", DISPLACEMENT: "u_T_mm"}
U_A = (1.456232e-2, 1.458569e-2, 4.094504e-2)  # mm, u_T at A from an independent code on the same mesh


def run(record: Record) -> None:
    """Solve the bar of Fig. 7 for the three stiffnesses of Fig. 8, on two meshes, and check the status of nodes on S.

    The numbers of separated, sliding and sticking nodes must be those of the paper, and almost the same on both meshes.

    Args:
        record: record of the run, with its folder, tables and checks.
    """
    reports = {}
    for n in (N, N + 1):
        joint, setup = sliding_bar(n)
        for pair in MODULI:
            law = HolonomicCoulomb.of_layer(*pair, friction=FRICTION)
            state = record.add_report(solve(Structure(joint, **setup).interface(law)))
            reports[n, pair] = Surface(state.model).contact(state)
    columns = {"x_mm": "x", "u_T_mm": "u_T", "u_N_mm": "u_N", "p_MPa": "p", "t_MPa": "t_T", "status": "status"}
    table = record.new_table("table.csv")
    for (lmbda, mu), paper_counts, u_a in zip(MODULI, PAPER_COUNTS, U_A, strict=True):
        report, stiffness = reports[N, (lmbda, mu)], f"λ, μ = {lmbda:.3g}, {mu:.3g} N/mm³"
        nodes = ({column: row[name] for column, name in columns.items()} for row in report.table)
        table.extend({"lmbda": lmbda, "mu": mu, **node} for node in nodes)
        for name, count in zip(LEVELS[:3], paper_counts, strict=True):
            record.check(f"{stiffness}: {name} nodes, {count} expected", report.counts[name], low=count, high=count)
        record.check_near(f"{stiffness}: u_T at A, mm", float(report.u_T[0, 0]), u_a, 1e-6)
        excess = (np.linalg.norm(report.t_T, axis=1) - FRICTION * report.p).max() / report.p.max()
        record.check(f"{stiffness}: largest (|t_T| - f p) / p", excess, high=1e-12)
        record.check(f"{stiffness}: equilibrium", report.equilibrium, high=1e-9)
        record.check(f"{stiffness}: Clapeyron", report.clapeyron, high=1e-9)
        max_change = max(abs(reports[N + 1, (lmbda, mu)].counts[name] - count) for name, count in report.counts.items())
        record.check(f"{stiffness}: counts on the next mesh move by", max_change, high=1)


def stiffness_label(lmbda: float) -> str:
    """Return the label "lambda = 3 mu = 15·10^k N/mm³" of a layer in a picture.

    Args:
        lmbda: Lame's modulus of the layer divided by its thickness, N/mm^3. In `MODULI` it is 15 times a power of ten,
            10^k. The label has no power if k is 0.
    """
    exponent = round(math.log10(lmbda / 15))
    return f"lambda = 3 mu = 15{f'·10^{exponent}' if exponent else ''} N/mm³"


def draw(record: Record) -> None:
    """Draw status, pressure, friction and displacement of the nodes along S for the three stiffnesses (Figs. 7 and 8).

    The values are read from table.csv in the folder of `record`.
    """
    panels = {title: Curves() for title in (STATUS, *PANEL_COLUMNS)}
    for k, (lmbda, part) in enumerate(record.load("table.csv").split("lmbda").items()):
        status = [str(row["status"]) for row in part.rows]
        name = f"{stiffness_label(lmbda)}: " + ", ".join(f"{status.count(level)} {level}" for level in LEVELS[:3])
        panels[STATUS][name] = part["x_mm"], [LEVELS.index(level) + 0.2 * (1 - k) for level in status]
        for title, column in PANEL_COLUMNS.items():
            panels[title][name] = part["x_mm"][:-1], part[column][:-1]  # without B, where the force is a support's
    look = {"styles": ("o-", "s--", "^:"), "columns": 2, "levels": {STATUS: LEVELS}, "save": record.path("contact.svg")}
    plotting.curves(panels, "x from A to B (mm)", title="a bar pushed along a rigid base, 32 nodes", **look)
