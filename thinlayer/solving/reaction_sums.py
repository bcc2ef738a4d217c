"""Forces and moments by which supports, plates and rigid bases hold a model, from the residual of a step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from geometry.seam import BASE
from thinlayer.discretisation.layer import BY_LAW, LAYER, PRESSURE
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.reactions import rigid_values
from thinlayer.parts.part import Interval, Part

Array = npt.NDArray[np.float64]


class ReactionSums:
    """Resultants of the forces of `Model.holders`. All methods are collective.

    Args:
        model: the model.
        parts: the parts of its balance.
    """

    def __init__(self, model: Model, parts: Sequence[Part]) -> None:
        self.model, self.parts = model, parts

    @cached_property
    def _motions(self) -> Array:
        return rigid_values(self.model.V, self.model.centre)

    def at_end(self, r: PETSc.Vec, interval: Interval, loads_at: Callable[[float], PETSc.Vec]) -> Array:
        """Forces and moments (n, k) at the end of a step, about `Model.centre`.

        They are linear in the forces of the step: what balances within it is the mean of the step's two ends.

        Args:
            r: nodal forces of the last evaluation of the parts, less loads.
            interval: the step.
            loads_at: nodal forces of the loads at a time, a vector to destroy.
        """
        theta, old = interval.theta, interval.old
        of_ties = self._of_ties(interval.t, old.t, theta)
        now = self._resultants(r, of_ties)
        if theta == 1:
            return now
        before = old.reactions
        if before is None:  # at rest there are no stresses
            loads = loads_at(old.t)
            loads.scale(-1.0)
            before = self._resultants(loads, self._of_ties(old.t, old.t, 1.0), layers=False)
            loads.destroy()
        return np.asarray((now - (1 - theta) * before) / theta)

    def _of_ties(self, new: float, old: float, theta: float) -> Array:
        """Given nodal forces of ties where forces balance, which are no reactions."""
        found = [share * self.model.constraints.loads_at(t) for t, share in ((new, theta), (old, 1 - theta)) if share]
        return np.asarray(sum(found))

    def _resultants(self, r: PETSc.Vec, of_ties: Array, *, layers: bool = True) -> Array:
        """Forces and moments for nodal forces r less loads; of layers on bases if asked for."""
        model, constraints = self.model, self.model.constraints
        by_supports = constraints.support_forces(r.array_r)
        rows = [constraints.of_supports(by_supports, self._motions)]
        if layers and model.joint.base_seams:  # on which laws may act beside meshed layers, which supports hold
            for number, (place, _) in enumerate(model.supports.entries):
                if place == BASE:
                    keys = {part.key for part in self.parts if part.key.endswith(f"/{BY_LAW}")}
                    rows[0][number] -= self._of_parts(keys, r)
        rest = constraints.passed_on(r.array_r) + of_ties - constraints.prescribed.conditions.T @ by_supports
        for tie in constraints.ties:
            tied = np.diff(tie.R.indptr) > 0
            rows.append((rest[tied] @ self._motions[tied])[None])
        first = len(model.supports.entries) + len(rows) - 1
        for name in model.holders[first:]:
            keys = self._keys_of(model.layers[str(name)].key) if layers else set()
            rows.append(-self._of_parts(keys, r)[None])
        return np.asarray(model.comm.allreduce(np.concatenate(rows)))

    def _of_parts(self, keys: set[str], like: PETSc.Vec) -> Array:
        """Force and moment (k,) on this rank of the layers' forces in the last evaluation that have one of these keys."""
        forces = like.duplicate()
        forces.set(0.0)
        for part in self.parts:
            if hasattr(part, "add_layer_forces"):
                part.add_layer_forces(keys, forces)
            elif part.key in keys:
                part.add_forces(forces)
        found = forces.array_r @ self._motions
        forces.destroy()
        return np.asarray(found)

    def _keys_of(self, key: str) -> set[str]:
        """Keys of the terms and parts of a layer, sublayers and pressure included."""
        pressure = PRESSURE + key.removeprefix(LAYER)
        alone = len(self.model.joint.seams) == 1
        keys = {key, pressure}
        for one in [*(part.key for part in self.parts), *(p.key for p in self.model.layer_terms)]:
            if one.startswith(f"{key}/") or (alone and one.startswith(f"{key} ")):
                keys.add(one)
        return keys
