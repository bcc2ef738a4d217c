"""Definitions of what else a model contains besides bodies, layers, supports and loads, such as springs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import dolfinx.fem.petsc
import numpy as np
import ufl
from dolfinx import fem

from forms.base import Array, InputError
from forms.kinematics import PLANE_STRAIN
from forms.tensors import Expr
from forms.traits import accept_renamed
from geometry.topology import Indices
from thinlayer.discretisation.boundary import AXIS_NAMES
from thinlayer.discretisation.coefficient import LoadInput, Value
from thinlayer.discretisation.constraints import MultiPointConstraint
from thinlayer.discretisation.form_compilation import compiled
from thinlayer.discretisation.key import BODY_KIND, CONTACT_KIND, LAYER_KIND, PRESSURE_KIND, Key
from thinlayer.discretisation.layer import BODIES
from thinlayer.discretisation.supports import Place
from thinlayer.errors import FormerNames
from thinlayer.system.ranks import destroy

if TYPE_CHECKING:
    from thinlayer.discretisation.model import Model
    from thinlayer.discretisation.state import Configuration, State

RESERVED_KEYS = ("forms", LAYER_KIND, PRESSURE_KIND, CONTACT_KIND, BODIES, "loads")  # keys that every model may have


HostModel: TypeAlias = "Model"  # imported for checks of types alone, as its module imports this one


class PartDefinition(FormerNames):
    """Description of a part of the balance of forces, such as springs, among the `parts` of a structure.

    A subclass is a frozen dataclass. Its fields and code are among the data that identify a model.

    Attributes:
        key: name of the part's memory and energy in states and in files, unique among the parts of a model.
        place: for a part with a multi-point constraint, name of the facet set whose displacements it constrains.
        components: components of these displacements that it constrains, such as "y"; None: all.
        unknowns: unknowns of the structures to which the part may belong, see `Kinematics.unknown`.
    """

    former_names: ClassVar = {"tied": "multi_point_constraint", "held": "bc_dofs_in", "resistance": "rigid_stiffness"}
    key: str
    place: str
    components: ClassVar[Sequence[str] | None] = None
    unknowns: ClassVar[Sequence[str]] = (PLANE_STRAIN.unknown,)

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        accept_renamed(cls, cls.former_names)

    @property
    def has_constraint(self) -> bool:
        """Whether the part has a multi-point constraint: whether its class defines `multi_point_constraint`."""
        return type(self).multi_point_constraint is not PartDefinition.multi_point_constraint

    @property
    def has_work(self) -> bool:
        """Whether `work` gives the virtual work of the part's forces.

        This is so if its class defines `work`, or if the part has a multi-point constraint.
        """
        return self.has_constraint or type(self).work is not PartDefinition.work

    def check(self, model: HostModel) -> None:
        """Raise InputError if the definition does not fit the model; by default anything fits. Collective.

        Pass values that vary in time to `model.coordinates` here: steps of marches then end where their slopes change.
        """

    def surface_loads(self) -> Mapping[str, LoadInput | Value]:
        """Return loads on facet sets, by name, that the part exerts besides its forces; they count as its reaction."""
        return {}

    def is_linear(self, model: HostModel) -> bool:
        """Return whether the part's forces are linear in the unknowns."""
        return True

    def is_symmetric(self, model: HostModel) -> bool:
        """Return whether the tangent of the part's forces is symmetric."""
        return True

    def work(self, model: HostModel, u: Expr, v: Expr) -> Expr:
        """Return the virtual work, in v, of the part's forces at displacements u; by default there is none.

        It is a UFL form, linear in v.
        """
        return ufl.Form([])

    def work_in(self, model: HostModel, state: State, v: Expr) -> Expr:
        """Return the virtual work, in v, of the part's forces in a state; by default `work` at its displacements.

        It is a UFL form, linear in v, from which tractions on S are computed.

        Raises:
            InputError: the part defines neither `work_in` nor `work`, so that its forces would be missing in tractions.
        """
        if not self.has_work:
            remedy = "write work_in(model, state, v), a UFL form, ufl.Form([]) if it has no forces"
            raise InputError(f"tractions on S contain the forces of the part {self.key!r}: {remedy}")
        return self.work(model, state.u, v)

    def rigid_stiffness(self, model: HostModel, motions: Sequence[fem.Function]) -> Array:
        """Return the stiffness (m, m) of the part against m rigid motions of the structure. Collective.

        Entry (i, j) is the work in motion j of the part's forces under motion i. Supports and parts together must
        resist every rigid motion.

        Args:
            model: the model.
            motions: the displacements of the m rigid motions.
        """
        zero_u, stiffness = fem.Function(model.V), np.zeros((len(motions), len(motions)))
        form = self.work(model, zero_u, ufl.TestFunction(model.V))
        if form.empty():
            return stiffness
        A = dolfinx.fem.petsc.assemble_matrix(compiled(ufl.derivative(form, zero_u, ufl.TrialFunction(model.V))))
        A.assemble()
        forces = A.createVecLeft()
        for row, motion in zip(stiffness, motions, strict=True):
            A.mult(motion.x.petsc_vec, forces)
            row[:] = [float(other_motion.x.petsc_vec.dot(forces)) for other_motion in motions]
        destroy(forces, A)
        return stiffness

    def reaction(self, model: HostModel, u: fem.Function) -> list[tuple[Place, Array]]:
        """Return the places at which the part supports the structure, each with its reaction. Collective.

        Args:
            model: the model.
            u: the displacements.

        Returns:
            Pairs of a place and an array, which has d components of the force in d dimensions, then the moment about
            `model.centre`. By default there are none, because forces of user-defined parts do not count as reactions.
        """
        return []

    def bc_dofs_in(self, model: HostModel, V: fem.FunctionSpace) -> Indices:
        """Return the local degrees of freedom of V, ghosts included, on which the part acts as a support does.

        Collective. By default they are the displacements that its multi-point constraint determines.
        """
        if not self.has_constraint:
            return np.empty(0, np.int32)
        facets, d = model.domain.facets(self.place, layer_sides=True), model.joint.dim
        axes = [k for k in range(d) if self.components is None or AXIS_NAMES[k] in self.components]
        nodes = fem.locate_dofs_topological(V, d - 1, facets)
        return np.unique(nodes[:, None] * d + np.array(axes, int)).astype(np.int32)

    def multi_point_constraint(self, model: HostModel) -> MultiPointConstraint:
        """Return the multi-point constraint u = R q between displacements u and the part's own unknowns q. Collective.

        The unknowns q are called motions. Examples are the translations and the rotation of a rigid plate.
        """
        raise NotImplementedError

    def load_work(self, model: HostModel, state: Configuration) -> float:
        """Return the work of the part's prescribed forces, which count as loads, in given displacements. Collective.

        By default it is the work of the prescribed resultants of its multi-point constraint.

        Args:
            model: the model.
            state: the displacements and the time.
        """
        constraints, u = model.constraints, state.u.x.array[: model.constraints.n]
        mpcs = [mpc for mpc in constraints.mpcs if mpc.key == self.key]
        return sum((float(mpc.resultant(state.t) @ constraints.fit_motions(mpc, u)) for mpc in mpcs), 0.0)

    def part(self, model: HostModel) -> Any:
        """Return the `thinlayer.parts.part.Part` with the same key that adds the forces; None without forces.

        Collective.
        """
        return None


def check_part_definitions(parts: Sequence[PartDefinition], model: HostModel) -> None:
    """Raise InputError unless `parts` are part definitions that fit the model and have distinct keys. Collective."""
    seam_keys = {Key(kind, name) for kind in (LAYER_KIND, CONTACT_KIND, PRESSURE_KIND) for name in model.joint.seams}
    used_keys = {*RESERVED_KEYS, *map(str, seam_keys), *(str(Key(BODY_KIND, name)) for name in model.joint.bodies)}
    for part in parts:
        if not part.has_constraint and type(part).part is PartDefinition.part:
            raise InputError(f"{part.key!r} does nothing: it has neither part(model) nor multi_point_constraint(model)")
        base_key = replace(Key.parse(part.key), member="")
        is_sublayer = base_key.kind == LAYER_KIND and base_key.name.isdecimal()
        if is_sublayer or base_key in {Key(LAYER_KIND), *seam_keys} or part.key in used_keys:
            raise InputError(f"two parts are called {part.key!r}; give one of them another name")
        used_keys.add(part.key)
        part.check(model)
