"""Film: exchange of heat, or of another scalar, through a part of the boundary with surroundings of another value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import ufl
from dolfinx import fem

from forms.base import Array, is_finite, require
from forms.kinematics import ScalarField
from forms.tensors import Expr
from thinlayer.discretisation.boundary import boundary_tags
from thinlayer.discretisation.coefficient import HandsOver, Value, times
from thinlayer.discretisation.form_compilation import unit_values
from thinlayer.discretisation.part_definition import HostModel, PartDefinition
from thinlayer.discretisation.rigid_motions import motion_expression
from thinlayer.discretisation.supports import Place
from thinlayer.parts.form_part import FormPart, assemble_plain_matrix


@dataclass(frozen=True)
class Film(PartDefinition):
    """Exchange with surroundings: the flux into the structure is h (T_f - T), with its own value T at the boundary.

    A structure with a film needs no supports. `State.reaction` of the place is the flow through the film.

    Attributes:
        place: name of a facet set on the outer boundary. It does not include the side of a meshed layer, which is the
            facet set "NAME/LAYER", and needs a film of its own.
        h: transfer coefficient, flux over difference of values; > 0.
        T: value T_f of the surroundings, a number or a function (x, t).
        key: name of the film's energy in `State.energies`: "film NAME" for the facet set NAME.

    Raises:
        InputError: h out of range. When a model is made: the facet set is unknown or empty, or has inner facets.

    Example:
        >>> from forms import Conduction
        >>> from geometry import sandwich
        >>> from thinlayer import Film, Structure, ThinLayer, solve
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> film = Film("BOTTOM", h=1e-3, T=20)
        >>> plates = Structure(
        ...     joint, body=Conduction(0.05), supports={"TOP": 80}, parts=[film]
        ... )
        >>> state = solve(plates.interface(ThinLayer(Conduction(2e-4), eps=0.1)))
        >>> state.reaction("BOTTOM"), state.reaction("TOP")
        (flow -0.153846, flow 0.153846)
    """

    unknowns: ClassVar = (ScalarField.unknown,)
    place: str
    h: float
    T: Value
    key: str = field(init=False)

    def __post_init__(self) -> None:
        require(is_finite(self.h) and self.h > 0, f"film on {self.place!r}: h", self.h, "allowed: > 0")
        is_value = is_finite(self.T) or (callable(self.T) and not isinstance(self.T, HandsOver))
        wanted = "give a number or a function (x, t) for the surroundings, no field of a structure, nor values on S"
        require(is_value, f"film on {self.place!r}: T", self.T, wanted)
        object.__setattr__(self, "key", f"film {self.place}")

    def check(self, model: HostModel) -> None:
        boundary_tags(model.domain, model.kinematics, self.place, f"film on {self.place!r}")

    def surface_loads(self) -> Mapping[str, Value]:
        return {self.place: times(self.h, self.T)}

    def work(self, model: HostModel, u: Expr, v: Expr) -> ufl.Form:
        h = fem.Constant(model.domain.mesh, float(self.h))
        return h * ufl.inner(u, v) * model.kinematics.factor * model.ds(model.domain.values(self.place))

    def reaction(self, model: HostModel, u: fem.Function) -> list[tuple[Place, Array]]:
        motion, v = motion_expression(model)
        return [(self.place, -unit_values(model.comm, self.work(model, u, v), motion))]

    def part(self, model: HostModel) -> FormPart:
        u, v = ufl.TrialFunction(model.V), ufl.TestFunction(model.V)
        return FormPart(self.key, fem.Function(model.V), assemble_plain_matrix(self.work(model, u, v)), kept=True)
