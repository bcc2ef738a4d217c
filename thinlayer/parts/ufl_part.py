"""A user-defined UFL form as a part of the balance of forces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import ufl
from dolfinx import fem
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.check_arities import ArityMismatch, check_form_arity
from ufl.algorithms.remove_complex_nodes import remove_complex_nodes

from forms.base import InputError
from forms.kinematics import PLANE_STRAIN, ScalarField
from forms.tensors import Expr
from thinlayer.discretisation.form_compilation import checked_user_form
from thinlayer.discretisation.part_definition import HostModel, PartDefinition
from thinlayer.parts.form_part import FormPart, assemble_plain_matrix
from thinlayer.parts.part import PartTraits, StepOutcome
from thinlayer.system.compat import expand_derivatives, ufl_replace, without_cycles

SYMMETRY_TOLERANCE = 1e-12  # norm of a matrix less its transpose, relative to its norm, that counts as rounding error


@dataclass(frozen=True)
class UflPart(PartDefinition):
    """Forces that a user defines by a UFL form of their virtual work or of their energy.

    UFL computes the derivatives. In a step of length dt from time old.t, the form is evaluated at the displacements at
    old.t + theta dt, where forces balance.

    If the forces have an energy, define `energy`: the tangent is then symmetric, and the energy balance of a step
    contains the energy. With `virtual_work` the tangent counts as not symmetric. The energy is then NaN, unless the
    forces are linear with a symmetric matrix.

    Attributes:
        virtual_work: function (u, v, model) -> the virtual work at displacements u, a form linear in v. The measures
            are `model.dx` and `model.ds`, and `model.domain.values(name)` are the tags of a facet set. In axisymmetry
            the model adds the factor 2 pi r.
        energy: function (u, model) -> the stored energy, a form without v. Give either `virtual_work` or `energy`.
        key: name of the part in `State.energies`.

    Raises:
        InputError: neither function is given, or both. When a model is made: the function does not return such a form.

    Example:
        >>> import ufl
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, UflPart, solve
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> def energy(u, model):
        ...     return 25 * ufl.inner(u, u) * model.ds(model.domain.values("BOTTOM"))
        >>> soil = UflPart(energy=energy)
        >>> plates = Structure(
        ...     joint, body=steel, supports={}, tractions={"TOP": (3, -10)}, parts=[soil]
        ... )
        >>> state = solve(plates.interface(ThinLayer(glue, eps=0.05)))
        >>> f"{state.energies()['own form']:.3g}"
        '6.79'
    """

    unknowns: ClassVar = (PLANE_STRAIN.unknown, ScalarField.unknown)
    virtual_work: Callable[[Expr, Expr, HostModel], ufl.Form] | None = None
    energy: Callable[[Expr, HostModel], ufl.Form] | None = None
    key: str = "own form"

    def __post_init__(self) -> None:
        functions = [function for function in (self.virtual_work, self.energy) if function is not None]
        if len(functions) != 1 or not callable(functions[0]):
            raise InputError(f"{self!r}: give one function, virtual_work(u, v, model) or energy(u, model)")

    def check(self, model: HostModel) -> None:
        """Raise InputError unless the user's function returns a form that can be assembled on `model`. Collective."""
        u, v = fem.Function(model.V), ufl.TestFunction(model.V)
        subject = f"the part {self.key!r}"
        try:
            form = self._form(model, u, v)
        except Exception as error:
            raise InputError(f"{subject}: {type(error).__name__}: {error}") from error
        arguments, requirement = ((), "of u alone") if self.virtual_work is None else ((v,), "of u, and linear in v")
        if not isinstance(form, ufl.Form):
            raise InputError(f"{subject} gives {form!r}; it must be a UFL form {requirement}")
        if not all(domain is model.V.mesh.ufl_domain() for domain in form.ufl_domains()):
            raise InputError(f"{subject} is a form on another mesh than the model's; use model.dx and model.ds")
        checked_user_form(form, model.domain, model.kinematics, subject)
        if form.arguments() != arguments or not multilinear(form):
            raise InputError(f"{subject} is {str(form)[:80]}; it must be a form {requirement}")
        forces = ufl.derivative(form, u, v) if self.energy else form
        if expand_derivatives(ufl.derivative(expand_derivatives(forces), u, ufl.TrialFunction(model.V))).empty():
            raise InputError(f"the forces of {subject} do not depend on u; loads are `tractions` and `body_force`")

    def _form(self, model: HostModel, u: Expr, v: Expr) -> ufl.Form:
        """Return the form that the user's function gives at displacements `u`; only a virtual work contains `v`."""
        return self.energy(u, model) if self.energy else self.virtual_work and self.virtual_work(u, v, model)

    def work(self, model: HostModel, u: Expr, v: Expr) -> ufl.Form:
        """Return the virtual work at displacements `u`, a form linear in the virtual displacements `v`.

        If the user gave an energy, it is the derivative of the energy in the direction `v`.
        """
        if not self.energy:
            return checked_user_form(self._form(model, u, v), model.domain, model.kinematics)
        unknown = fem.Function(model.V)
        energy = checked_user_form(self._form(model, unknown, v), model.domain, model.kinematics)
        return ufl_replace(expand_derivatives(ufl.derivative(energy, unknown, v)), {unknown: u})

    def is_linear(self, model: HostModel) -> bool:
        return multilinear(self.work(model, ufl.TrialFunction(model.V), ufl.TestFunction(model.V)))

    def is_symmetric(self, model: HostModel) -> bool:
        return self.energy is not None

    def part(self, model: HostModel) -> FormPart:
        """Return the user's form as a part of the balance of forces of `model`. Collective."""
        return _UserFormPart(self, model)


class _UserFormPart(FormPart):
    """Part of the balance of forces with the forces of a `UflPart`.

    If the forces are linear in the displacements, their matrix is assembled once. Otherwise the form is assembled in
    each evaluation.
    """

    def __init__(self, part: UflPart, model: HostModel) -> None:
        u, v, linear = fem.Function(model.V), ufl.TestFunction(model.V), part.is_linear(model)
        K = assemble_plain_matrix(part.work(model, ufl.TrialFunction(model.V), v)) if linear else None
        energy = (
            checked_user_form(part.energy(u, model), model.domain, model.kinematics)
            if part.energy and not linear
            else None
        )
        super().__init__(part.key, u, K, None if linear else part.work(model, u, v), energy, kept=True)
        if K is not None and model.comm.allreduce(float(K.getDiagonal().array_r.min(initial=0.0)), min) < 0:
            raise InputError(f"the part {part.key!r} has a negative stiffness: its equilibria may be unstable")
        self._has_energy = K is None or K.isSymmetric(SYMMETRY_TOLERANCE * K.norm())
        self.traits = PartTraits(saddle=True, weakens=not (self._has_energy and linear), nonlinear=not linear)

    def commit(self) -> StepOutcome:
        outcome, nan = super().commit(), float("nan")
        return outcome if self._has_energy else replace(outcome, before=nan, after=nan, remainder=nan)


@without_cycles()
def multilinear(form: ufl.Form) -> bool:
    """Tell whether the UFL `form` is linear in each of its arguments (test and trial functions).

    Each summand must contain all of these arguments.
    """
    try:  # derivatives of energies contain inner(u, v) and inner(v, u), which differ by a complex conjugate
        check_form_arity(remove_complex_nodes(apply_algebra_lowering(expand_derivatives(form))), form.arguments())
    except (ArityMismatch, ValueError):  # UFL raises ValueError for sums whose terms differ
        return False
    return True
