"""Which solver a contact problem gets, and its steps."""

from __future__ import annotations

import importlib
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from thinlayer.contact.nodes import CONTACT, Array, ContactNodes
from thinlayer.contact.problem import ContactProblem
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State, transfer
from thinlayer.solving.linear_solvers import rigid_modes

METHODS = ("condensed", "multigrid", "relaxation")
_HOME = {"condensed": "Condensed", "multigrid": "MultigridContact", "relaxation": "ContactRelaxation"}
CONDENSED_UP_TO = {2: 4000, 3: 1200}  # displacements at S, of a dense system on one rank


class Scheme(Protocol):
    """What solves a contact problem, one load after the other."""

    def solve(self, start: Array | None) -> tuple[PETSc.Vec, int, list[float]]:
        """Displacements, number of steps, residual at each of them; start: (n, d) expected jumps in the nodes' frames."""

    def close(self) -> None:
        """Free matrices and factors."""


def scheme(method: str, problem: ContactProblem) -> Scheme:
    """One of METHODS, for a problem."""
    home = importlib.import_module(f"thinlayer.contact.{method}")
    found: Scheme = getattr(home, _HOME[method])(problem)
    return found


def contact_problem(nodes: ContactNodes, K: PETSc.Mat, held: npt.NDArray[np.int32]) -> ContactProblem:
    """The contact problem of a model with linear bodies: its nodes, its stiffness, held displacements of this rank."""
    model = nodes.model
    assert model.contact is not None
    near = PETSc.NullSpace().create(vectors=rigid_modes(model), comm=model.comm)
    return ContactProblem(K, held, nodes, model.contact, near)


def default_method(model: Model) -> str:
    """The solver that suits a contact model: plain Newton for bodies that are not linear and laws without sweeps.

    Otherwise condensed to S on one rank while its matrix is small, else multigrid.
    """
    if model.contact is None or model.contact.numbers is None or not _linear_bodies(model):
        return "newton"
    vertices = len(np.unique(model.joint.surface))
    sides = 1 if model.joint.rigid_base else 2
    narrow = vertices * sides * model.joint.dim <= CONDENSED_UP_TO[model.joint.dim]
    return "condensed" if narrow and model.comm.size == 1 else "multigrid"


def _linear_bodies(model: Model) -> bool:
    """Whether all but the contact law is one constant, symmetric matrix."""
    added = all(part.is_linear(model) and part.is_symmetric(model) for part in model.parts)
    return added and all(p.proportional for p in model.bodies)


class ContactSolver:
    """Steps of a contact model with linear bodies. Collective.

    Args:
        problem: the model's.
        method: one of METHODS.
        like: a state of a model of the same joint whose contact status is close to the one to be found.
    """

    def __init__(self, problem: ContactProblem, method: str, like: State | None) -> None:
        self.problem = problem
        self._scheme = scheme(method, problem)
        self._start = self._jumps(like) if like else None

    def _jumps(self, state: State) -> Array:
        model = self.problem.nodes.model
        u = state.u if state.model is model else transfer(state.u, state.model, model.V, model)
        return self.problem.nodes.jump(u.x.petsc_vec)

    def advance(self, old: State, loads: PETSc.Vec, prescribed: Array) -> tuple[PETSc.Vec, int, float]:
        """Displacements at the end of the step, number of steps of the solver, residual over the forces.

        Args:
            old: state at the beginning.
            loads: nodal forces of the loads.
            prescribed: values of held displacements.
        """
        problem = self.problem
        problem.begin(loads, prescribed, old.memory[CONTACT], old.u.x.petsc_vec)
        start = self._start if self._start is not None else self._jumps(old)
        known = problem.comm.allreduce(int(start.any()))
        u, steps, residuals = self._scheme.solve(start if known else None)
        self._start = None
        return u, steps, residuals[-1]

    def close(self) -> None:
        """Free matrices and factors."""
        self._scheme.close()
        self.problem.destroy()


def check_method(model: Model, method: Any) -> None:
    """Raise ValueError if a method is for contact and the model has none, or bodies that are not linear."""
    if method in METHODS and model.contact is None:
        raise ValueError(f"method={method!r} is for contact laws; the model has none")
    if method in ("condensed", "relaxation") and model.comm.size > 1:
        raise ValueError(f"method={method!r} is for one rank, not {model.comm.size}; use method='multigrid'")
    if method in METHODS and not _linear_bodies(model):
        raise ValueError(
            f"method={method!r} needs linear bodies without eigenstrains, and linear, symmetric parts; use method='newton'"
        )
    if method in METHODS and model.contact and model.contact.numbers is None:
        name = type(model.contact).__name__
        raise ValueError(f"method={method!r} needs one of the laws of forms.contact, not {name}; use method='newton'")
