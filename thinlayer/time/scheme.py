"""Requirements of laws on time steps: at breaks steps must end, and theta < 1 is not always allowed."""

from __future__ import annotations

from collections.abc import Sequence

from thinlayer.discretisation.model import Model
from thinlayer.errors import ModelError
from thinlayer.solving.equations import Equations

ALLOWED_THETA = "theta = 1"  # the last words of errors


def remembers(model: Model) -> bool:
    """Whether a law depends on its history, so that a peak of the loads between two times matters."""
    return model.bodies_remember or any(one.remembers for one in model.layers.values())


def require_ends(model: Model, theta: float) -> None:
    """Raise ModelError if theta < 1 and a law, by its traits, does not balance at the ends of steps then."""
    if theta == 1:
        return
    if model.contact:
        raise ModelError(f"theta is {theta}; contact laws hold at the ends of steps: {ALLOWED_THETA}")
    for part in model.parts:
        if not part.is_linear(model):
            raise ModelError(f"theta is {theta}; {_oscillates(f'the part {part.key!r}')}")
    of_layers = [(one, "") for p in model.layer_terms for _, one in p.law.sublayers]
    for law, place in [*((law, f" (body {body!r})") for body, law in model.body_laws.items()), *of_layers]:
        name = type(law).__name__
        if law.traits.switches:
            raise ModelError(f"theta is {theta}; {name} holds at the ends of steps: {ALLOWED_THETA}")
        if law.traits.bounded:
            raise ModelError(
                f"theta is {theta}; {name} bounds stresses: with theta < 1 they are kept within the bound at t + theta dt, "
                f"where forces balance, and may exceed it at the end of the step; allowed: {ALLOWED_THETA}{place}"
            )
        if not (law.traits.linear or law.traits.rate or law.traits.compiled):
            raise ModelError(f"theta is {theta}; {_oscillates(name)}{place}")


def require_time_scale(equations: Equations, theta: float, times: Sequence[float]) -> None:
    """Raise ModelError if theta < 1 and trials show a law that answers at once and not linearly. Collective.

    Laws without rate are tried if they are not linear or their parameters vary. A law in a Stack must declare its traits.

    Args:
        equations: the equations of the model.
        theta: theta of the march.
        times: start of the march, and the times at which steps end.
    """
    if theta == 1:
        return
    for part in equations.parts:
        if found := part.answers_at_once(times):
            name, changes = found
            how = "with parameters that change in time" if changes else "not linearly"
            raise ModelError(f"theta is {theta}; {_oscillates(name, how)}")


def _oscillates(name: str, how: str = "not linearly") -> str:
    return (
        f"{name} answers at once, and {how}: if forces balance within a step, states at the ends of steps "
        f"oscillate about the solution, and nothing damps them: {ALLOWED_THETA}"
    )
