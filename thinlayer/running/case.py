"""A case made from a description and its mesh file: a structure with its layer, and goals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from geometry.importing.reading import read
from geometry.joint import Joint
from thinlayer.discretisation.coefficient import Pressure
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import Layers, ThinLayer
from thinlayer.discretisation.point_loads import LineLoad, PointLoad
from thinlayer.discretisation.structure import Structure
from thinlayer.discretisation.time_functions import piecewise
from thinlayer.estimating import goals as kinds
from thinlayer.estimating.goals import Goal
from thinlayer.running.description import Description
from thinlayer.running.materials import MaterialEntry
from thinlayer.running.toml_table import TimeSeries
from thinlayer.system.ranks import errors_on_all

MIN_THICKNESS = 1e-9  # thickness over size of the bodies; rounding exceeds the effect of thinner layers


@dataclass(frozen=True)
class DescribedCase:
    """A structure with its layer, and goals.

    Attributes:
        description: the description, with times, tolerances and units.
        structure: the structure.
        layer: its layer, or {name of a seam: its layer}, order 0.
        goals: quantities whose change is estimated.
    """

    description: Description
    structure: Structure
    layer: Layers
    goals: Sequence[Goal]

    @classmethod
    def of(cls, description: Description) -> DescribedCase:
        """Make the case of a description. Collective.

        Raises:
            DescriptionError: a thickness is negligible against the size of the bodies, or larger.
            InputError: as `read`, `Structure` and `ThinLayer` raise them.
        """
        of_file = dict(description.mesh)
        with description.section.described("mesh"):
            joint = read(of_file.pop("path"), **of_file)
        size = joint.size
        for name, entry in description.layer.items():
            if not MIN_THICKNESS * size <= entry.eps <= size:
                what = f"{entry.eps:g}; allowed beside bodies of {size:.4g}: {MIN_THICKNESS * size:.2g} to {size:.4g}"
                description.section.refuse(what, "layer", *([name] if name else []), "eps")
        layer = _by_name(description.layer, lambda m: ThinLayer(m.law, m.eps, eigenstrain=m.eigenstrain))
        goals = tuple(_goal(name, **goal) for name, goal in description.goals.items()) or (kinds.Compliance(),)
        return cls(description, _structure(description, joint), layer, goals)

    def model(self) -> InterfaceModel:
        """Return the interface model, after each goal has checked that it can be evaluated there. Collective.

        Raises:
            InputError: as the model and the goals raise it.
        """
        model = self.structure.interface(self.layer, bodies=self.description.bodies)
        for name, goal in zip(self.description.goals or ("compliance",), self.goals, strict=True):
            with self.description.section.described("goals", name), errors_on_all(model.comm):
                goal.check(model)
        return model


def _structure(description: Description, joint: Joint) -> Structure:
    supports, loads_on = _timed(description.supports), _timed(description.tractions).items()
    tractions = {name: Pressure(load["pressure"]) if isinstance(load, Mapping) else load for name, load in loads_on}
    strains: Any = {name: body.eigenstrain for name, body in description.body.items() if body.eigenstrain is not None}
    loads: list[Any] = [(LineLoad if "first" in load else PointLoad)(**_timed(load)) for load in description.loads]
    bodies = {"body": _by_name(description.body, lambda m: m.law), "eigenstrain": strains.get(None, strains) or None}
    loaded = {"supports": supports, "tractions": tractions, "body_force": description.body_force, "loads": loads}
    return Structure(joint, plane=description.plane or "strain", element=description.element, **bodies, **loaded)


def _timed(value: Any) -> Any:
    """Return a value, in which functions of time replace histories, also in tables."""
    if isinstance(value, Mapping):
        return {name: _timed(entry) for name, entry in value.items()}
    return piecewise(value.values) if isinstance(value, TimeSeries) else value


def _by_name(entries: Mapping[str | None, MaterialEntry], make: Any) -> Any:
    """Apply `make` to the entries; return the result for all names if there is one, else {name: result}."""
    made = {name: make(entry) for name, entry in entries.items()}
    return made.get(None, made)


def _goal(name: str, kind: str, **arguments: Any) -> Goal:
    made: Goal = getattr(kinds, kind.title().replace("_", ""))(**arguments)
    if name in (kind, made.name):
        return made
    called: Any = type("Called", (type(made),), {"name": name})  # a subclass: isinstance still finds its kind
    return called(**arguments)
