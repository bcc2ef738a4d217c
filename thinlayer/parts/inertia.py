"""Inertia: mass of bodies and layers as a part of the balance of forces, and velocities at the start of marches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from forms.base import Array, InputError, is_finite, require
from forms.tensors import Expr
from geometry.refusals import require_known
from thinlayer.discretisation.part_definition import HostModel, PartDefinition
from thinlayer.parts.form_part import assemble_plain_matrix
from thinlayer.parts.part import Block, Part, PartTraits, StepOutcome, TimeStep
from thinlayer.system.ranks import destroy

if TYPE_CHECKING:
    from thinlayer.discretisation.state import State

# over [u]^2: mean square of displacements that are linear through a layer, minus the square of their mean
JUMP_SHARE = 1 / 12
KINEMATIC_DEGREE = 2  # increase of quadrature degrees for the area of a curved S, or 2 pi r


@dataclass(frozen=True)
class Inertia(PartDefinition):
    """Mass of bodies and layers: with it structures have `modes`, and `march` computes how they move.

    A layer on S has the kinetic energy eps rho (|<u>'|^2 + |[u]'|^2/12)/2 per area, for the mean <u> and the jump [u] of
    the displacement. `solve` leaves mass out. Units must be consistent: with mm and MPa, densities are in t/mm^3.

    Attributes:
        density: name of each body, and of each seam with a layer -> mass per volume; > 0 in bodies, >= 0 in layers. For
            laws without a thickness it is mass per area of S.
        velocity: name of a body -> its uniform velocity (d,) at the start of a march that begins from a model, not from
            a state. None: zero.
        key: name of the kinetic energy in `State.energies`, "inertia".

    Raises:
        InputError: when a model is made: a density is missing, out of range, or of something unknown; a velocity is not
            (d,) numbers; unlike velocities in a model with meshed layers or bonds; a periodic cell under a mean strain.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Inertia, Structure, ThinLayer, march
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> mass = Inertia({"LOWER": 7.8e-9, "UPPER": 7.8e-9, "S": 1.2e-9})
        >>> data = {"supports": {"BOTTOM": 0}, "tractions": {"TOP": (3, -10)}}
        >>> plates = Structure(joint, body=steel, parts=[mass], **data)
        >>> times = [1e-7 * k for k in range(1, 21)]
        >>> history = march(plates.interface(ThinLayer(glue, eps=0.05)), times)
        >>> f"{history.last.energies()['inertia']:.3g}"
        '0.00441'
    """

    density: Mapping[str, float]
    velocity: Mapping[str, Sequence[float]] | None = None
    key: str = field(default="inertia", init=False)

    def check(self, model: HostModel) -> None:
        if model.strain or model.stress:
            raise InputError("Inertia in a periodic cell under a mean strain or stress is not known; leave it out")
        names = (*model.body_laws, *model.layers)
        require(isinstance(self.density, Mapping), "Inertia: density", self.density, "give {name: mass per volume}")
        for name in (*self.density, *names):  # an unknown name explains why another one is missing
            require_known("body or layer", name, names, "the densities of Inertia")
            rho, least = self.density.get(name), "> 0" if name in model.body_laws else ">= 0"
            is_allowed = is_finite(rho) and rho is not None and (rho > 0 or (rho == 0 and least == ">= 0"))
            require(is_allowed, f"Inertia: the density of {name!r}", rho, f"allowed: {least}")
        values = [self._velocity_of(model, name) for name in model.body_laws]
        for name in self.velocity or ():
            require_known("body", name, model.body_laws, "the velocities of Inertia")
        if not np.array_equal(values, values[:1] * len(values)) and (model.bonds or not model.broken):
            raise InputError("Inertia: unlike velocities of bodies need layers on S between them, without bonds")

    def _velocity_of(self, model: HostModel, name: str) -> Array:
        value = (self.velocity or {}).get(name, (0.0,) * model.joint.dim)
        is_vector = np.shape(value) == (model.joint.dim,) and all(map(is_finite, value))
        require(is_vector, f"Inertia: the velocity of {name!r}", value, f"give {model.joint.dim} numbers")
        return np.array(value, float)

    def mass_form(self, model: HostModel, a: Expr, v: Expr, names: Sequence[str] | None = None) -> ufl.Form:
        """Return the virtual work, in v, that accelerations `a` of the mass need: a UFL form, linear in v.

        Args:
            model: the model.
            a: accelerations (d,), UFL.
            v: virtual displacements (d,), UFL.
            names: names of bodies and of seams whose mass counts; None: all.
        """
        rho = {name: fem.Constant(model.domain.mesh, float(value)) for name, value in self.density.items()}
        names, form, degree = [*rho] if names is None else names, ufl.Form([]), 2 * model.structure.degree
        for name in names:
            if name in model.body_laws:
                form += rho[name] * ufl.inner(a, v) * model.kinematics.factor * model.dx(model.domain.region_tags(name))
                continue
            region = model.load_region(model.layers[name])
            squares = ufl.inner(region.work_argument(a), region.work_argument(v))
            measure = region.measure
            if region.jump:
                squares += JUMP_SHARE * ufl.inner(region.jump(a), region.jump(v))
                measure = measure.reconstruct(metadata={"quadrature_degree": degree + KINEMATIC_DEGREE})
            form += rho[name] * squares * region.weight * measure
        return form

    def mass_matrix(self, model: HostModel, names: Sequence[str] | None = None) -> PETSc.Mat:
        """Return the mass matrix of bodies and layers with the given names; None: of all. Collective."""
        return assemble_plain_matrix(
            self.mass_form(model, ufl.TrialFunction(model.V), ufl.TestFunction(model.V), names)
        )

    def work_in(self, model: HostModel, state: State, v: Expr) -> ufl.Form:
        """Return the virtual work of the inertia of the bodies alone, so that tractions on S are those of the bodies.

        The traction of a layer's law differs from them by the inertia of the layer.
        """
        return self.mass_form(model, state.memory[self.key]["a"], v, [*model.body_laws])

    def rigid_stiffness(self, model: HostModel, motions: Sequence[fem.Function]) -> Array:
        """Return the mass (m, m) in m rigid motions: in a march it resists motions that nothing else prevents."""
        M = self.mass_matrix(model)
        products = [M * motion.x.petsc_vec for motion in motions]
        gram = np.array([[product.dot(motion.x.petsc_vec) for motion in motions] for product in products], float)
        destroy(M, *products)
        return gram

    def part(self, model: HostModel) -> Part:
        return InertiaPart(self, model)

    def initial_velocity(self, model: HostModel) -> fem.Function:
        """Return the velocities at the start of a march that begins from a model, as a function on the mesh."""
        v = fem.Function(model.V)
        values, dofs = v.x.array.reshape(-1, model.joint.dim), np.asarray(model.V.dofmap.list)
        for name in model.body_laws if model.broken else ():
            values[dofs[model.domain.cell_tags.find(*model.domain.region_tags(name))]] = self._velocity_of(model, name)
        if not model.broken:  # the velocities of all bodies are the same, and meshed layers move with them
            values[:] = self._velocity_of(model, next(iter(model.body_laws)))
        return v


class InertiaPart(Part):
    """Inertia forces M (v1 - v0)/dt of a time step, with the velocities v0 at its start and v1 at its end.

    Displacements are u1 = u0 + dt ((1 - theta) v0 + theta v1); theta = 1/2 is the midpoint rule. The memory has the
    velocities "v" and accelerations "a" at the ends of steps, as functions on the mesh. In a step without duration both
    keep their values.

    Attributes:
        M: the mass matrix.
        keeps_motion: whether steps with a duration, too, leave velocities and accelerations unchanged.
    """

    traits = PartTraits(inert=True, remembers=True)

    def __init__(self, definition: Inertia, model: HostModel) -> None:
        self.key, self.V, self.keeps_motion = definition.key, model.V, False
        self.M = definition.mass_matrix(model)
        self._forces, self._moved, self._momentum = (self.M.createVecLeft() for _ in range(3))
        self._initial_velocity = definition.initial_velocity(model)

    def rest(self) -> dict[str, fem.Function]:
        return {"v": self._initial_velocity.copy(), "a": fem.Function(self.V)}

    def begin(self, interval: TimeStep) -> None:
        super().begin(interval)
        # 12 digits, as in the solver's test whether steps can share a factor: differences of late times are inexact
        self._dt = 0.0 if self.keeps_motion else float(f"{interval.dt:.12g}")
        self._motion = {name: f.copy() for name, f in interval.old.memory[self.key].items()}

    def evaluate(self, u: fem.Function, mid: fem.Function) -> None:
        step, v, balanced_a = self.interval, self._motion["v"].x, self._motion["a"].copy()
        if self._dt > 0:
            old = step.old.memory[self.key]
            v0, a0, theta = old["v"].x.array, old["a"].x.array, step.theta
            v.array[:] = (u.x.array - step.old.u.x.array) / (theta * self._dt) - (1 / theta - 1) * v0
            balanced_a.x.array[:] = (v.array - v0) / self._dt
            self._motion["a"].x.array[:] = (balanced_a.x.array - (1 - theta) * a0) / theta
        self._moved.waxpy(-1.0, step.old.u.x.petsc_vec, u.x.petsc_vec)
        self.M.mult(balanced_a.x.petsc_vec, self._forces)

    def add_forces(self, out: PETSc.Vec) -> float:
        out.axpy(1.0, self._forces)
        return float(self._forces.norm())

    def tangents(self, relative_residual: float) -> list[Block]:
        return [Block(self.M, 1 / (self.interval.theta * self._dt**2), kept=True)] if self._dt > 0 else []

    def commit(self) -> StepOutcome:
        before, after = (self._energy(v) for v in (self.interval.old.memory[self.key]["v"], self._motion["v"]))
        work = float(self._forces.dot(self._moved))
        return StepOutcome(before, after, remainder=work - (after - before), memory=self._motion)

    def _energy(self, v: fem.Function) -> float:
        self.M.mult(v.x.petsc_vec, self._momentum)
        return float(v.x.petsc_vec.dot(self._momentum)) / 2

    def destroy(self) -> None:
        destroy(self.M, self._forces, self._moved, self._momentum)
