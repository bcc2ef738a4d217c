"""Distributed springs on a boundary, as a part of the balance of forces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import ufl
from dolfinx import fem

from forms.base import Array, InputError
from forms.tensors import Expr
from geometry.refusals import place_text as at_place
from thinlayer.discretisation.boundary import boundary_tags
from thinlayer.discretisation.coefficient import NUMPY_DEGREE, Coefficient
from thinlayer.discretisation.form_compilation import unit_values
from thinlayer.discretisation.part_definition import HostModel, PartDefinition
from thinlayer.discretisation.rigid_motions import motion_expression
from thinlayer.discretisation.supports import Place
from thinlayer.parts.form_part import FormPart, assemble_plain_matrix

Stiffness = float | Callable[[Expr], Expr]
NEGATIVE_STIFFNESS_TOLERANCE = 1e-9  # size of a negative stiffness, over the largest, that counts as rounding error


@dataclass(frozen=True)
class Springs(PartDefinition):
    """Springs between a facet set of the outer boundary and a base that does not move.

    Their traction on the structure is -k_N u_N - k_T u_T, with the normal and the tangential displacement u_N and u_T.
    Springs push and pull: a foundation that only pushes is contact with a rigid base (`geometry.block`, a contact law).
    A structure on springs needs no supports.

    A facet set NAME of the bodies does not include the side of a meshed layer between them. That side is the facet set
    "NAME/LAYER", and needs springs of its own.

    Attributes:
        place: name of a facet set on the outer boundary.
        normal, tangential: stiffness k_N across and k_T along the boundary, stress per length; >= 0, not both 0. A
            number, or a function of the coordinates x in the joint as drawn, before S is opened to the layer's
            thickness. A function in UFL, x -> UFL scalar, is exact. A function in numpy, x (d, n) -> (n,), is
            interpolated in each cell with degree 2.
        key: name of the springs' energy in `State.energies`: "springs NAME" for the facet set NAME.

    Raises:
        InputError: both stiffnesses are 0. When a model is made: the facet set is unknown or empty, or has inner
            facets. Or a stiffness is negative, or neither a number nor a function of the coordinates.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Springs, Structure, ThinLayer, solve
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> soil = Springs("BOTTOM", normal=50.0, tangential=20.0)
        >>> plates = Structure(
        ...     joint, body=steel, supports={}, tractions={"TOP": (3, -10)}, parts=[soil]
        ... )
        >>> state = solve(plates.interface(ThinLayer(glue, eps=0.05)))
        >>> print(state.reaction("BOTTOM").force.round(6))
        [-12.  40.]
    """

    place: str
    normal: Stiffness = 0.0
    tangential: Stiffness = 0.0
    key: str = field(init=False)

    def __post_init__(self) -> None:
        if self.normal == self.tangential == 0:
            raise InputError(f"springs on {self.place!r} have no stiffness; give normal=... or tangential=...")
        object.__setattr__(self, "key", f"springs {self.place}")

    def check(self, model: HostModel) -> None:
        """Raise InputError unless the facets lie on the outer boundary, and stiffnesses there are finite and >= 0."""
        boundary_tags(model.domain, model.kinematics, self.place, f"springs on {self.place!r}")
        facets, V = model.domain.facets(self.place), fem.functionspace(model.domain.mesh, ("Lagrange", NUMPY_DEGREE))
        for stiffness in self._stiffnesses(model):
            nodes = fem.locate_dofs_topological(V, model.joint.dim - 1, facets)
            values, x = stiffness.interpolant(V).x.array[nodes], V.tabulate_dof_coordinates()[nodes, : model.joint.dim]
            values = np.where(np.isfinite(values), values, -np.inf)
            if len(values) and values.min() < -NEGATIVE_STIFFNESS_TOLERANCE * values.max():
                k = int(values.argmin())
                raise InputError(f"{stiffness.what} is {values[k]:.6g} at {at_place(x[k])}; allowed: finite, >= 0")

    def _stiffnesses(self, model: HostModel) -> list[Coefficient]:
        """Return the normal, then the tangential stiffness, as functions of the place in `model`. Collective."""
        values, text = {"normal": self.normal, "tangential": self.tangential}, f"springs on {self.place!r}: "
        return [model.coordinates.coefficient(k, text + name, (), place_only=True) for name, k in values.items()]

    def work(self, model: HostModel, u: Expr, v: Expr) -> ufl.Form:
        """Return, as a UFL form, the virtual work of the springs: the integral of k_N u_N v_N + k_T u_T . v_T.

        The integral is over the facet set. The indices N and T denote components along the normal and tangential to the
        boundary.

        Args:
            model: the model to which the springs belong.
            u: displacements.
            v: virtual displacements.
        """
        n = ufl.FacetNormal(model.V.mesh)
        normal, tangential = (stiffness.expression for stiffness in self._stiffnesses(model))
        work = (normal - tangential) * ufl.dot(u, n) * ufl.dot(v, n) + tangential * ufl.inner(u, v)
        return work * model.kinematics.factor * model.ds(model.domain.values(self.place))

    def reaction(self, model: HostModel, u: fem.Function) -> list[tuple[Place, Array]]:
        """Return the resultant of the springs' tractions on the structure, in a list with one pair. Collective.

        The pair is the name of the facet set and an array: the force, then the moment about `model.centre`.

        Args:
            model: the model.
            u: displacements.
        """
        motion, v = motion_expression(model)
        return [(self.place, -unit_values(model.comm, self.work(model, u, v), motion))]

    def part(self, model: HostModel) -> FormPart:
        """Return the springs as a part of the balance of forces of `model`. Collective."""
        u, v = ufl.TrialFunction(model.V), ufl.TestFunction(model.V)
        return FormPart(self.key, fem.Function(model.V), assemble_plain_matrix(self.work(model, u, v)), kept=True)
