"""Contact with stiffer and stiffer interfaces: the error to Signorini's and Coulomb's laws is O(1/K); Newton steps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from forms import HolonomicCoulomb
from studies.problems import sliding_bar
from thinlayer import Structure, Surface, Table, observed_orders, plotting, solve
from thinlayer.files.progress import track
from thinlayer.output.contact_fields import Contact
from thinlayer.running.record import Record

STIFFNESS = (5.0, 5e2, 5e4, 5e6, 5e8)  # K_T, N/mm^3; K_N is five times as much
LIMIT = 5e12
FRICTION = (0.3, 1.0, 2.0)


def run(record: Record, *, quick: bool = False) -> None:
    """Follow the error to the limit on one mesh, then count Newton steps over stiffness, friction and mesh.

    Args:
        record: where to write.
        quick: coarser meshes.
    """
    n = 31 if quick else 63
    meshes = (32, 64) if quick else (32, 64, 128, 256, 512, 724)
    record.parameters = {"squares": n, "K_T_per_mm": STIFFNESS, "friction": FRICTION, "meshes": meshes}
    reports = {K: solved(record, n, K, 1.0)[0] for K in (*STIFFNESS, LIMIT)}
    table = _errors(reports)
    record.write("table.csv", table)
    record.say(table)
    steps = Table()
    cases = [(m, f, K) for m in meshes for f in FRICTION for K in STIFFNESS]
    for m, f, K in track(cases, "signorini_limit", "{}"):
        report, iterations = solved(record, m, K, f)
        row = {"squares": m, "friction": f, "K_T": K, "newton_steps": iterations}
        steps.append(row | report.counts | {"equilibrium": report.equilibrium})
    record.write("newton_steps.csv", steps)
    shown = {f"K_T = {K:g} N/mm³": reports[K] for K in STIFFNESS[::2]}
    plotting.along(
        reports[LIMIT].surface,
        shown,
        save=record.path("contact.png"),
        length="mm",
        stress="MPa",
        title="stiffer and stiffer contact",
    )
    _check(record, table, steps, meshes)


def solved(record: Record, n: int, K: float, friction: float) -> tuple[Contact, int]:
    """Contact and Newton steps of the bar."""
    joint, setup = sliding_bar(n)
    model = Structure(joint, **setup).interface(HolonomicCoulomb(5 * K, K, friction))
    state = record.solved(solve(model))
    return Surface(state.model).contact(state), state.report.iterations


def _errors(reports: dict[float, Contact]) -> Table:
    """Differences to the stiffest of all, L2 on S over its own norm."""
    limit = reports[LIMIT]
    table = Table()
    values = []
    for K in STIFFNESS:
        report = reports[K]
        weights = limit.areas
        jump = np.hstack([report.u_T - limit.u_T, (report.u_N - limit.u_N)[:, None]])
        size = np.sqrt(weights @ (np.hstack([limit.u_T, limit.u_N[:, None]]) ** 2).sum(axis=1))
        traction = np.hstack([report.t_T - limit.t_T, (report.p - limit.p)[:, None]])
        force = np.sqrt(weights @ (np.hstack([limit.t_T, limit.p[:, None]]) ** 2).sum(axis=1))
        errors = [np.sqrt(weights @ (d**2).sum(axis=1)) / s for d, s in ((jump, size), (traction, force))]
        values.append([K, *map(float, errors)])
    columns = np.array(values).T
    orders = [observed_orders(1 / columns[0], errors) for errors in columns[1:]]
    for k, (K, jump_error, traction_error) in enumerate(values):
        row = {"K_T": K, "error_jump": jump_error, "error_traction": traction_error}
        table.append(row | {"order_jump": orders[0][k], "order_traction": orders[1][k]})
    return table


def _check(record: Record, table: Table, steps: Table, meshes: Sequence[int]) -> None:
    for name in ("jump", "traction"):
        record.check(f"last observed order in 1/K, {name}", table[f"order_{name}"][-1], low=0.9, high=1.1)
    most = {m: float(steps["newton_steps"][steps["squares"] == m].max()) for m in meshes}
    record.results["most_newton_steps"] = {str(m): int(k) for m, k in most.items()}
    record.say(f"most Newton steps by squares: {record.results['most_newton_steps']}")
    coarse, fine = most[meshes[0]], most[meshes[-1]]
    record.check(f"most Newton steps, {meshes[-1]} squares against {meshes[0]}: more by", fine - coarse, high=2)
    record.check("largest equilibrium error", float(steps["equilibrium"].max()), high=1e-9)


def draw(record: Record) -> None:
    """Draw the errors from table.csv."""
    table = record.load("table.csv")
    K = table["K_T"]
    lines = {name: (K, table[f"error_{name}"]) for name in ("jump", "traction")}
    lines["slope -1"] = (K[1:], 0.3 * table["error_jump"][-1] * K[-1] / K[1:])
    plotting.curves(
        lines,
        xlabel="K_T (N/mm³), K_N = 5 K_T",
        ylabel="relative difference to the limit, L2 on S",
        title="Signorini's and Coulomb's laws as K grows",
        styles={"slope -1": "--", "jump": "o-", "traction": "s-"},
        logarithmic=True,
        save=record.path("limit.png"),
    )
