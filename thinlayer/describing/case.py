"""A case: a structure with its layer, and what is asked of it; made of a description and its mesh file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from geometry.importing.reading import read
from geometry.joint import Joint
from thinlayer.describing.checks import require_fit
from thinlayer.describing.description import Description
from thinlayer.describing.entries import GoalGiven, Material
from thinlayer.describing.section import History
from thinlayer.discretisation.clock import piecewise
from thinlayer.discretisation.given import Pressure
from thinlayer.discretisation.layer import Layers, ThinLayer
from thinlayer.discretisation.point_loads import LineLoad, PointLoad
from thinlayer.discretisation.structure import Structure
from thinlayer.estimating import goals as kinds
from thinlayer.estimating.goals import Goal

GOALS = {
    "compliance": kinds.Compliance,
    "reaction": kinds.Reaction,
    "mean_traction": kinds.MeanTraction,
    "displacement": kinds.Displacement,
}


@dataclass(frozen=True)
class Case:
    """A structure with its layer, and what is asked of it.

    Attributes:
        structure: the structure.
        layer: its layer, or {name of a seam: its layer}, order 0.
        goals: quantities whose change is told.
        bodies: "kept" or "extended", as in `Structure.interface`.
        times: times of steps; (): one solve.
        tolerance: "traction", "jump" or name of a goal -> its largest relative change.
        bonded: whether to ask as well if the layer may be left out altogether.
        units: of lengths and of stresses; None: not given.
    """

    structure: Structure
    layer: Layers
    goals: Sequence[Goal] = (kinds.Compliance(),)
    bodies: str = "kept"
    times: tuple[float, ...] = ()
    tolerance: Mapping[str, float] = field(default_factory=dict)
    bonded: bool = False
    units: tuple[str, str] | None = None

    @classmethod
    def of(cls, given: Description) -> Case:
        """The case that is described. Collective.

        Raises:
            DescriptionError: a name that the mesh does not have, or vectors of another dimension: before anything else.
            GeometryError, ModelError, LawError: as `read`, `Structure` and `ThinLayer` raise them.
        """
        joint = read(given.mesh.path, **given.mesh.arguments)
        require_fit(given, joint)
        return cls(
            _structure(given, joint),
            _by_name(given.layer, _layer),
            tuple(_goal(one, name) for name, one in given.goals.items()) or (kinds.Compliance(),),
            given.bodies,
            given.times,
            given.tolerance,
            given.bonded,
            given.units,
        )


def _structure(given: Description, joint: Joint) -> Structure:
    tractions = {
        name: Pressure(_timed(load["pressure"])) if isinstance(load, Mapping) else _timed(load)
        for name, load in given.tractions.items()
    }
    supports: Any = {
        place: {axis: _timed(value) for axis, value in one.items()} if isinstance(one, Mapping) else one
        for place, one in given.supports.items()
    }
    eigenstrain: Any = {name: one.eigenstrain for name, one in given.body.items() if one.eigenstrain is not None}
    loads: list[Any] = [_load(one.arguments) for one in given.loads]
    return Structure(
        joint,
        body=_by_name(given.body, lambda one: one.law),
        supports=supports,
        tractions=tractions,
        body_force=given.body_force,
        loads=loads,
        plane=given.plane or "strain",
        element=given.element,
        eigenstrain=eigenstrain.get(None, eigenstrain) or None,
    )


def _load(arguments: Mapping[str, Any]) -> PointLoad | LineLoad:
    timed = {**arguments, "force": _timed(arguments["force"])}
    return LineLoad(**timed) if "first" in timed else PointLoad(**timed)


def _timed(value: Any) -> Any:
    """A value, or the function of time that a history is."""
    return piecewise(value.values) if isinstance(value, History) else value


def _by_name(given: Mapping[str | None, Material], make: Any) -> Any:
    """The only entry, or {name: entry}."""
    made = {name: make(one) for name, one in given.items()}
    return made.get(None, made)


def _layer(one: Material) -> ThinLayer:
    assert one.eps is not None
    return ThinLayer(one.law, one.eps, eigenstrain=one.eigenstrain)


def _goal(one: GoalGiven, name: str) -> Goal:
    made = GOALS[one.kind](**one.arguments)
    return made if name in (one.kind, made.name) else Called(name, made)


@dataclass(frozen=True)
class Called(Goal):
    """A goal under another name."""

    name: str
    goal: Goal

    def check(self, model: Any) -> None:
        """As in `Goal`."""
        self.goal.check(model)

    def value(self, state: Any, model: Any) -> float:
        """As in `Goal`."""
        return self.goal.value(state, model)

    def scale(self, state: Any, model: Any) -> float:
        """As in `Goal`."""
        return self.goal.scale(state, model)

    def dual(self, adjoint: Any) -> Any:
        """As in `Goal`."""
        return self.goal.dual(adjoint)
