"""The paper's relaxation method (SOR): its number of sweeps for factors omega, meshes and stiffnesses of the layer."""

from __future__ import annotations

import math

import numpy as np

from forms import HolonomicCoulomb
from studies.fig8_friction import MODULI, stiffness_label
from studies.problems import sliding_bar
from studies.sweeping import Curves
from thinlayer import SolveError, Structure, Table, plotting, solve
from thinlayer.running.record import Record

OMEGAS = (0.8, 1.0, 1.2, 1.4, 1.6, 1.7, 1.8, 1.85, 1.9, 1.93, 1.95)
INCREMENT_RTOL = 1e-8  # largest relative increment of a converged relaxation
MAX_SWEEPS = 30_000
EXPECTED_SWEEPS = {  # sweeps of an independent code on the same meshes: (squares, lmbda, omega)
    (8, 15e8, 1.0): 605, (8, 15e4, 1.8): 90, (8, 15.0, 1.9): 621,
    (16, 15e8, 1.8): 320, (16, 15e4, 1.6): 515, (16, 15.0, 1.95): 1385,
    (32, 15e8, 1.9): 584, (32, 15e4, 1.9): 581, (32, 15.0, 1.9): 6946,
}  # fmt: skip


def run(record: Record, *, quick: bool = False) -> None:
    """Count sweeps of relaxation (SOR) with the factor omega = 1 at contact nodes, then with one omega at all nodes.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: two coarse meshes.
    """
    meshes = (8, 16) if quick else (8, 16, 32)
    cases = [(n, pair, omega, same) for same in (False, True) for n in meshes for pair in MODULI for omega in OMEGAS]
    cases = [case for case in cases if not case[-1] or (case[0] == 16 and case[2] != 1.0)]

    def row(n: int, pair: tuple[float, float], omega: float, same_omega: bool) -> dict[str, float]:
        omega_contact = omega if same_omega else 1.0
        sweeps, converged = count_sweeps(n, *pair, omega, omega_contact)
        inputs = {"squares": n, "lmbda": pair[0], "mu": pair[1], "omega": omega, "omega_contact": omega_contact}
        return inputs | {"sweeps": sweeps, "converged": int(converged)}

    check(record, record.rows("table.csv", cases, row))


def count_sweeps(n: int, lmbda: float, mu: float, omega: float, omega_contact: float) -> tuple[int, bool]:
    """Solve the bar of Fig. 7 by relaxation, and count its sweeps.

    Args:
        n: number of cells along each side of the bar.
        lmbda, mu: Lamé's moduli of the layer over its thickness, N/mm^3.
        omega: factor of the relaxation at all nodes but those in contact.
        omega_contact: its factor at contact nodes.

    Returns:
        The number of sweeps until the relaxation converges or fails, and whether it has converged.
    """
    joint, setup = sliding_bar(n, arrangement="AlternateLeft")
    options = {"omega": omega, "omega_contact": omega_contact, "tolerance": INCREMENT_RTOL, "max_sweeps": MAX_SWEEPS}
    model = Structure(joint, **setup).interface(HolonomicCoulomb.of_layer(lmbda, mu, friction=1.0))
    try:
        state = solve(model, method="relaxation", options={f"relaxation_{k}": v for k, v in options.items()})
    except SolveError as error:
        return len(error.residuals), False
    return state.report.iterations, True


def check(record: Record, table: Table) -> None:
    """Check numbers of sweeps against an independent code, and that one omega > 1 at all nodes fails in some cases.

    The least number of sweeps over omega must grow with the cells along a side to a power of at most 1.5.

    Args:
        record: record of the run, which receives the checks.
        table: a row for each mesh, stiffness and omega, with the columns of table.csv.
    """
    is_unit_contact = table["omega_contact"] == 1.0
    for (n, lmbda, omega), expected in EXPECTED_SWEEPS.items():
        is_case = is_unit_contact & (table["squares"] == n) & (table["lmbda"] == lmbda) & (table["omega"] == omega)
        if is_case.any():
            ratio, what = table["sweeps"][is_case][0] / expected, f"sweeps / {expected}, n = {n}, lmbda = {lmbda:g}"
            record.check(f"{what}, omega = {omega}", ratio, low=0.9, high=1.1)
    is_same = (table["omega"] == table["omega_contact"]) & (table["omega"] > 1)
    failed_sweeps = table["sweeps"][is_same & (table["converged"] == 0)]
    record.check("one omega everywhere: cases that fail", len(failed_sweeps), low=1)
    record.check("one omega everywhere: sweeps until a failure is found", failed_sweeps.max(initial=0), high=MAX_SWEEPS)
    is_stiff = is_unit_contact & (table["lmbda"] == MODULI[0][0]) & (table["converged"] == 1)
    least_sweeps = {n: table["sweeps"][is_stiff & (table["squares"] == n)].min() for n in np.unique(table["squares"])}
    sizes = sorted(least_sweeps)
    exponent = math.log(least_sweeps[sizes[-1]] / least_sweeps[sizes[0]]) / math.log(sizes[-1] / sizes[0])
    record.check("growth of the least number of sweeps with the squares, exponent", exponent, high=1.5)


def draw(record: Record) -> None:
    """Draw the number of sweeps over the factor omega, from table.csv in the folder of `record`."""
    panels = dict[str, Curves]()
    for lmbda, part in record.load("table.csv").split("omega_contact")[1].split("lmbda").items():
        for n, rows in part.split("squares").items():
            sweeps = np.where(rows["converged"] == 1, rows["sweeps"], np.nan)
            panels.setdefault(stiffness_label(lmbda), {})[f"{n:.0f} squares"] = rows["omega"], sweeps
    options = {"title": f"sweeps of relaxation; none: above {MAX_SWEEPS:,}", "save": record.path("sweeps.svg")}
    plotting.curves(panels, "omega (1 at the contact nodes)", "sweeps", styles=("o-", "s--", "^:"), log="y", **options)
