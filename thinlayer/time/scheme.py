"""What laws ask of steps in time: where they must end, and where in them forces may balance."""

from __future__ import annotations

from collections.abc import Sequence

from thinlayer.discretisation.model import Model
from thinlayer.errors import ModelError
from thinlayer.solving.equations import Equations

ENDS = "theta = 1"


def remembers(model: Model) -> bool:
    """Whether the layer's law depends on what was before, so that a peak of the loads between two times matters."""
    law = model.layer_law
    return law is not None and (law.traits.rate or law.traits.remembers)


def require_ends(model: Model, theta: float) -> None:
    """Raise ModelError where theta < 1 and the state within a step says nothing of its ends, by what laws declare."""
    if theta == 1:
        return
    if model.contact:
        raise ModelError(f"theta is {theta}; contact laws hold at the ends of steps: {ENDS}")
    for body, law in model.body_laws.items():
        if not law.traits.linear:
            raise ModelError(f"theta is {theta}; {_swings(type(law).__name__)} (body {body!r})")
    for part in model.parts:
        if not part.is_linear(model):
            raise ModelError(f"theta is {theta}; {_swings(f'the part {part.key!r}')}")
    for law in (one for p in model.layer_terms for _, one in p.law.sublayers):
        name = type(law).__name__
        if law.traits.switches:
            raise ModelError(f"theta is {theta}; {name} holds at the ends of steps: {ENDS}")
        if law.traits.bounded:
            raise ModelError(
                f"theta is {theta}; {name} bounds stresses, and a stress that keeps its bound within a step may have "
                f"left it at the end, beyond what the layer bears: {ENDS}"
            )
        if not (law.traits.linear or law.traits.rate or law.traits.compiled):
            raise ModelError(f"theta is {theta}; {_swings(name)}")


def require_time_scale(equations: Equations, theta: float, times: Sequence[float]) -> None:
    """The same by asking laws without rate that are not linear, or not the same at all times: their answer must take time.

    Or be linear, and always the same. In a Stack each law must say so itself. Collective.

    Args:
        equations: of the model.
        theta: of the march.
        times: its start, and those that steps end at.
    """
    if theta == 1:
        return
    for part in equations.parts:
        if found := part.answers_at_once(times):
            name, changes = found
            how = "with parameters that change in time" if changes else "not linearly"
            raise ModelError(f"theta is {theta}; {_swings(name, how)}")


def _swings(name: str, how: str = "not linearly") -> str:
    return (
        f"{name} answers at once, and {how}: with an equilibrium within a step its ends swing about "
        f"the path, and nothing damps them: {ENDS}"
    )
