"""Limits of the elastic interface law: bonded bodies for growing stiffness, sliding without tangential stiffness."""

from __future__ import annotations

import numpy as np

from forms import Anisotropic
from studies.problems import fourier
from thinlayer import Structure, Surface, ThinLayer, plotting, solve
from thinlayer.discretisation.state import State
from thinlayer.running.record import Record

KAPPAS = (1e4, 1e5, 1e6)
SLIDING_K_T = (1.0, 1e-2, 1e-4, 1e-6)
K_N = 100.0
BONDED_JUMP, BONDED_TRACTION = 0.5913, 28.589  # |[u]| kappa and |t - t_bonded| kappa as kappa -> infinity
SLIDING_JUMP, SLIDING_TRACTION = -5.45899860e-3, 0.574377539927  # amplitudes of [u_T] and t_N as K_T -> 0


def run(record: Record, *, quick: bool = False) -> None:
    """Solve two blocks with an elastic interface law that becomes stiff, and one that loses its tangential stiffness.

    In the first part both stiffnesses K_N = K_T = kappa grow, and results are compared with bonded bodies. In the
    second part K_T tends to zero at a fixed K_N, and results are compared with bodies that slide without friction.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: coarser mesh, and fewer stiffnesses.
    """
    joint, setup = fourier(1 / 16 if quick else 1 / 48, cell="quadrilateral")

    def solve_interface(k_n: float, k_t: float) -> tuple[State, Surface]:
        law = Anisotropic.springs(K_N=k_n, K_T=k_t)
        state = record.add_report(solve(Structure(joint, **setup).interface(ThinLayer(law, 1.0))))
        return state, Surface(state.model)

    bonded = record.add_report(solve(Structure(joint, **setup).bonded()))

    def stiff_row(kappa: float) -> dict[str, float]:
        state, surface = solve_interface(kappa, kappa)
        difference = surface.norm(surface.reaction(state) - surface.reaction(bonded))
        row = {"kappa": kappa, "jump_times_kappa": surface.norm(surface.jump(state)) * kappa}
        return row | {"traction_difference_times_kappa": difference * kappa}

    def sliding_row(k_t: float) -> dict[str, float]:
        """Solve with the tangential stiffness `k_t`, and return a row of sliding.csv.

        The row has `k_t` ("K_T") and the amplitudes on S of the tangential jump and traction and of the normal
        traction. They are "jump_T", "traction_T" (factors of sin(pi x)) and "traction_N" (of cos(pi x)).
        """
        state, surface = solve_interface(K_N, k_t)
        sine, cosine = 2 * np.sin(np.pi * surface.x[0]), 2 * np.cos(np.pi * surface.x[0])
        jump, traction = surface.frame(surface.jump(state)), surface.frame(surface.traction(state))
        integrands = {"jump_T": jump[0] * sine, "traction_T": traction[0] * sine, "traction_N": traction[1] * cosine}
        return {"K_T": k_t, **{name: surface.integral(integrand) for name, integrand in integrands.items()}}

    stiff = record.rows("table.csv", KAPPAS[:: 2 if quick else 1], stiff_row, "kappa = {:g}")
    soft = record.rows("sliding.csv", SLIDING_K_T[:: 3 if quick else 1], sliding_row, "K_T = {:g}")
    jump, difference = stiff["jump_times_kappa"][-1], stiff["traction_difference_times_kappa"][-1]
    record.check_near("|[u]| kappa at the largest kappa", jump, BONDED_JUMP, 2e-4)
    record.check_near("|t - t_bonded| kappa at the largest kappa", difference, BONDED_TRACTION, 2e-4)
    tolerance = 1e-4 if quick else 1e-5
    record.check_near("amplitude of [u_T] at the smallest K_T", soft["jump_T"][-1], SLIDING_JUMP, tolerance)
    record.check_near("amplitude of t_N at the smallest K_T", soft["traction_N"][-1], SLIDING_TRACTION, tolerance)


def draw(record: Record) -> None:
    """Draw how jump and traction of a stiff interface law approach those of bonded bodies, from table.csv.

    The table is in the folder of `record`; the picture is bonded.svg.
    """
    table = record.load("table.csv")
    kappa = table["kappa"]
    lines = {"|[u]| over the width": (kappa, table["jump_times_kappa"] / kappa)}
    lines["|t - t of bonded bodies| over E/100"] = kappa, table["traction_difference_times_kappa"] / kappa
    lines["slope -1"] = kappa, 5 / kappa
    title, labels = "a stiff interface law tends to bonded bodies", ("K_N = K_T over E/100 per width", "L^2 norm on S")
    options = {"title": title, "styles": ("o-", "s--", ":"), "log": "xy", "save": record.path("bonded.svg")}
    plotting.curves(lines, *labels, **options)
