"""Entries of a description, each read from its table and checked, without a mesh."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from forms.base import is_finite
from forms.law import BulkLaw
from thinlayer.describing.laws import law_of
from thinlayer.describing.section import Section, is_growing

Place = str | tuple[float, ...]
Vector = tuple[float, ...]

PLANES = ("strain", "stress", "axisymmetric")
ELEMENTS = ("P2", "Q2", "S2")  # of degree 2, as interface laws of order 1 need it
LAW = "the parameters of a law, such as E and nu"
GOALS = {
    "compliance": {},
    "reaction": {"place": True, "direction": True},
    "mean_traction": {"direction": True, "seam": False},
    "displacement": {"x": True, "direction": True, "side": False},
}  # kind -> its arguments: whether they must be given
ALWAYS = ("traction", "jump")  # quantities that every estimate has, besides goals


@dataclass(frozen=True)
class MeshFile:
    """A mesh file and how it is read, see `geometry.read`."""

    path: Path
    arguments: Mapping[str, Any]


@dataclass(frozen=True)
class Material:
    """A law with real parameters, and what else belongs to it.

    Attributes:
        law: the law.
        eps: thickness of a layer; None: of a body.
        eigenstrain: strain that it would have without stress; None: none.
        where: words for where it stands.
    """

    law: BulkLaw
    eps: float | None
    eigenstrain: float | None
    where: str


@dataclass(frozen=True)
class GoalGiven:
    """A quantity that is asked for: its kind in `GOALS`, its arguments, and words for where it stands."""

    kind: str
    arguments: Mapping[str, Any]
    where: str


@dataclass(frozen=True)
class Force:
    """A load at a point, or along the edge between two facet sets: arguments of `PointLoad` or `LineLoad`."""

    arguments: Mapping[str, Any]
    where: str


def place_of(text: str, section: Section) -> Place:
    """A place in the form of a key: the name of a facet set, or "(x, y)" for a vertex."""
    if not text.startswith("("):
        return text
    try:
        point = tuple(float(c) for c in text.strip("() ").split(","))
    except ValueError:
        point = ()
    if not re.fullmatch(r"\(.*\)", text) or len(point) not in (2, 3) or not all(map(is_finite, point)):
        section.refuse("a place is the name of a facet set, or the coordinates of a vertex, such as (40, 0)", text)
    return point


def given(section: Section, key: str) -> dict[str | None, Section]:
    """The tables of laws in body or layer, by name; None stands for all."""
    if not section.values.get(key):
        example = "E=210e3 nu=0.3" if key == "body" else "LinearElastic E=2000 nu=0.4 eps=0.2"
        section.refuse(f"{key} is missing: {LAW}, in a table [{key}] or by --{key} '{example}'")
    return section.named(key, LAW)


def mesh(section: Section) -> MeshFile:
    """The mesh file. S is all that is between `upper` and `lower` if these are given alone."""
    given = section.require("mesh", 'the name of a mesh file, in a description mesh = "joint.msh"')
    one = section.inner({"path": given} if isinstance(given, str) else given, "path and arguments of read", "mesh")
    one.allow(["path", "S", "upper", "lower", "direction", "scale"])
    one.require("path", "the name of a mesh file")
    arguments: dict[str, Any] = {key: one.texts(key) for key in ("upper", "lower") if key in one.values}
    if "direction" in one.values:
        arguments["direction"] = one.vector("direction")
    if "scale" in one.values:
        arguments["scale"] = one.positive("scale", "a factor on the coordinates")
    if isinstance(one.values.get("S"), Mapping):
        arguments["S"] = dict(one.values["S"])  # `read` checks the sides
    elif "S" in one.values:
        S = one.texts("S")
        arguments["S"] = [*S] if isinstance(S, tuple) else S
    elif {"upper", "lower"} <= one.values.keys():
        arguments["S"] = None  # all that is between them
    return MeshFile(Path(one.text("path") or ""), arguments)


def units(section: Section) -> tuple[str, str] | None:
    """Units of lengths and of stresses; None: not given."""
    text = section.text("units")
    if text is None:
        return None
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 2 or not all(parts):
        section.refuse(f"{text!r} are not two units; give those of lengths and of stresses, such as 'mm, MPa'", "units")
    return parts[0], parts[1]


def material(section: Section, *, thin: bool) -> Material:
    """A law of a body, or of a layer with its thickness."""
    law = law_of(section, ["eps", "eigenstrain"] if thin else ["eigenstrain"])
    eps = section.positive("eps", "the thickness of the layer, a length") if thin else None
    return Material(law, eps, section.number("eigenstrain"), section.where())


def supports(section: Section) -> dict[Place, Any]:
    """Place -> a number, or components."""
    found: dict[Place, Any] = {}
    for key, value in section.values.items():
        place = place_of(key, section)
        if isinstance(value, Mapping):
            one = section.table(key, "components")
            one.allow(["x", "y", "z", *(["n"] if isinstance(place, str) else [])], "component")
            found[place] = {axis: one.history(axis, Section.number) for axis in value}
            if not found[place]:
                section.refuse("no component is given, such as {x = 0}", key)
        else:
            found[place] = section.number(key)
    return found


def tractions(section: Section) -> dict[str, Any]:
    """Name of a facet set -> components, or {"pressure": number}."""
    found: dict[str, Any] = {}
    for key in section.values:
        found[key] = section.history(key, _traction)
    return found


def _traction(section: Section, key: str) -> Any:
    value = section.values[key]
    if isinstance(value, Mapping):
        one = section.table(key, "pressure")
        one.allow(["pressure"])
        one.require("pressure", "a stress, > 0 where it presses")
        return {"pressure": one.history("pressure", Section.number)}
    if is_finite(value):
        section.refuse(f"{value:g} is no vector; give its components, or {{pressure = {value:g}}}", key)
    return section.vector(key)


def body_force(section: Section) -> Vector | dict[str, Vector] | None:
    """Components, or region or seam -> components."""
    if "body_force" not in section.values:
        return None
    if not isinstance(section.values["body_force"], Mapping):
        return section.vector("body_force")
    one = section.table("body_force", "names of regions and seams")
    return {name: one.vector(name) for name in one.values}


def load(section: Section) -> Force:
    """A force at a point, or per length of edges."""
    line = "first" in section.values or "second" in section.values
    section.allow(["first", "second", "force", "body"] if line else ["place", "force", "body"])
    where = ("first", "second") if line else ("place",)
    for key in (*where, "force"):
        section.require(key, "the vector of the force" if key == "force" else "where the load acts")
    found: dict[str, Any] = {key: section.text(key) if line else section.vector(key) for key in where}
    found["force"] = section.history("force", Section.vector)
    if "body" in section.values:
        found["body"] = section.text("body")
    return Force(found, section.where())


def element(section: Section) -> str | None:
    """The finite element, of degree 2; None: not given."""
    name = section.text("element")
    if name not in (None, *ELEMENTS):
        section.refuse(
            f"{name} is not of degree 2, which the better law needs; allowed: {', '.join(ELEMENTS)}", "element"
        )
    return name


def bodies(section: Section) -> str:
    """How bodies make room for the layer."""
    return section.text("bodies", ("kept", "extended")) or "kept"


def times(section: Section) -> tuple[float, ...]:
    """Times of steps; () if there are none."""
    times = section.values.get("times", ())
    if not is_growing(times) or (times and times[0] <= 0):
        section.refuse(f"{times!r} are no times; give numbers > 0 that grow, such as [0.5, 1]", "times")
    return tuple(float(t) for t in times)


def goals(section: Section) -> dict[str, GoalGiven]:
    """Name -> what is asked for."""
    goals, found = section.table("goals", "names with what they ask for, such as compliance = true"), {}
    for name, value in goals.values.items():
        if name in ALWAYS:
            goals.refuse("this quantity is told of every layer; give a goal another name", name)
        one = goals.inner({} if value is True else value, "arguments of a goal, or is true", name)
        kind = one.text("kind", GOALS) or name
        if kind not in GOALS:
            goals.refuse(f"what is asked for? give kind, one of {', '.join(GOALS)}, or one of them as the key", name)
        arguments = GOALS[kind]
        one.allow(["kind", *arguments], f"key of {kind}")
        for key, needed in arguments.items():
            if needed:
                one.require(key, f"{kind} has {', '.join(arguments)}")
        read = {
            key: one.vector(key) if key in ("direction", "x") else one.text(key) for key in arguments if key in value
        }
        if "side" in read:
            one.text("side", ("lower", "upper"))
        found[name] = GoalGiven(kind, read, one.where())
    return found


def tolerance(section: Section, quantities: list[str]) -> dict[str, float]:
    """Quantity -> its largest relative change; a number alone is that of the traction."""
    value = section.values.get("tolerance")
    if value is None:
        return {}
    what = "the largest relative change that is allowed, between 0 and 1"
    one = section.inner(value if isinstance(value, Mapping) else {"traction": value}, what, "tolerance")
    one.allow(quantities, "quantity")
    for name in one.values:
        if one.positive(name, what) >= 1:
            one.refuse(f"{one.values[name]!r} is not < 1; it is {what}", name)
    return {name: float(one.values[name]) for name in one.values}
