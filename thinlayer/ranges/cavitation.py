"""Tension that tears rubber from inside: its law is elastic at any mean stress."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI

from thinlayer.discretisation.layer import real_law
from thinlayer.discretisation.seams import SeamLayer
from thinlayer.discretisation.state import State
from thinlayer.errors import warn

CAVITATION = 2.5  # mean stress over the shear modulus at which small holes in rubber grow (Gent and Lindley 1959)


def tension(one: SeamLayer, state: State) -> float:
    """Largest pressure p (tension > 0) of a layer over its shear modulus, at the vertices of S. Collective.

    0 if it has no pressure, or none that pulls.
    """
    p = state.fields.get(one.pressure_key)
    if p is None:
        return 0.0
    law, own = real_law(one.layer, one.structure.kinematics), p.function_space.dofmap.index_map.size_local
    x = p.function_space.tabulate_dof_coordinates()[:own, : one.structure.joint.dim]
    mu = law.fields_at(x.T).get("mu", law.parameters()["mu"])
    return float(state.model.comm.allreduce((p.x.array[:own] / mu).max(initial=0.0), MPI.MAX))


def warn_of_cavitation(one: SeamLayer, states: Sequence[State]) -> None:
    """Warn if a layer of rubber is pulled so much that it would cavitate, once for all states. Collective."""
    found = [tension(one, state) for state in states]
    worst = int(np.argmax(found))
    if found[worst] > CAVITATION:
        warn(
            f"at t = {states[worst].t:.4g} the pressure of {one} is a tension of {found[worst]:.3g} times its shear "
            f"modulus: from about {CAVITATION:g} times on small holes in rubber grow and tear it (cavitation), which its "
            "law does not contain; do not use results under such loads",
            states[worst].model.comm,
        )
