"""Structure, layer and goals made from an input file of the command `estimate` and its mesh file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from geometry.importing.reading import read
from geometry.joint import Joint
from thinlayer.discretisation.coefficient import Pressure
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import Layers, ThinLayer
from thinlayer.discretisation.point_loads import LineLoad, PointLoad
from thinlayer.discretisation.structure import Structure
from thinlayer.discretisation.time_functions import piecewise
from thinlayer.estimating.goals import (
    Compliance,
    Displacement,
    Goal,
    Inflow,
    MeanFlux,
    MeanTraction,
    PointValue,
    Reaction,
)
from thinlayer.parts.film import Film
from thinlayer.parts.inertia import Inertia
from thinlayer.running.description import Arguments, Description
from thinlayer.running.materials import MaterialEntry, Materials
from thinlayer.running.toml_table import TimeSeries
from thinlayer.solving.modes import Modes, modes
from thinlayer.system.ranks import errors_on_all

ResultType = TypeVar("ResultType")
# kind of a goal in a description -> its class
GOAL_CLASSES: Mapping[str, Callable[..., Goal]] = {
    "compliance": Compliance, "reaction": Reaction, "mean_traction": MeanTraction, "displacement": Displacement,
    "inflow": Inflow, "mean_flux": MeanFlux, "value": PointValue,
}  # fmt: skip
MIN_EPS_RATIO = 1e-9  # thickness over size of the bodies; rounding exceeds the effect of thinner layers


@dataclass(frozen=True)
class DescribedCase:
    """Structure, layer and goals of an estimate, made from an input file of the command `estimate` and its mesh file.

    Attributes:
        description: content of the input file.
        structure: the bodies with their supports and loads.
        layer: layer on all seams, or name of a seam -> its layer. The interface laws are of order 0, of a
            scalar field of order 1.
        goals: quantities whose change is estimated. Without goals in the input file it is the compliance.
    """

    description: Description
    structure: Structure
    layer: Layers
    goals: Sequence[Goal]

    @classmethod
    def from_description(cls, description: Description) -> DescribedCase:
        """Read the mesh file and make the structure, the layer and the goals. Collective.

        Args:
            description: content of the input file, which names the mesh file.

        Raises:
            DescriptionError: `geometry.read` refuses the mesh file or its arguments; or a layer is thicker than the
                size of the bodies, or thinner than 1e-9 of it.
            InputError: `Structure`, `ThinLayer` or a goal refuses an argument.
        """
        with description.file_table.locate_errors("mesh"):
            joint = read(description.mesh["path"], **{k: v for k, v in description.mesh.items() if k != "path"})
        size = joint.size
        for name, entry in description.layer.items():
            if not MIN_EPS_RATIO * size <= entry.eps <= size:
                text = f"{entry.eps:g}; allowed in bodies of size {size:.4g}: {MIN_EPS_RATIO * size:.2g} to {size:.4g}"
                description.file_table.refuse(text, *filter(None, ("layer", name, "eps")))
        layer = _map_all(description.layer, lambda m: ThinLayer(m.law, m.eps, eigenstrain=m.eigenstrain))
        goals = tuple(_make_goal(name, **goal) for name, goal in description.goals.items()) or (Compliance(),)
        return cls(description, _make_structure(description, joint), layer, goals)

    def make_model(self) -> InterfaceModel:
        """Make the interface model and check that every goal can be evaluated in it. Collective.

        Raises:
            InputError: the interface law does not suit the layer, or a goal cannot be evaluated.
        """
        model = self.structure.interface(self.layer, bodies=self.description.bodies)
        for name, goal in zip(self.description.goals or ("compliance",), self.goals, strict=True):
            with self.description.file_table.locate_errors("goals", name), errors_on_all(model.comm):
                goal.check(model)
        return model

    def modes(self, model: InterfaceModel) -> Modes | None:
        """Return the natural modes that the input file asks for, of a `model` with its densities. Collective."""
        if not self.description.modes:
            return None
        inertia = Inertia(self.description.density)
        with self.description.file_table.locate_errors("density"):
            inertia.check(model)
        return modes(model.with_parts([*model.parts, inertia]), self.description.modes)


def _make_structure(description: Description, joint: Joint) -> Structure:
    load_items, supports = _replace_series(description.tractions).items(), _replace_series(description.supports)
    tractions = {name: Pressure(load["pressure"]) if isinstance(load, Mapping) else load for name, load in load_items}
    loads = [(LineLoad if "first" in load else PointLoad)(**_replace_series(load)) for load in description.loads]
    strained_bodies = {name: entry for name, entry in description.body.items() if entry.eigenstrain is not None}
    eigenstrain = _map_all(strained_bodies, lambda entry: entry.eigenstrain) or None
    load_arguments: Arguments = {
        **{"tractions": tractions or None, "body_force": description.body_force, "loads": loads},
        **{"fluxes": _replace_series(description.fluxes) or None, "sources": description.sources},
        "initial": description.initial,
    }
    films = [Film(name, film["h"], _replace_series(film["T"])) for name, film in description.films.items()]
    body_args: Arguments = {"body": _map_all(description.body, lambda entry: entry.law), "eigenstrain": eigenstrain}
    plane, element = description.plane or "strain", description.element
    return Structure(joint, supports=supports, plane=plane, element=element, parts=films, **body_args, **load_arguments)


def _replace_series(value: object) -> Any:
    """Return `value` with each `TimeSeries` (table of values against time) replaced by a function of place and time.

    `value` may be a table of names and entries, also a nested one. The function is linear between the times of the
    series. Other values stay as they are.
    """
    if isinstance(value, Mapping):
        return {name: _replace_series(entry) for name, entry in value.items()}
    return piecewise(value.values) if isinstance(value, TimeSeries) else value


def _map_all(entries: Materials, make: Callable[[MaterialEntry], ResultType]) -> ResultType | dict[str, ResultType]:
    """Apply the function `make` to each material of the table `entries`, and return name -> result.

    If the table has the key None, its one material is for all bodies or seams. Then the result is returned without a
    name.
    """
    results = {name: make(entry) for name, entry in entries.items()}
    return results[None] if None in results else {name: value for name, value in results.items() if name is not None}


def _make_goal(name: str, kind: str, **arguments: Any) -> Goal:
    goal = GOAL_CLASSES[kind](**arguments)
    if name in (kind, goal.name):
        return goal
    renamed_goal: Goal = type("Renamed", (type(goal),), {"name": name})(**arguments)  # a subclass, for isinstance
    return renamed_goal
