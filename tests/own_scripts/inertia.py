"""Inertia by Newmark's method: a part that has velocities and accelerations."""

from dataclasses import dataclass

import ufl
from dolfinx import fem

from thinlayer import InputError
from thinlayer.discretisation.part_definition import PartDefinition
from thinlayer.parts.form_part import assemble_plain_matrix
from thinlayer.parts.part import Block, Part, PartTraits, StepOutcome


@dataclass(frozen=True)
class Inertia(PartDefinition):
    rho: float  # mass per volume
    beta: float = 1 / 4
    gamma: float = 1 / 2  # larger values damp what the mesh cannot show
    key: str = "inertia"

    def work_in(self, model, state, v):  # tractions on S contain it
        return self.rho * ufl.inner(state.memory[self.key]["a"], v) * model.dx

    def part(self, model):
        return Newmark(self, model)


class Newmark(Part):
    traits = PartTraits(rate=True, remembers=True)

    def __init__(self, definition, model):
        self.key, self.definition, self.V = definition.key, definition, model.V
        u, v = ufl.TrialFunction(model.V), ufl.TestFunction(model.V)
        self.M = assemble_plain_matrix(definition.rho * ufl.inner(u, v) * model.dx)

    def rest(self):
        return {"v": fem.Function(self.V), "a": fem.Function(self.V)}

    def begin(self, interval):
        if interval.theta < 1:
            why = "inertia balances forces at the ends of steps: theta = 1"
            raise InputError(why)
        self.interval, self.new = interval, self.rest()

    def evaluate(self, u, mid):
        old, dt = self.interval.old, self.interval.dt
        beta, gamma = self.definition.beta, self.definition.gamma
        v, a = (old.memory[self.key][name].x.array for name in ("v", "a"))
        self.moved = u.x.petsc_vec - old.u.x.petsc_vec
        if dt > 0:
            moved = u.x.array - old.u.x.array
            new_a = (moved - dt * v) / (beta * dt**2) - (0.5 / beta - 1) * a
            self.new["a"].x.array[:] = new_a
            self.new["v"].x.array[:] = v + dt * ((1 - gamma) * a + gamma * new_a)
        self.forces = self.M * self.new["a"].x.petsc_vec

    def add_forces(self, out):
        out.axpy(1.0, self.forces)
        return self.forces.norm()

    def tangents(self, relative_residual):
        dt = self.interval.dt
        factor = 1 / (self.definition.beta * dt**2) if dt > 0 else 0.0
        return [Block(self.M, factor, kept=True)]

    def commit(self):
        v = self.new["v"].x.petsc_vec
        before = self.interval.old.stored.get(self.key, 0.0)
        after = v.dot(self.M * v) / 2
        remainder = self.forces.dot(self.moved) - (after - before)
        return StepOutcome(before, after, remainder=remainder, memory=self.new)
