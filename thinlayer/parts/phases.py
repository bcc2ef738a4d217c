"""Phases of non-monotone layers: which layers have some, and their shares in a state."""

from __future__ import annotations

import numpy as np

from forms.law import BulkLaw
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.pointwise.kernels import memory_slots


def seams_with_phases(model: Model) -> list[str]:
    """Names of the seams whose layers have phases."""
    return [name for name, one in model.layers.items() if one.thin and one.law.traits.phases]


def phase_slots(law: BulkLaw) -> list[tuple[float, int]]:
    """Fraction of the thickness, and index among the internal variables, of each phase of a law."""
    return [(a, k) for a, one, k in memory_slots(law, "phase") if one.traits.phases]


def phase_shares(state: State, seam: str) -> dict[str, float]:
    """Shares of the phases of a layer, in a state of either model. Collective.

    The phase is a number in [-1, 1]. -1, 0 and 1 are pure phases; others are the share of phase 1 (or -1) beside phase 0.

    Returns:
        "plus", "minus": shares of the layer (of its sublayers with phases) in phases 1 and -1; "boundary": thickness of
        phase 0 if the other phases lie above it, a length, the mean over S. For the bar of section 6.2 it is the
        position eps S of the phase boundary, Eq. (47).
    """
    layer, sums = state.model.layers[seam], np.zeros(3)
    assert layer.thin
    for key, quadrature in state.model.quadratures.items():
        for a, k in phase_slots(quadrature.term.law) if quadrature.term.key == layer.key else ():
            phase, weights = state.memory[key][:, k], a * quadrature.weights
            sums += [weights @ np.maximum(phase, 0), weights @ np.maximum(-phase, 0), weights.sum()]
    plus, minus, whole = map(float, state.model.comm.allreduce(sums))
    fraction = sum(a for a, one in layer.thin.law.sublayers if one.traits.phases)
    boundary = max(1 - (plus + minus) / whole, 0.0) * float(layer.thin.eps) * fraction
    return {"plus": plus / whole, "minus": minus / whole, "boundary": boundary}
