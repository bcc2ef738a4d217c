"""Tests of whether strains of bodies are small, as the theory takes them to be."""

from __future__ import annotations

import math
from collections.abc import Sequence

import ufl
from dolfinx import fem

from thinlayer.discretisation.layer import BODY
from thinlayer.discretisation.measures import compiled
from thinlayer.discretisation.state import State
from thinlayer.errors import warn

LARGEST_STRAIN = 0.1  # root mean square over a body, beyond which changes of shape are no longer small


def warn_of_strains(states: Sequence[State]) -> None:
    """Warn where strains of bodies that are not linear exceed `LARGEST_STRAIN`, once for all states. Collective.

    The root mean square over a body is tested, because at single places, such as corners, strains are large in any case.
    Linear bodies are not tested: their results are proportional to loads of any size.

    Args:
        states: of one model.
    """
    if not states:
        return
    model = states[0].model
    for term in (p for p in model.bodies if not p.law.traits.linear):
        u = fem.Function(model.V)
        e, one = term.strain(u), fem.Constant(model.domain.mesh, 1.0)
        squares = compiled(ufl.inner(e, e) * term.weight * term.measure)
        volume = model.comm.allreduce(fem.assemble_scalar(compiled(one * term.weight * term.measure)))
        found = []
        for state in states:
            u.x.array[:] = state.u.x.array
            whole = model.comm.allreduce(fem.assemble_scalar(squares))
            found.append(math.sqrt(whole / volume))
        beyond = [k for k, strain in enumerate(found) if strain > LARGEST_STRAIN]
        if not beyond:
            continue
        worst = max(beyond, key=found.__getitem__)
        name = term.key.removeprefix(f"{BODY} ")
        warn(
            f"at t = {states[worst].t:.4g} strains of {f'the body {name!r}' if name else 'the bodies'} are "
            f"{found[worst]:.3g} (root mean square over its volume), beyond {LARGEST_STRAIN:g} from "
            f"t = {states[beyond[0]].t:.4g} on: the theory is for small strains; what yields there flows at loads that it "
            "cannot bear: do not use these states, and take smaller loads or motions of supports; or check the units of "
            "the moduli",
            model.comm,
        )
