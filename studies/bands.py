"""Rows of the study `rates` that compare meshed frictional layers without cohesion with Coulomb contact on S."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from forms import HolonomicCoulomb, IncrementalCoulomb, MohrCoulombMonodirectional
from forms.base import Array
from studies.problems import LoadPath
from studies.sweeping import Tables, end_state
from thinlayer import Surface
from thinlayer.discretisation.state import State
from thinlayer.running.record import Record
from thinlayer.solving.history import Solution

MODULI = (60.0, 40.0)  # lmbda, mu
FRICTION_ANGLE = 25.0
FRICTION = math.tan(math.radians(FRICTION_ANGLE))
# One cell through the band needs no elastic fraction: its nodes belong to the bodies, which support it where it is
# open. Inner nodes need an elastic fraction; the error is proportional to it and does not vanish with eps.
BAND_LAW = MohrCoulombMonodirectional(*MODULI, cohesion=0.0, friction_angle=FRICTION_ANGLE, unilateral=True)
REGULARIZED_LAW = replace(BAND_LAW, elastic_fraction=1e-5)
HOLONOMIC = HolonomicCoulomb.of_layer(*MODULI, friction=FRICTION)
INCREMENTAL = IncrementalCoulomb.of_layer(*MODULI, friction=FRICTION)
SINE_LAW = replace(HOLONOMIC, friction=math.sin(math.radians(FRICTION_ANGLE)))  # a wrong law
DIRECT_PATH: LoadPath = {0: (0.28, 1.0, 1.5), 1: (0.28, 1.0, 1.5)}
RETURN_PATH: LoadPath = {0: (0.0, 0.0, 0.0), 1: (0.28, 1.0, 0.0), 2: (0.28, 1.0, 1.5), 3: (0.28, 0.0, -1.0)}
ZERO_PRESSURE_SHARE = 1e-3  # pressure, relative to the largest one, below which a node counts as separated
SLIDING_TOLERANCE = 1e-2  # relative distance from the threshold at which a node counts as sliding


def tractions_along(state: State, surface: Surface) -> dict[str, Array]:
    """Return the tractions of a state at the nodes of S, as columns for a table and a picture.

    Args:
        state: a state of the full or the interface model.
        surface: the surface S.

    Returns:
        "x" (coordinate along S), "pressure" and "shear traction over E/100" -> values (m,) at the m nodes of S.
    """
    x, t = surface.profile(surface.frame(surface.traction(state)))
    return {"x": x[:, 0], "pressure": -t[:, 1], "shear traction over E/100": t[:, 0]}


def zone_lengths(full: Solution, limit: Solution) -> dict[str, float]:
    """Measure the length of S that is separated and the length that slides, in both models, from nodal tractions.

    Args:
        full: solution with the meshed layer ("band").
        limit: solution with the contact law ("contact").

    Returns:
        "separated_band", "sliding_band", "separated_contact", "sliding_contact" -> length; S is 2 long.
    """
    surface, row = Surface(end_state(limit).model), dict[str, float]()
    for name, solution in (("band", full), ("contact", limit)):
        x, p, shear = tractions_along(end_state(solution), surface).values()
        lengths = np.diff(np.concatenate([x[:1], (x[1:] + x[:-1]) / 2, x[-1:]]))
        is_separated = p <= ZERO_PRESSURE_SHARE * p.max()
        is_sliding = ~is_separated & (abs(shear) >= (1 - SLIDING_TOLERANCE) * FRICTION * p)
        row |= {f"separated_{name}": float(lengths @ is_separated), f"sliding_{name}": float(lengths @ is_sliding)}
    return row


def check_zones(record: Record, tables: Tables) -> None:
    """Check that S has a sticking, a sliding and a separated zone, nearly as long in the layer as under contact.

    The lengths are those of the thinnest layer. They may differ from those of contact by two cells and the thickness.

    Args:
        record: record of the run, which receives the checks.
        tables: name of a `Sweep` of the study `rates` -> its table, with a line for each thickness.
    """
    for name in ("friction", "friction history"):
        table, h = tables[name], record.parameters[name]["h"]
        lengths = {zone: table[f"{zone}_contact"][-1] for zone in ("separated", "sliding")}
        for zone, length in {**lengths, "stick": 2.0 - sum(lengths.values())}.items():
            record.check(f"length of S, {name}: {zone}", length, low=0.2)
        for zone, length in lengths.items():
            difference, allowed = abs(table[f"{zone}_band"][-1] - length), 2 * h + table["eps"][-1]
            record.check(f"{zone} zone, {name}: thinnest band and contact differ by", difference, high=allowed)


def check_sine_error(record: Record, tables: Tables) -> None:
    """Check that contact with the friction coefficient sin(Omega) errs at least twice as much as with tan(Omega).

    The error is that of the jump for the thinnest layer, whose friction angle is Omega. This layer slips only along S.
    A layer of the law `MohrCoulomb` under lasting shear would have the friction coefficient sin(Omega).

    Args:
        record: record of the run, which receives the check.
        tables: name of a `Sweep` of the study `rates` -> its table, with a line for each thickness.
    """
    sine, tangent = (tables[name]["error_jump"][-1] for name in ("friction sine", "friction"))
    record.check("friction sin(Omega) on S: last error of the jump over that with tan(Omega)", sine / tangent, low=2)
