"""Nodes whose slip direction has reversed since the last tangents."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from forms.contact import ContactLaw, Status
from thinlayer.discretisation.contact_nodes import Array

Sliding = tuple[npt.NDArray[np.int8], Array]  # status of nodes (n,), and their tangential jumps less slip (n, d - 1)


def sliding(law: ContactLaw, w: Array, slip: Array) -> Sliding:
    """Sliding state at jumps (n, d), for a later `turned`."""
    return law.status(w, slip), w[:, :-1] - slip


def turned(law: ContactLaw, w: Array, slip: Array, at: Sliding | None) -> Array:
    """Changes (n, d) of the jumps that make nodes stick whose slip direction has reversed since the last tangents.

    A sliding node has no stiffness of its own along its slip. If it should stick, Newton's method can move it to and fro
    for ever, and sweeps do not stop that.
    """
    out = np.zeros_like(w)
    if at is None:
        return out
    (status, old), (new_status, now) = at, sliding(law, w, slip)
    back = (status == Status.SLIDING) & (new_status == Status.SLIDING) & ((old * now).sum(axis=1) < 0)
    way = old[back] - now[back]
    part = -(now[back] * way).sum(axis=1) / (way**2).sum(axis=1)
    out[back, :-1] = part[:, None] * way
    return out
