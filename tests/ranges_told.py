"""What a solve or a march warns of, and the pressure in excess in a layer whose faces are moved."""

from __future__ import annotations

import re
import warnings

import numpy as np
from dolfinx import fem

from forms import LinearElastic
from tests.meshes import upper_cells
from thinlayer.discretisation.state import Report, State
from thinlayer.errors import RangeWarning
from thinlayer.surface.pressure_excess import pressure_excess, sublayer_moduli

STIFF = LinearElastic.young(1e5, 0.3)


def with_warnings(action):
    """What it returns, and its RangeWarnings, each as "key: message"."""
    with warnings.catch_warnings(record=True, action="always") as records:
        result = action()
    return result, [f"{w.message.key}: {w.message}" for w in records if issubclass(w.category, RangeWarning)]


def opened(model, upper):
    """A state whose upper body (y > 0, or all of it on a rigid base) is moved as told, the other one at rest."""
    u = fem.Function(model.V)
    cells = np.flatnonzero(model.domain.to_local(upper_cells(model.joint))).astype(np.int32)
    u.interpolate(lambda x: np.array(upper(x)), cells0=cells)
    u.x.scatter_forward()
    return State(u, 0.0, model=model, report=Report("none", 0, 0.0, 0.0))


def excess(model, upper):
    """Errors of the law's stiffness against openings, and of its traction, if the upper body is moved."""
    layer = model.layers["S"]
    return pressure_excess(opened(model, upper), layer, sublayer_moduli(layer))


def strip_excess(x):
    """Of a strip between rigid faces, x half-widths over the length of the pressure."""
    return 1 / (1 - np.tanh(x) / x) - 1


def times_too_stiff(message):
    """How many times the law is too stiff."""
    return float(re.search(r"([0-9.e+]+) times too stiff", message)[1])
