"""The paper's bar and two stacked blocks in contact: models, laws and reports for tests of contact."""

from __future__ import annotations

from forms import HolonomicCoulomb, LinearElastic
from geometry import sandwich
from studies.problems import sliding_bar
from thinlayer import Structure, Surface, solve

SOLVERS = ("condensed", "multigrid", "newton")
STIFFNESS = {"stiff": (15e8, 5e8), "middle": (15e4, 5e4), "soft": (15.0, 5.0)}


def contact(state, seam="S"):
    return Surface(state.model, seam).contact(state)


def solved(joint, law, setup, **choices):
    return contact(solve(Structure(joint, **setup).interface(law), **choices))


def bar(n, law, **choices):
    joint, setup = sliding_bar(n)
    return solved(joint, law, setup, **choices)


def coulomb(name, friction=1.0):
    return HolonomicCoulomb.of_layer(*STIFFNESS[name], friction=friction)


def lift(x, _):
    """Pulls at the left, presses at the right."""
    return 0.0, 6 - 6 * x[0]


def stacked(cell="quadrilateral"):
    """Two bodies of different stiffness, the upper one pushed onto the lower and to the right."""
    joint = sandwich(6, 3, 2, 0.5, cell=cell, structured=True)
    bodies = {"LOWER": LinearElastic.young(5e3, 0.3), "UPPER": LinearElastic.young(9e3, 0.2)}
    supports, loads = {"BOTTOM": 0.0, "RIGHT/UPPER": {"x": 0.0}}, {"LEFT/UPPER": (60.0, 0.0), "TOP": lift}
    element = "Q1" if cell == "quadrilateral" else "P1"
    return joint, {"body": bodies, "supports": supports, "tractions": loads, "element": element}
