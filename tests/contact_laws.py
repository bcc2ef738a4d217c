"""Contact laws that sweeps over nodes and the paper's relaxation are tested with, and the accuracy of one node."""

from __future__ import annotations

from forms.contact import HolonomicCoulomb, Tresca

EXACT = 1e-12  # relative: one node, a few operations; a threshold that grows steeply with the pressure multiplies it
FRICTION = {"Coulomb": (0.4,), "strong friction": (3.0,), "no friction": (0.0,), "cohesion": (0.4, 2.0)}
LAWS = {name: HolonomicCoulomb(3.0, 1.0, *parameters) for name, parameters in FRICTION.items()}
LAWS["Tresca"] = Tresca(3.0, 1.0, 2.0)
