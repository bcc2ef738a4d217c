"""What a description says: a mesh file, laws, supports, loads, and what is asked; checked, without a mesh.

Its keys are the names of arguments of the package: of `geometry.read` in [mesh], of `Structure`, of `ThinLayer` in [layer],
and of `goals`. All moduli are real ones; a layer's are divided by its thickness when the layer is made.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from forms.base import is_finite
from thinlayer.describing.materials import Material, materials
from thinlayer.describing.section import History, Keys, Section, is_growing, read

Place = str | tuple[float, ...]
Vector = tuple[float, ...]

GOALS = {
    "compliance": {},
    "reaction": {"place": True, "direction": True},
    "mean_traction": {"direction": True, "seam": False},
    "displacement": {"x": True, "direction": True, "side": False},
}  # kind -> its arguments: whether they must be given
ALWAYS = ("traction", "jump")  # quantities that every estimate has, besides goals


@dataclass(frozen=True)
class Description:
    """A structure with a thin layer, and what is asked of it.

    Attributes:
        section: the whole table, for words about where entries stand.
        mesh: arguments of `geometry.read`.
        units: of lengths and of stresses, as texts; None: not given.
        body: region -> its law; None stands for all.
        layer: seam -> its law and thickness; None stands for all.
        supports: place -> prescribed displacements, as in `Structure`.
        tractions: name of a facet set -> components, or {"pressure": number}.
        body_force: components, or region or seam -> components; None: none.
        loads: arguments of `PointLoad` or `LineLoad`.
        plane, element: as in `Structure`; None: its default.
        bodies: "kept" or "extended", as in `Structure.interface`.
        times: times of steps for laws with a rate or a memory; (): one solve.
        goals: name -> kind and arguments of a quantity whose change is told.
        tolerance: quantity -> its largest relative change, for the thickness below which the layer may be dropped.
        bonded: whether to ask as well if the layer may be left out altogether.
    """

    section: Section
    mesh: Mapping[str, Any]
    units: tuple[str, str] | None
    body: Mapping[str | None, Material]
    layer: Mapping[str | None, Material]
    supports: Mapping[Place, Any]
    tractions: Mapping[str, Any]
    body_force: Vector | Mapping[str, Vector] | None
    loads: tuple[Mapping[str, Any], ...]
    plane: str | None
    element: str | None
    bodies: str
    times: tuple[float, ...]
    goals: Mapping[str, Mapping[str, Any]]
    tolerance: Mapping[str, float]
    bonded: bool

    @classmethod
    def read(cls, path: Path, settings: Iterable[str] = ()) -> Description:
        """The description in a file, with keys set anew, see `section.read`.

        Raises:
            DescriptionError: where, what is wrong, and what is allowed.
        """
        section = read(path, settings)
        section.allow(KEYS)
        goals = _goals(section)
        bonded = section.values.get("bonded", False)
        if not isinstance(bonded, bool):
            section.refuse(f"{bonded!r} is neither true nor false", "bonded")
        found = cls(
            section,
            _mesh(section),
            _units(section),
            materials(section, "body", thin=False),
            materials(section, "layer", thin=True),
            _supports(section.table("supports", "places with what they prescribe, such as LEFT = 0")),
            _tractions(section.table("tractions", "names of facet sets with a vector, such as TOP = [0, -50]")),
            _body_force(section),
            tuple(_load(one) for one in section.tables("loads", "place and force, or first, second and force")),
            section.text("plane", ("strain", "stress", "axisymmetric")),
            section.text("element", ("P2", "Q2", "S2")),  # of degree 2, as interface laws of order 1 need it
            section.text("bodies", ("kept", "extended")) or "kept",
            _times(section),
            goals,
            _tolerance(section, [*ALWAYS, *(goals or ["compliance"])]),
            bonded,
        )
        found._require_loads()
        found._require_times()
        if found.tolerance and None not in found.layer:
            section.refuse("a thickness is sought of one layer for all seams; give [layer] without names", "tolerance")
        return found

    @property
    def histories(self) -> dict[Keys, History]:
        """Keys of each value that is given by times -> its history."""
        loads = dict(enumerate(self.loads, 1))
        return dict(_histories({"supports": self.supports, "tractions": self.tractions, "loads": loads}))

    def _require_loads(self) -> None:
        supports = [v for one in self.supports.values() for v in (one.values() if isinstance(one, Mapping) else [one])]
        strained = any(one.eigenstrain for one in (*self.body.values(), *self.layer.values()))
        if not (self.tractions or self.body_force or self.loads or any(supports) or strained):
            self.section.refuse("nothing loads the structure; give tractions, body_force, loads, or supports that move")

    def _require_times(self) -> None:
        """Raise DescriptionError unless times are there if they are needed, and histories reach from 0 to the last one."""
        slow = [one.law for one in (*self.layer.values(), *self.body.values()) if one.law.traits.rate]
        if slow and not self.times:
            self.section.refuse(
                f"times is missing: {type(slow[0]).__name__} depends on the rate of strains; give ends of time steps"
            )
        for keys, one in self.histories.items():
            first, last = min(one.values), max(one.values)
            if not self.times:
                self.section.refuse("a history needs times, the ends of time steps", *keys)
            if first > 0 or last < self.times[-1]:
                reach = f"it is given from {first:g} to {last:g}, and times go from 0 to {self.times[-1]:g}"
                self.section.refuse(reach, *keys)


KEYS = tuple(one.name for one in fields(Description))[1:]


def _histories(value: Any, *keys: str) -> Iterator[tuple[Keys, History]]:
    """Histories in tables in tables, with the keys that lead to them."""
    if isinstance(value, History):
        yield keys, value
    for key, inner in value.items() if isinstance(value, Mapping) else ():
        yield from _histories(inner, *keys, str(key))


def _mesh(section: Section) -> dict[str, Any]:
    """Arguments of `read`. S is all that is between `upper` and `lower` if these are given alone."""
    what = 'the name of a mesh file, mesh = "joint.msh"'
    given = section.require("mesh", what)
    one = section.inner({"path": given} if isinstance(given, str) else given, "path and arguments of read", "mesh")
    one.allow(["path", "S", "upper", "lower", "direction", "scale"])
    one.require("path", what)
    found: dict[str, Any] = {"path": one.text("path")}
    found |= {key: one.texts(key) for key in ("upper", "lower") if key in one.values}
    if "direction" in one.values:
        found["direction"] = one.vector("direction")
    if "scale" in one.values:
        found["scale"] = one.positive("scale", "a factor on the coordinates")
    if "S" in one.values:  # of a table `read` checks the sides
        found["S"] = one.values["S"] if isinstance(one.values["S"], Mapping) else one.texts("S")
    elif {"upper", "lower"} <= one.values.keys():
        found["S"] = None
    return found


def _units(section: Section) -> tuple[str, str] | None:
    text = section.text("units")
    if text is None:
        return None
    lengths, _, stresses = map(str.strip, text.partition(","))
    if not lengths or not stresses or "," in stresses:
        section.refuse(f"{text!r} are not two units; give those of lengths and of stresses, such as 'mm, MPa'", "units")
    return lengths, stresses


def _supports(section: Section) -> dict[Place, Any]:
    """Place -> a number, or components."""
    found: dict[Place, Any] = {}
    for key, value in section.values.items():
        place = _place(key, section)
        if isinstance(value, Mapping):
            one = section.table(key, "components")
            one.allow(["x", "y", "z", *(["n"] if isinstance(place, str) else [])], "component")
            found[place] = {axis: one.history(axis, Section.number) for axis in value}
            if not value:
                section.refuse("no component is given, such as {x = 0}", key)
        else:
            found[place] = section.number(key)
    return found


def _place(text: str, section: Section) -> Place:
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


def _tractions(section: Section) -> dict[str, Any]:
    """Name of a facet set -> components, or {"pressure": number}."""

    def traction(section: Section, key: str) -> Any:
        value = section.values[key]
        if isinstance(value, Mapping):
            one = section.table(key, "pressure")
            one.allow(["pressure"])
            one.require("pressure", "a stress, > 0 where it presses")
            return {"pressure": one.history("pressure", Section.number)}
        if is_finite(value):
            section.refuse(f"{value:g} is no vector; give its components, or {{pressure = {value:g}}}", key)
        return section.vector(key)

    return {key: section.history(key, traction) for key in section.values}


def _body_force(section: Section) -> Vector | dict[str, Vector] | None:
    """Components, or region or seam -> components."""
    if "body_force" not in section.values:
        return None
    if not isinstance(section.values["body_force"], Mapping):
        return section.vector("body_force")
    one = section.table("body_force", "names of regions and seams")
    return {name: one.vector(name) for name in one.values}


def _load(section: Section) -> dict[str, Any]:
    """A force at a point, or per length of edges."""
    line = "first" in section.values or "second" in section.values
    where = ("first", "second") if line else ("place",)
    section.allow([*where, "force", "body"])
    for key in (*where, "force"):
        section.require(key, "the vector of the force" if key == "force" else "where the load acts")
    found: dict[str, Any] = {key: section.text(key) if line else section.vector(key) for key in where}
    found["force"] = section.history("force", Section.vector)
    return found | ({"body": section.text("body")} if "body" in section.values else {})


def _times(section: Section) -> tuple[float, ...]:
    times = section.values.get("times", [])
    if not is_growing(times) or (times and times[0] <= 0):
        section.refuse(f"{times!r} are no times; give numbers > 0 that grow, such as [0.5, 1]", "times")
    return tuple(float(t) for t in times)


def _goals(section: Section) -> dict[str, dict[str, Any]]:
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
        one.text("side", ("lower", "upper"))
        read = {
            key: one.vector(key) if key in ("direction", "x") else one.text(key)
            for key in arguments
            if key in one.values
        }
        found[name] = {"kind": kind, **read}
    return found


def _tolerance(section: Section, quantities: list[str]) -> dict[str, float]:
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
