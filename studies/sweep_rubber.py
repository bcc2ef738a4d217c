"""Rubbery layer, from soft to incompressible: errors of the law with a pressure on S beside those of orders 0 and 1."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence

import numpy as np

from forms import Incompressible, LinearElastic, Rubber
from studies.problems import fourier
from studies.sweeping import by_reaction, last_order
from thinlayer import Structure, ThinLayer, compare, plotting, solve
from thinlayer.errors import RangeWarning
from thinlayer.running.record import Record

NUS = (0.05, 0.15, 0.3, 0.4, 0.45, 0.48, 0.49, 0.499, 0.4999, 0.5)
RATES = (0.3, 0.45, 0.499, 0.5)
EPS = (1 / 8, 1 / 16, 1 / 32, 1 / 64)
PICTURED = 1 / 16
MU = 40.0  # shear modulus over thickness; that of the bodies is 38
LAWS = {"order_0": "elastic, order 0", "order_1": "elastic, order 1", "rubber": "with a pressure on S"}
NAMES = ("traction", "jump")


def run(record: Record, *, eps: Sequence[float] = EPS, quick: bool = False) -> None:
    """Compare the laws with a meshed layer that has a pressure: over Poisson's ratio, and over the thickness.

    Args:
        record: where to write.
        eps: thicknesses; the blocks are 0.5 high, mu is 40 eps.
        quick: coarser mesh, fewer Poisson's ratios.
    """
    h = 1 / 16 if quick else 1 / 32
    joint, setup = fourier(h, cell="quadrilateral")
    structure = Structure(joint, **setup)

    def errors_at(nu: float, e: float) -> dict[str, float | None]:
        full = record.solved(solve(structure.full(ThinLayer(_rubber(nu), e, at=1.0), cells_through=2)))
        row: dict[str, float | None] = {f"{one}_{name}": None for name in LAWS for one in NAMES}
        row["too_stiff"] = None  # order 0
        for name, layer in _layers(nu, e).items():
            with warnings.catch_warnings(action="ignore", category=RangeWarning):  # out of range, as the table shows
                limit = record.solved(solve(structure.interface(layer)))
                found = compare(full, limit)
            row |= {f"traction_{name}": by_reaction(full, limit)["error_reaction"], f"jump_{name}": found["error_jump"]}
            if name == "order_0":
                row["too_stiff"] = found["too_stiff"]
        return row

    ratios = NUS[::2] + NUS[-1:] if quick else NUS
    over_nu = record.rows("ratios.csv", ratios, lambda nu: {"nu": nu, **errors_at(nu, PICTURED)}, "nu = {:g}")
    nus = over_nu["nu"]
    for nu, told in zip(nus[nus < 0.5], over_nu["too_stiff"], strict=False):
        waves = (math.pi * PICTURED) ** 2 / 6 * nu / (1 - 2 * nu)  # (k delta)^2
        record.check_near(f"times order 0 is told to be too stiff, nu = {nu:g}", told, 1 + waves, 0.02)
    largest = max(over_nu["jump_rubber"])
    record.check("largest error of the jump over eps^2, all ratios", largest / PICTURED**2, high=0.86)

    cases = [(nu, e) for nu in RATES for e in eps]
    over_eps = record.rows("rates.csv", cases, lambda nu, e: {"nu": nu, "eps": e, **errors_at(nu, e)}, "nu, eps = {}")
    for nu, rows in over_eps.split("nu").items() if len(eps) > 1 else ():
        for quantity in NAMES:
            last = last_order(rows, f"{quantity}_rubber")
            record.check(f"last observed order of the {quantity}, nu = {nu:g}", last, low=1.9, high=2.3)


def _rubber(nu: float) -> Rubber | Incompressible:
    return Rubber.shear(MU, nu) if nu < 0.5 else Incompressible(MU)


def _layers(nu: float, eps: float) -> dict[str, ThinLayer]:
    layers = {"rubber": ThinLayer(_rubber(nu), eps, order=1, at=1.0)}
    if nu < 0.5:
        elastic = LinearElastic.shear(MU, nu)
        layers |= {f"order_{order}": ThinLayer(elastic, eps, order=order, at=1.0) for order in (0, 1)}
    return layers


def draw(record: Record) -> None:
    """Draw the errors over Poisson's ratio and over the thickness from the tables."""
    ratios, rates = record.load("ratios.csv"), record.load("rates.csv")
    ylabel, below = "relative difference of the jump on S, L2", ratios["nu"] < 0.5
    lines = {label: (0.5 - ratios["nu"][below], ratios[f"jump_{name}"][below]) for name, label in LAWS.items()}
    plotting.curves(
        lines,
        "1/2 - nu",
        ylabel,
        title=f"interface laws of a rubbery layer, eps = 1/{round(1 / PICTURED)}",
        styles=("o-", "^-", "s-"),
        logarithmic=True,
        save=record.path("ratios.png"),
    )
    lines = {f"nu = {nu:g}": (part["eps"], part["jump_rubber"]) for nu, part in rates.split("nu").items()}
    eps = np.unique(rates["eps"])
    lines["slope 2"] = (eps, 0.3 * eps**2)
    plotting.curves(
        lines,
        "layer thickness eps",
        ylabel,
        title="law with a pressure on S",
        styles=("o-", "^-", "s-", "D-", "--"),
        logarithmic=True,
        save=record.path("rates.png"),
    )
