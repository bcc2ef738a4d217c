"""Quantities that studies measure in every state of a march, with forms that are compiled once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from forms.work import work
from thinlayer import Model, State, Surface
from thinlayer.discretisation.supports import Place

Array = npt.NDArray[np.float64]


def one(x: Array) -> Array:
    """1 at places (3, n)."""
    return np.ones(x.shape[1])


def along_S(surface: Surface, state: State) -> tuple[Array, Array, Array]:
    """Places (n, d) at the vertices of S, jumps and tractions (n, d) there in the frame of S, projected. Collective."""
    x, u = surface.profile(surface.frame(surface.jump(state)))
    return x, u, surface.profile(surface.frame(surface.traction(state)))[1]


class SupportForce:
    """Force of a moving support on elastic bodies without other loads there, in 2D per depth.

    Where the support moves by shape(x) delta it is the force conjugate to delta: its work is the integral over delta.

    Args:
        model: the model.
        place: of the support, which holds or moves nothing but nodes of the bodies.
        axis: component, "x", "y" or "z".
        shape: numpy function of places (3, n) that returns n numbers (default: 1).
    """

    def __init__(self, model: Model, place: Place, axis: str, shape: Callable[[Array], Array] = one) -> None:
        self._u, everywhere, moved = (fem.Function(model.V) for _ in range(3))
        everywhere.interpolate(lambda x: np.tile(shape(x), (model.joint.dim, 1)))
        support = model.supports.dofs(model.V, place, axis)
        moved.x.array[support] = everywhere.x.array[support]
        self._work = fem.form(work(model.bodies, self._u, moved))

    def __call__(self, state: State) -> float:
        """The force in a state of the model. Collective."""
        self._u.x.array[:] = state.u.x.array
        return float(state.model.comm.allreduce(fem.assemble_scalar(self._work)))


class MeanJump:
    """Mean over S of a component of the jump in the frame of S, of states of either model on the surface's joint.

    Args:
        surface: S.
        component: tangential ones first, the normal one last.
    """

    def __init__(self, surface: Surface, component: int = -1) -> None:
        self._surface, self._component = surface, component

    def __call__(self, state: State) -> float:
        """The mean in a state. Collective."""
        surface = self._surface
        jump = surface.frame(surface.jump(state))[self._component]
        return float(surface.integral(jump) / surface.integral(1.0))


def phases_on_s(state: State) -> tuple[Array, Array]:
    """First coordinates (n,) of the facets of S, and the phase of the layer there."""
    surface = Surface(state.model)
    x, phase = surface.x[0].mean(axis=1), surface.phase(state)[:, 0]
    return np.sort(x), phase[np.argsort(x)]
