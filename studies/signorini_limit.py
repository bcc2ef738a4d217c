"""Contact with a layer of growing stiffness K: errors O(1/K) to Signorini's and Coulomb's laws, and Newton steps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from forms import HolonomicCoulomb
from studies.problems import sliding_bar
from thinlayer import Structure, Surface, Table, plotting, solve
from thinlayer.output.contact_fields import Contact
from thinlayer.running.record import Record

STIFFNESSES = (5.0, 5e2, 5e4, 5e6, 5e8)  # K_T, N/mm^3; K_N is five times as much
LIMIT_K = 5e12
FRICTION_COEFFS = (0.3, 1.0, 2.0)


def run(record: Record, *, quick: bool = False) -> None:
    """Measure how contact with a stiff layer tends to rigid contact, and count Newton steps.

    Errors are measured on one mesh. Steps are counted for several stiffnesses, friction coefficients and meshes.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: coarser meshes.
    """
    meshes = (32, 64) if quick else (32, 64, 128, 256, 512, 724)
    table = _error_table({K: solve_bar(record, 31 if quick else 63, K, 1.0)[0] for K in (*STIFFNESSES, LIMIT_K)})
    record.write("table.csv", table)

    def row(m: int, f: float, K: float) -> dict[str, float]:
        report, iterations = solve_bar(record, m, K, f)
        inputs = {"squares": m, "friction": f, "K_T": K, "newton_steps": iterations}
        return inputs | report.counts | {"equilibrium": report.equilibrium}

    cases = [(m, f, K) for m in meshes for f in FRICTION_COEFFS for K in STIFFNESSES]
    _check(record, table, record.rows("newton_steps.csv", cases, row), meshes)


def solve_bar(record: Record, n: int, K: float, friction: float) -> tuple[Contact, int]:
    """Solve the bar of Fig. 7, and return its contact results at the nodes of S and the number of Newton steps.

    Args:
        record: record of the run, which keeps the solver's report.
        n: number of cells along each side of the bar.
        K: tangential stiffness of the layer, N/mm^3; the normal stiffness is 5 K.
        friction: friction coefficient.
    """
    joint, setup = sliding_bar(n)
    state = record.add_report(solve(Structure(joint, **setup).interface(HolonomicCoulomb(5 * K, K, friction))))
    return Surface(state.model).contact(state), state.report.iterations


def _error_table(reports: dict[float, Contact]) -> Table:
    """Tabulate how much jump and traction for each stiffness differ from those for the largest stiffness, `LIMIT_K`.

    Differences are relative, in L2 norms on S; the table also has their observed rates of convergence in 1/K.

    Args:
        reports: tangential stiffness K of the layer -> contact results at the nodes of S.
    """
    limit = contact_fields(reports[LIMIT_K])

    def norm(field: np.ndarray) -> float:
        return float(np.sqrt(reports[LIMIT_K].areas @ (field**2).sum(axis=1)))

    columns = {"K_T": [*STIFFNESSES]}
    for name, limit_field in limit.items():
        by_stiffness = [contact_fields(reports[K])[name] for K in STIFFNESSES]
        columns[f"error_{name}"] = [norm(field - limit_field) / norm(limit_field) for field in by_stiffness]
    table = Table.of(columns | {"compliance": [1 / K for K in STIFFNESSES]})
    return Table.of(columns | {f"order_{name}": table.orders(f"error_{name}", of="compliance") for name in limit})


def contact_fields(report: Contact) -> dict[str, np.ndarray]:
    """Return "jump" and "traction" at the m nodes of S, arrays (m, 2), from contact results.

    Tangential components are first. The second ones are the normal jump and the contact pressure.
    """
    return {"jump": np.column_stack([report.u_T, report.u_N]), "traction": np.column_stack([report.t_T, report.p])}


def _check(record: Record, table: Table, steps: Table, meshes: Sequence[int]) -> None:
    for name in ("jump", "traction"):
        record.check(f"last observed order in 1/K, {name}", table[f"order_{name}"][-1], low=0.9, high=1.1)
    max_steps = {m: part["newton_steps"].max() for m, part in steps.split("squares").items()}
    coarse, fine = max_steps[meshes[0]], max_steps[meshes[-1]]
    record.check(f"most Newton steps, {meshes[-1]} squares against {meshes[0]}: more by", fine - coarse, high=2)
    record.check("largest equilibrium error", float(steps["equilibrium"].max()), high=1e-9)


def draw(record: Record) -> None:
    """Draw the differences of jump and traction from their limits over the stiffness, from table.csv.

    The table is in the folder of `record`; the picture is limit.svg.
    """
    table = record.load("table.csv")
    K = table["K_T"]
    lines = {name: (K, table[f"error_{name}"]) for name in ("jump", "traction")}
    lines["slope -1"] = (K[1:], 0.3 * table["error_jump"][-1] * K[-1] / K[1:])
    title, styles = "contact tends to Signorini's and Coulomb's laws as it stiffens", ("o-", "s--", ":")
    labels, save = ("K_T (N/mm³), K_N = 5 K_T", "relative difference to the limit, L^2 on S"), record.path("limit.svg")
    plotting.curves(lines, *labels, title=title, styles=styles, log="xy", save=save)
