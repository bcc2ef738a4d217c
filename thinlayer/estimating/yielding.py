"""States of layers that yield, of which no estimate is known."""

from __future__ import annotations

import numpy as np

from thinlayer.discretisation.free_rim import free_rim
from thinlayer.discretisation.state import State
from thinlayer.estimating.places import NEAR_ENDS, distance_to
from thinlayer.output.layer_report import ELASTIC, LayerReport


def why_not(state: State) -> str:
    """Why the errors of the layers' laws cannot be told from a state of the better laws; "": they can. Collective.

    At a free end a layer that yields redistributes what the laws on S do not see; estimates there were found to be four
    times too low.
    """
    for name, one in state.model.layers.items():
        if not one.law.traits.bounded:
            continue
        assert one.thin
        report = LayerReport(state, name)
        yields = report.status != ELASTIC
        if not yields.any():
            continue
        if not one.law.traits.symmetric:
            return f"{one} slides or yields with a dilatancy unlike its friction: no estimate is known"
        joint, rim = state.model.joint, free_rim(state.model, one.sheet)
        centres = joint.points[joint.table.vertices[report.rows[yields]]].mean(axis=1)
        if np.any(distance_to(joint, rim, centres) < NEAR_ENDS * one.thin.eps):
            return f"{one} yields at its free ends: no estimate (found up to 4 times too low)"
    return ""
