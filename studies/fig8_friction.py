"""Figures 7 and 8: a bar pushed along a rigid base; contact status and tangential displacement for three stiffnesses."""

from __future__ import annotations

import numpy as np

from forms import HolonomicCoulomb
from studies.problems import sliding_bar
from thinlayer import Structure, Surface, Table, plotting, solve
from thinlayer.running.record import Record

FRICTION = 1.0
N = 31  # squares along AB: 32 nodes with the held corner B
STIFFNESS = ((15e8, 5e8), (15e4, 5e4), (15.0, 5.0))  # lmbda, mu per thickness, N/mm^3
COUNTS = ((3, 15, 13), (2, 14, 15), (0, 0, 31))  # separated, sliding, stick; the paper counts B to the last 31
U_A = (1.456232e-2, 1.458569e-2, 4.094504e-2)  # mm, u_T at A from an independent code on the same mesh


def run(record: Record) -> None:
    """Solve the bar for the stiffnesses of Fig. 8, and on one more mesh.

    Args:
        record: where to write.
    """
    record.parameters = {"friction": FRICTION, "squares": N, "lmbda_mu_per_mm": STIFFNESS}
    table, reports, states, counts = Table(), {}, {}, {}
    for n in (N, N + 1):
        joint, setup = sliding_bar(n)
        for lmbda, mu in STIFFNESS:
            law = HolonomicCoulomb.of_layer(lmbda, mu, friction=FRICTION)
            state = record.solved(solve(Structure(joint, **setup).interface(law)))
            report = Surface(state.model).contact(state)
            counts[n, lmbda] = report.counts
            if n == N:
                reports[label(lmbda, mu)], states[label(lmbda, mu)] = report, state
                for row in report.table.rows:
                    names = {"x_mm": "x", "u_T_mm": "u_T", "u_N_mm": "u_N", "p_MPa": "p", "t_MPa": "t_T"}
                    values = {column: row[name] for column, name in names.items()}
                    table.append({"lmbda": lmbda, "mu": mu} | values | {"status": row["status"]})
    record.write("table.csv", table)
    record.results["counts"] = [{"squares": n, "lmbda": lmbda, **found} for (n, lmbda), found in counts.items()]
    for entry in record.results["counts"]:
        record.say(entry)
    surface, picture = next(iter(reports.values())).surface, record.path("contact.png")
    plotting.along(surface, reports, save=picture, length="mm", stress="MPa", title="bar on a rigid base")
    stiff, soft = states[label(*STIFFNESS[0])], states[label(*STIFFNESS[2])]
    shown = {label(*STIFFNESS[0]): stiff, label(*STIFFNESS[2]): soft}
    plotting.deformed(
        shown, save=record.path("deformed.png"), unit="mm", title="bar pushed to the right and onto its base"
    )
    plotting.deformed(
        stiff, save=record.path("gap.png"), unit="mm", title="the separated end", scale=800, zoom=(9, 21, -0.8, 3)
    )
    for (lmbda, mu), expected, u_a in zip(STIFFNESS, COUNTS, U_A, strict=True):
        report = reports[label(lmbda, mu)]
        for name, count in zip(("separated", "sliding", "stick"), expected, strict=True):
            found = report.counts[name]
            record.check(f"{label(lmbda, mu)}: {name} nodes, {count} expected", found, low=count, high=count)
        error = abs(float(report.u_T[0, 0]) / u_a - 1)
        record.check(f"{label(lmbda, mu)}: relative error of u_T at A", error, high=1e-6)
        beyond = (np.linalg.norm(report.t_T, axis=1) - FRICTION * report.p).max() / report.p.max()
        record.check(f"{label(lmbda, mu)}: largest (|t_T| - f p) / p", beyond, high=1e-12)
        record.check(f"{label(lmbda, mu)}: equilibrium", report.equilibrium, high=1e-9)
        record.check(f"{label(lmbda, mu)}: Clapeyron", report.clapeyron, high=1e-9)
        near = max(abs(counts[N + 1, lmbda][name] - report.counts[name]) for name in report.counts)
        record.check(f"{label(lmbda, mu)}: counts on the next mesh move by", near, high=1)


def label(lmbda: float, mu: float) -> str:
    """Text for a stiffness."""
    return f"λ, μ = {lmbda:.3g}, {mu:.3g} N/mm³"


def draw(record: Record) -> None:
    """Draw figure 8 from table.csv."""
    table = record.load("table.csv")
    lines = {}
    for lmbda, mu in STIFFNESS:
        rows = table["lmbda"] == lmbda
        lines[label(lmbda, mu)] = (table["x_mm"][rows], table["u_T_mm"][rows])
    plotting.curves(
        lines,
        xlabel="x from A to B (mm)",
        ylabel="u_T (mm)",
        title="Figure 8: tangential displacement along AB",
        save=record.path("fig8.png"),
    )
