"""Response of an interface law at one point of S to prescribed jumps and tractions, without a mesh."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import ufl

from forms.base import Array, InputError, is_finite, is_number, require
from forms.kinematics import ScalarField
from forms.law import Law
from forms.law_tangents import depends_on_step_length, evaluate
from forms.temperature import finite_values
from forms.tensors import layer_frame, mandel_tensors
from thinlayer.errors import SolveError
from thinlayer.pointwise.material_point import COMPONENT_NAMES, MaterialPoint
from thinlayer.system.table import Table

PathStep = Mapping[str, float]  # name of a jump or a traction -> its prescribed value
StepLengths = float | Sequence[float]  # one for all steps, or one for each


@dataclass(frozen=True, eq=False)
class PointHistory:
    """Response of a law at one point of S over several steps; d: number of dimensions.

    Each array has one row for each step. Jumps and tractions have their components in the frame of S: first tangential,
    then normal ones.

    Attributes:
        n: (d,) unit normal of S.
        t: (steps,) time at the end of the step.
        jumps: (steps, d) jumps [u] at the end of the step. For laws of strains they are divided by the layer's
            thickness, [u]/eps.
        tractions: (steps, d) tractions after the fraction theta of the step, when forces balance.
        stress: (steps, 3, 3) stress at the same time, in the coordinates of n. It includes components along S, which do
            not act on S.
        memory: (steps, values) internal variables at the end of the step, in the law's order; tensors in Mandel's order
            11, 22, 33, sqrt2 12, sqrt2 13, sqrt2 23.
        energies: (steps, 3) energy stored at the end of the step, energy dissipated in it, and error of the time scheme
            in its energy balance. They are per area of S, or for laws of strains per volume of the layer; NaN if the
            law declares no energy.
        parts: (steps,) number of smaller steps into which the step was divided; 1 if it was not divided.
    """

    n: Array
    t: Array
    jumps: Array
    tractions: Array
    stress: Array
    memory: Array
    energies: Array
    parts: Array

    def __len__(self) -> int:
        return len(self.t)

    @property
    def table(self) -> Table:
        """Table with a row for each step: time, jumps, tractions and `energies`.

        Its columns are t, w_T, w_N, t_T, t_N, stored, dissipated and remainder. In 3D, w_T1, w_T2, t_T1 and t_T2
        replace w_T and t_T.
        """
        names = COMPONENT_NAMES[len(self.n)]
        columns = ["t", *(f"w_{c}" for c in names), *(f"t_{c}" for c in names), "stored", "dissipated", "remainder"]
        values = np.column_stack([self.t, self.jumps, self.tractions, self.energies])
        return Table.of(dict(zip(columns, values.T, strict=True)))


def drive(
    law: Law, steps: Sequence[PathStep], n: Sequence[float] = (0.0, 1.0), *, dt: StepLengths = (), theta: float = 1.0
) -> PointHistory:
    """Compute the response of an interface law of order 0, at one point of S, to prescribed jumps and tractions.

    The point starts from rest. For each component, a step prescribes either the jump w at its end or the traction t
    after the fraction theta of it. An example in 2D is `[{"w_T": 0.01, "t_N": -1.0}, ...]`, where N is the normal and T
    the tangential component. In 3D T1 and T2, the tangents of `Surface.frame`, replace T. A step that does not converge
    is halved repeatedly.

    Args:
        law: any law of a layer except contact and incompressible laws, also a Stack. For a law of strains the caller
            gives jumps divided by the layer's thickness, [u]/eps; jumps in the result are divided by it too.
        steps: for each step, the name of each component's jump or traction and its prescribed value.
        n: normal of S from the lower to the upper body, (2,) or (3,), of any length.
        dt: length of the steps in time, one number for all steps or one for each. 0: a sudden load, for which theta is
            1. It may be omitted for laws that do not depend on it.
        theta: fraction of a step after which tractions have their prescribed values, 1 (backward Euler) down to 1/2
            (midpoint rule). Use values below 1 only for laws that creep or relax. With other laws jumps at the ends of
            steps oscillate about the path, and `march` refuses such values.

    Raises:
        InputError: a step prescribes neither or both of jump and traction for a component. Or dt is missing and the law
            depends on it, or other input is out of range.
        SolveError: no jump has the prescribed traction, for instance beyond the law's strength. The attribute `history`
            of the error has the previous steps.

    Example:
        >>> from forms import MohrCoulomb
        >>> from thinlayer import drive
        >>> mortar = MohrCoulomb(lmbda=1200.0, mu=800.0, cohesion=0.3, friction_angle=30)
        >>> history = drive(mortar, [{"w_T": 0.0, "t_N": -1.0}, {"w_T": 0.01, "t_N": -1.0}])
        >>> print(history.tractions[-1].round(3))
        [ 0.741 -1.   ]
    """
    if not isinstance(law, Law) or law.traits.nodal or law.traits.constrained:
        raise InputError(f"law is {law!r}; allowed: laws that give a stress for a strain, or a TractionLaw")
    require(law.unknown != ScalarField.unknown, "law", law, "drive is for laws of a displacement")
    if name := next(iter(law.fields), "a parameter" if law.traits.varies else ""):
        raise InputError(f"{type(law).__name__}: {name} is a function of the place, or of time; a point needs numbers")
    require(isinstance(steps, Iterable), "steps", steps, "it must be a list of dictionaries")
    steps = list(steps)
    normal, axes = _normal_and_frame(n)
    law.check_dimension(len(normal))
    path = [_read_step(step, k, len(normal)) for k, step in enumerate(steps)]
    without_dt = isinstance(dt, tuple) and not dt
    lengths = _step_lengths(1.0 if without_dt else dt, len(path))
    require(path, "steps", steps, "a path needs at least one step")
    require(is_number(theta) and 0.5 <= theta <= 1, "theta", theta, "allowed: 0.5 to 1")
    if law.traits.switches and theta != 1:
        raise InputError(f"theta is {theta}; {type(law).__name__} holds at the ends of steps: theta = 1")
    if law.traits.rate and (lengths == 0).any():
        raise InputError(f"dt is 0 in step {np.argmin(lengths) + 1}; {type(law).__name__} lets no jump change at once")
    point = MaterialPoint(law.as_bulk_law(), normal, axes, float(theta))
    if without_dt and any(depends_on_step_length(sublayer) for _, sublayer in point.law.sublayers):
        raise InputError(f"dt is missing: {type(law).__name__} depends on the length of the steps in time")
    states, parts = [point.rest()], list[int]()

    def make_history() -> PointHistory:
        """Return the history of the steps made so far, without a row for the state before the first step."""
        t, w, traction, _, stress, memory, energies = (np.array(column)[1:] for column in zip(*states, strict=True))
        energies = energies if law.traits.has_energy else np.full_like(energies, np.nan)
        return PointHistory(normal, t, w, traction, mandel_tensors(stress), memory, energies, np.array(parts, int))

    for k, (is_w, values) in enumerate(path):
        try:
            state, n_parts = point.advance(states[-1], is_w, values, lengths[k])
        except SolveError as error:
            step_text = ", ".join(f"{name} = {value:g}" for name, value in steps[k].items())
            raise SolveError(f"step {k + 1} of {len(path)} ({step_text}): {error}", make_history()) from None
        states.append(state)
        parts.append(n_parts)
    return make_history()


def _normal_and_frame(n: Sequence[float]) -> tuple[Array, Array]:
    """Return the unit normal (d,) and the frame (3, d) of S, for a normal `n` (d,) of any length in d dimensions.

    The columns of the frame are the unit tangents, then the normal; in 2D the tangent is (n_2, -n_1).
    """
    if (normal := finite_values(n, (2,), (3,))) is None or not normal.any():
        raise InputError(f"the normal n is {n!r}; allowed: 2 or 3 numbers, not all zero")
    normal = normal / np.linalg.norm(normal)
    frame = evaluate(layer_frame(ufl.as_vector(np.pad(normal, (0, 3 - len(normal))).tolist())))
    if len(normal) == 2:
        return normal, frame[:, :2]
    tangents = frame[:, [0, 2]]
    tangents -= np.outer(normal, normal @ tangents)  # near n = -e_2 the frame is a half turn, not exactly tangential
    return normal, np.column_stack([tangents, normal])


def _read_step(step: PathStep, k: int, d: int) -> tuple[Array, Array]:
    """Check a step of `drive`, and return which jumps it prescribes and all its prescribed values.

    Args:
        step: name of a jump or traction -> its prescribed value.
        k: number of the step, from 0, for messages.
        d: number of dimensions.

    Returns:
        A mask (d,) of the components, True if the jump, False if the traction is prescribed. Then the values (d,).
    """
    names = COMPONENT_NAMES[d]
    allowed = ", ".join(f"w_{c} or t_{c}" for c in names)
    require(isinstance(step, Mapping), f"step {k + 1}", step, f"it must be a dictionary with {allowed}")
    for name, value in step.items():
        if name not in [f"{kind}_{c}" for kind in "wt" for c in names]:
            raise InputError(f"step {k + 1} has {name!r}; allowed in {d}D: {allowed}")
        require(is_finite(value), f"step {k + 1}: {name}", value, "it must be a finite number")
    for c in names:
        if (f"w_{c}" in step) == (f"t_{c}" in step):
            count_text = "both" if f"w_{c}" in step else "neither"
            raise InputError(f"step {k + 1} has {count_text} of w_{c} (jump) and t_{c} (traction); it must have one")
    is_w = np.array([f"w_{c}" in step for c in names])
    return is_w, np.array([step.get(f"w_{c}", step.get(f"t_{c}")) for c in names], float)


def _step_lengths(dt: StepLengths, count: int) -> Array:
    if (lengths := finite_values(dt, (), (count,))) is None or (lengths < 0).any():
        raise InputError(f"dt is {dt!r}; allowed: a number >= 0, or one for each of the {count} steps")
    return np.broadcast_to(lengths, count)
