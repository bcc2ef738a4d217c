"""Contact laws that sweeps over nodes and the paper's relaxation are tested with, and the accuracy of one node."""

from __future__ import annotations

from forms.contact import HolonomicCoulomb, Tresca

EXACT = 1e-12  # relative: one node, a few operations; a threshold that grows steeply with the pressure multiplies it
LAWS = {
    "Coulomb": HolonomicCoulomb(3.0, 1.0, 0.4),
    "strong friction": HolonomicCoulomb(3.0, 1.0, 3.0),
    "no friction": HolonomicCoulomb(3.0, 1.0, 0.0),
    "cohesion": HolonomicCoulomb(3.0, 1.0, 0.4, 2.0),
    "Tresca": Tresca(3.0, 1.0, 2.0),
}
