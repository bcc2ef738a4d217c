"""JouleHeat: the heat of an electric current, as a source in bodies and layers of a structure of heat."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import ClassVar

import numpy as np
import ufl
from dolfinx import fem

from forms.base import Array, require
from forms.kinematics import ScalarField
from forms.tensors import Expr, scalar_value
from forms.work import stress
from geometry.joint import Joint
from thinlayer.discretisation.form_compilation import compiled_functionals
from thinlayer.discretisation.part_definition import HostModel, PartDefinition
from thinlayer.discretisation.state import Configuration, State
from thinlayer.parts.form_part import FormPart


@dataclass(frozen=True)
class JouleHeat(PartDefinition):
    """Heat of an electric current: a source of flux times gradient of the potential, in bodies and in layers.

    In a layer on S the source is at the heights at which its law is evaluated. The structures of current and heat have
    the same joint. Flows out of the structure balance it, but `State.applied` does not contain it.

    Attributes:
        current: state of the electric potential, whose laws have conductivities that are numbers.

    Raises:
        InputError: no state of a potential; when a model is made: another joint, `plane=`, `bodies=` or thickness than
            in the model of the current; in that model a seam without a layer that has a thickness, or conductivities
            that vary; a bond where the current has a layer.

    Example:
        >>> from forms import Conduction
        >>> from geometry import sandwich
        >>> from thinlayer import JouleHeat, Structure, ThinLayer, solve
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")  # mm
        >>> ends = {"BOTTOM": 0, "TOP": 0.1}  # V
        >>> wires = Structure(joint, body=Conduction(1e3), supports=ends)  # A/(V mm)
        >>> current = solve(wires.interface(ThinLayer(Conduction(1.0), eps=0.1)))
        >>> parts = [JouleHeat(current)]
        >>> plates = Structure(
        ...     joint, body=Conduction(0.05), supports={"BOTTOM": 20}, parts=parts
        ... )
        >>> state = solve(plates.interface(ThinLayer(Conduction(2e-4), eps=0.1)))
        >>> heat = 0.1 * current.reaction("TOP").flow, state.reaction("BOTTOM").flow
        >>> print("{:.4f} {:.4f} W/mm".format(*heat))
        0.3883 -0.3883 W/mm
    """

    unknowns: ClassVar = (ScalarField.unknown,)
    current: State
    key: ClassVar[str] = "joule"  # type: ignore[misc]

    def __post_init__(self) -> None:
        is_potential = isinstance(self.current, State) and self.current.model.kinematics.has_value_in_strain
        require(is_potential, "JouleHeat: current", self.current, "give the state of an electric potential")

    def check(self, model: HostModel) -> None:
        electric, laws = self.current.model, [p.law.traits for p in self.current.model.terms]
        shapes = {(m.kinematics.has_axis, _is_extended(m.domain.joint)) for m in (electric, model)}
        pairs = [(layer, model.layers.get(name)) for name, layer in electric.layers.items()]
        is_thick = all(layer.thin_layer for layer, _ in pairs) and not electric.bonds
        is_alike = all(a.mesh_data[:2] == b.mesh_data[:2] for a, b in pairs if b and b.thin_layer)
        is_linear = all(not layer.thin_layer or layer.thin_layer.order < 2 for layer in model.layers.values())
        for is_met, wanted in (
            (np.array_equal(electric.joint.points, model.joint.points), "make both structures from one joint"),
            (all(t.proportional and not t.compiled for t in laws), "its conductivities must be numbers"),
            (len(shapes) == 1, "it needs plane= and bodies= of the model of heat"),
            (is_thick, "at S it needs a layer with a thickness, such as ThinLayer(Conduction(h * eps), eps)"),
            (all(b for _, b in pairs), "the structure of heat needs its layers, too, in place of bonds"),
            (is_alike, "its layers need the same thickness as those of heat"),
            (is_linear, "layers of heat of order 2 do not take the heat of a current; use order=1, or mesh them"),
        ):
            require(is_met, "JouleHeat: current", self.current, wanted)

    def work(self, model: HostModel, u: Expr, v: Expr) -> ufl.Form:
        electric = self.current.model
        potential = ufl.as_vector([self.current.field_on(model.coordinates)])
        terms = model.with_bodies(electric.body_laws).with_layer(electric.on_seams).terms
        powers = ((p, ufl.inner(stress(p, potential), p.strain(potential))) for p in terms)
        return reduce(add, (-power * scalar_value(p.strain(v)) * p.weight * p.measure for p, power in powers))

    def rigid_stiffness(self, model: HostModel, motions: list[fem.Function]) -> Array:  # type: ignore[override]
        return np.zeros((len(motions), len(motions)))

    def load_work(self, model: HostModel, state: Configuration) -> float:
        forms = compiled_functionals(-self.work(model, state.u, state.u))
        return float(model.comm.allreduce(sum(map(fem.assemble_scalar, forms))))

    def part(self, model: HostModel) -> FormPart:
        u, v = fem.Function(model.V), ufl.TestFunction(model.V)
        return FormPart(self.key, u, g=self.work(model, u, v), energy=self.work(model, u, u))


def _is_extended(joint: Joint) -> bool:
    """Return whether the bodies of a model's joint gave a part of themselves to the layers."""
    return joint.parted is not None or (joint.band is not None and joint.band.bodies == "extended")
