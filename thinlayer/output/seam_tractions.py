"""Tractions on seams that do not meet: the reactions of the bodies over the areas of S."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI

from forms.interface import Interface
from forms.kinematics import Expr
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.state import State, transfer
from thinlayer.output.other_side import OtherSide
from thinlayer.output.surface_mass import SurfaceMass, contact_forces, reaction

Mask = npt.NDArray[np.bool_]
NO_JUMP = 1e-12  # jump, relative to the largest displacement, that counts as zero


class SeamTractions:
    """Tractions on seams of an interface model, none of which meets another one; see `Surface.traction`. Collective.

    Args:
        model: an interface model.
        names: of the seams.
        sides: their two sides.
        V: vector functions of degree 1, broken across S.
        other: the other side of S; None on a rigid base.
    """

    def __init__(
        self,
        model: InterfaceModel,
        names: Sequence[str],
        sides: Interface,
        V: fem.FunctionSpace,
        other: OtherSide | None,
    ) -> None:
        self.model, self._names, self._sides, self._V, self._other = model, names, sides, V, other

    def recovered(self, state: State) -> Expr:
        """The traction in a state of either model, of this joint, (d,), an expression on S. Collective."""
        r = reaction(state)
        held, u = fem.Function(r.function_space), fem.Function(r.function_space)
        held.x.array[state.model.held_in(r.function_space)] = 1.0
        held.x.scatter_forward()
        u.interpolate(state.u)
        r, held, u = (transfer(f, state.model, self._V, self.model) for f in (r, held, u))
        unknown = self._take_from_other_side(r, held.x.array > 0)
        if state.model.contact:
            by_law = transfer(contact_forces(state), state.model, self._V, self.model)
            r.x.array[unknown] = by_law.x.array[unknown]
        zero = self._zero_tractions(unknown & ~self._jumps(u))
        axis = self.model.supports.axis(self._V)
        zero[axis] = unknown[axis]
        if not state.model.contact and self.model.comm.allreduce(int((unknown & ~zero).any())):
            self._mass.extrapolate(r, unknown, unknown & ~zero)
        t = self._mass.divide_by_areas(r) if self.model.contact else self._mass.divide(r, zero)
        if self._other is None:
            return -self._sides.upper(t)
        return (self._sides.lower(t) - self._sides.upper(t)) / 2

    def _take_from_other_side(self, r: fem.Function, held: Mask) -> Mask:
        """Replace nodal forces at held components by minus those of the other side; return where both sides are held.

        At a node where S ends inside the bodies both sides have the same displacement; nothing is replaced there.
        """
        if self._other is None:
            return held
        there = fem.Function(self._V)
        there.x.array[:] = held
        unknown = held & (self._other.of(there) > 0.5)
        replaced = held & ~unknown & self._other.areas.astype(bool)
        r.x.array[replaced] = -self._other.of(r)[replaced]
        return unknown

    def _zero_tractions(self, together: Mask) -> Mask:
        """The components whose traction is zero, among those in which supports hold the bodies together."""
        if not self.model.comm.allreduce(int(together.any())):
            return together
        along, whole = self._zero
        nodes = together.reshape(-1, len(along))
        return np.asarray((nodes & (along | (whole & nodes.all(axis=1, keepdims=True)))).ravel())

    @cached_property
    def _zero(self) -> tuple[Mask, bool]:
        """See `SeamLayer.zero_tractions`; of all seams."""
        moving = bool(self.model.supports.functions)
        found = [self.model.layers[name].zero_tractions(moving) for name in self._names]
        return np.all([along for along, _ in found], axis=0), all(whole for _, whole in found)

    def _jumps(self, u: fem.Function) -> Mask:
        """Where a function of the trace space differs from side to side (on a rigid base: from zero)."""
        largest = self.model.comm.allreduce(float(np.abs(u.x.array).max(initial=0.0)), MPI.MAX)
        other = 0.0 if self._other is None else self._other.of(u)
        return np.asarray(np.abs(u.x.array - other) > NO_JUMP * largest)

    @cached_property
    def _mass(self) -> SurfaceMass:
        """Mass matrix of the sides of S that are bodies: on a rigid base the upper one, else both."""
        bodies = (self._sides.upper,) if self._other is None else (self._sides.upper, self._sides.lower)
        u, v = ufl.TrialFunction(self._V), ufl.TestFunction(self._V)
        form = sum(ufl.inner(side(u), side(v)) for side in bodies) * self._sides.factor * self._sides.measure
        return SurfaceMass(self.model, self._V, form)
