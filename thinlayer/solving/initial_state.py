"""States from which structures with mass begin to move: given displacements and velocities, with accelerations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from forms.base import Array, InputError, require
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import Report, State
from thinlayer.errors import SolveError
from thinlayer.parts.inertia import InertiaPart
from thinlayer.parts.part import TimeStep
from thinlayer.solving.equations import Equations
from thinlayer.system.ranks import destroy

RATE_STEP_RATIO = 1e-6  # length, over that of the first step, of the step in which strain rates at the start are found
SLOPE_STEP_RATIO = 1e-3  # length, over that of the first step, of steps for derivatives of prescribed displacements
JUMP_TOLERANCE = 1e-6  # difference of displacements from prescribed ones, over the largest, that counts as rounding
MASS_TOLERANCE = 1e-14  # relative residual of accelerations


def initial_state(
    model: Model, u: fem.Function | None = None, velocity: fem.Function | None = None, t: float = 0.0
) -> State:
    """Return a state with given displacements and velocities, from which `march` follows the motion. Collective.

    Velocities at supports are those of the supports. The march finds the accelerations and reactions at its start.

    Args:
        model: a model with `Inertia` among its parts.
        u: displacements, a function in model.V; None: zero, or the state at rest.
        velocity: velocities, a function in model.V; None: those of `Inertia`.
        t: time of the state.

    Raises:
        InputError: the model has no mass; a function is not in model.V; displacements are given, and a law depends on
            its history, or has a pressure.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Inertia, Structure, ThinLayer, initial_state, march, modes
        >>> joint = sandwich(60, 2, 2, h=2, cell="quadrilateral")
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=5, nu=0.3)
        >>> mass = Inertia({"LOWER": 7.8e-9, "UPPER": 7.8e-9, "S": 1.2e-9})  # t/mm^3
        >>> beam = Structure(joint, body=steel, supports={"LEFT": 0}, parts=[mass])
        >>> model = beam.interface(ThinLayer(glue, eps=0.2, order=1))
        >>> start = initial_state(model, velocity=modes(model, 1).shapes[0].u)
        >>> march(start, [1e-5, 2e-5]).last
        State(InterfaceModel(Q2, 732 unknowns), t = 2e-05, linear, 1 iterations)
    """
    equations = Equations(model)
    part, state = inertia_part(equations), equations.rest_state(t)
    for name, f in (("u", u), ("velocity", velocity)):
        is_in_space = f is None or (isinstance(f, fem.Function) and f.function_space == model.V)
        require(is_in_space, f"initial_state: {name}", f, "give a function in model.V")
    if u is not None:
        history_parts = [p.key for p in equations.parts if (p.traits.remembers and p is not part) or p.field]
        if history_parts:
            text = f"initial_state: the part {history_parts[0]!r} has a memory or a pressure"
            raise InputError(f"{text}, which displacements do not determine; begin with the result of solve or march")
        state = replace(state, u=u.copy(), at_rest=False)
    if velocity is not None:
        state = replace(state, memory={**state.memory, part.key: {**part.rest(), "v": velocity.copy()}})
    equations.destroy()
    return state


def inertia_part(equations: Equations) -> InertiaPart:
    """Return the part of a model that has its mass; InputError if there is none."""
    parts = equations.of_kind(InertiaPart)
    if not parts:
        raise InputError("the model has no mass: Structure(parts=[Inertia(density=...)])")
    return parts[0]


def balanced_start(equations: Equations, state: State, dt: float) -> State:
    """Return a state with the accelerations and reactions with which forces balance under the loads of its time.

    Collective. Velocities at supports become those of the supports. Without this, the midpoint rule would let reactions
    and accelerations alternate for ever.

    Args:
        equations: equations of a model with mass.
        state: the state, at rest or not.
        dt: length of the first step of the march.

    Raises:
        InputError: prescribed displacements differ from those of the state.
        SolveError: parts without mass are not in equilibrium.
    """
    part, constraints, t, x = inertia_part(equations), equations.constraints, state.t, equations.create_vector()
    n, dofs, h = equations.n_displacements, constraints.bc_dofs, SLOPE_STEP_RATIO * dt
    values = [constraints.bc_values(t + k * h) for k in range(3)]
    equations.put_state(state, x)
    _require_no_jump(equations, x, values[0])
    memory = {"v": fem.Function(part.V), "a": fem.Function(part.V)}
    v = constraints.unknowns(state.memory.get(part.key, part.rest())["v"].x.array[:n])
    v[dofs] = (-3 * values[0] + 4 * values[1] - values[2]) / (2 * h)
    _set_values(memory["v"], constraints.displacements(v))
    x.array[dofs] = values[0]
    h = RATE_STEP_RATIO * dt if equations.traits.rate else 0.0
    before = state.u.copy()
    before.x.array[:] -= h * memory["v"].x.array
    part.keeps_motion = True
    try:
        for is_balanced in (False, True):  # without accelerations, then with those that balance the forces
            old = replace(state, u=before, memory={**state.memory, part.key: memory}, t=t - h)
            equations.begin(TimeStep(old, t, h, 1.0))
            residual = equations.create_vector()
            equations.residual(x, residual)
            if not is_balanced:
                prescribed_a = np.asarray((values[0] - 2 * values[1] + values[2]) / (SLOPE_STEP_RATIO * dt) ** 2, float)
                _set_values(memory["a"], _accelerations(equations, part.M, residual.array_r[:n], prescribed_a))
        start = equations.accept(x, Report("start", 0, 0.0, 0.0))
    except SolveError as error:
        text = "layers without mass are not in equilibrium at the start; give them a density"
        raise SolveError(f"{text}: {error.reason}") from error
    finally:
        part.keeps_motion = False
    return replace(
        start, audit=replace(start.audit, supplied=0.0, stored=0.0, dissipated=0.0, remainder=0.0), sudden=False
    )


def _require_no_jump(equations: Equations, x: PETSc.Vec, prescribed: Array) -> None:
    jumps, comm = np.abs(x.array_r[equations.constraints.bc_dofs] - prescribed), equations.comm
    jump, largest = (comm.allreduce(float(np.max(f, initial=0.0)), max) for f in (jumps, np.abs(prescribed)))
    if jump > JUMP_TOLERANCE * max(largest, comm.allreduce(float(np.abs(x.array_r).max(initial=0.0)), max)):
        text = f"at the start supports prescribe displacements that differ by {jump:.3g} from those of the state"
        raise InputError(f"{text}: with mass they cannot jump; let them grow in time")


def _set_values(f: fem.Function, owned: Array) -> None:
    f.x.array[: len(owned)] = owned
    f.x.scatter_forward()


def _accelerations(equations: Equations, M: PETSc.Mat, residual: Array, prescribed: Array) -> Array:
    """Return the nodal accelerations (n,) that balance forces `residual` (n,) on the unknowns; 0 where no mass is."""
    constraints = equations.constraints
    A = M.copy() if constraints.T is None else M.ptap(constraints.T)
    diagonal, b, a = A.getDiagonal(), A.createVecLeft(), A.createVecRight()
    massless = np.flatnonzero(diagonal.array_r == 0)
    b.array[:] = -residual
    a.array[constraints.bc_dofs] = prescribed
    b.array[massless] = 0.0
    dofs = np.union1d(massless, constraints.bc_dofs)
    rows = np.asarray(A.getOwnershipRange()[0] + dofs, PETSc.IntType)
    A.zeroRowsColumns(rows, float(diagonal.max()[1]), a, b)
    ksp = PETSc.KSP().create(A.comm)
    ksp.setType("cg")
    ksp.getPC().setType("jacobi")
    ksp.setTolerances(rtol=MASS_TOLERANCE, atol=0.0, max_it=10000)
    ksp.setOperators(A)
    ksp.solve(b, a)
    values = np.asarray(constraints.displacements(a.array_r.copy()))
    destroy(A, diagonal, b, a, ksp)
    return values
