"""Input file in TOML of the command `estimate`: mesh file, laws, supports, loads and goals.

The file is called a description. Its entries are checked without reading the mesh. Most keys are names of arguments: of
`geometry.read` in the table [mesh], of `ThinLayer` in [layer], of the classes of goals in [goals], of `Structure`
elsewhere. Moduli of layers are those of the material, not divided by the thickness.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from forms.base import is_integer
from thinlayer.running.materials import Materials, material_schema, materials_reader
from thinlayer.running.quantities import UNITS, with_numbers, with_unit_texts
from thinlayer.running.toml_table import (
    NUMBER,
    TEXT,
    TEXTS,
    VECTOR,
    Keys,
    Reader,
    Schema,
    TimeSeries,
    TomlTable,
    attribute_texts,
    choice_reader,
    is_increasing,
    names_reader,
    positive_reader,
    read_input_file,
    series_reader,
    table_or_other_reader,
    variants_schema,
)

Place = str | tuple[float, ...]
Vector = tuple[float, ...]
Support = float | Mapping[str, float | TimeSeries]  # one number for all components, or component -> number
Traction = Vector | TimeSeries | Mapping[str, float | TimeSeries]  # components, or {"pressure": number}
Arguments = Mapping[str, Any]  # arguments of a function of the package, by name

GOAL_READERS: dict[str, dict[str, Reader]] = {
    "compliance": {},
    "reaction": {"place": TEXT, "direction": VECTOR},
    "mean_traction": {"direction": VECTOR, "seam": TEXT},
    "displacement": {"x": VECTOR, "direction": VECTOR, "side": choice_reader("lower", "upper")},
    "inflow": {"place": TEXT},
    "mean_flux": {"seam": TEXT},
    "value": {"x": VECTOR, "side": choice_reader("lower", "upper")},
}  # kind of goal -> readers of its arguments
STANDARD_QUANTITIES = ("traction", "flux", "jump")  # quantities that every estimate has, in addition to goals


@dataclass(frozen=True)
class Description:
    """Content of an input file of the command `estimate`: a structure with a thin layer, and quantities of interest.

    The change of these quantities is estimated if the layer is not meshed.

    Attributes:
        file_table: all tables of the input file as read, by which errors name the entry they are about.
        mesh: arguments of `geometry.read` by name; "path" is the path of the mesh file.
        body: name of a region -> its law and eigenstrain; the key None stands for all regions.
        layer: name of a seam -> law, eigenstrain and thickness of its layer; the key None stands for all seams.
        units: names of the units of lengths, of stresses and perhaps of times; they are printed, and texts such as
            "2 GPa" become numbers in these units. None: no names.
        supports: name of a facet set or coordinates of a vertex -> prescribed displacement. It is one number for all
            components, or a table of component -> number.
        tractions: name of a facet set -> components of the traction, or {"pressure": number}.
        body_force: components of the force per volume, or name of a region or seam -> components; None: no force.
        fluxes: for a scalar field, name of a facet set -> flux into the body.
        sources: what is released per volume and time, a number, or name of a region or seam -> number; None: nothing.
        films: name of a facet set -> "h" and "T" of a `Film`.
        initial: value of a scalar field before the first of `times`; None: not given.
        loads: for each concentrated load, the arguments of `PointLoad` or `LineLoad` by name.
        plane: "strain", "stress" or "axisymmetric", for plane meshes; None: plane strain.
        element: finite element of the displacements, "P2", "Q2" or "S2"; None: the default of `Structure`.
        bodies: "kept" (the meshed layer would move the bodies apart) or "extended" (it would be cut out of them).
        times: ends of the time steps, for laws with a rate or a memory; (): the structure is solved once, at t = 0.
        goals: name -> "kind" and further arguments of a quantity of interest.
        tolerance: name of a quantity -> its largest allowed relative change, < 1. The command then also looks for the
            thickness of the layer below which the change is smaller.
        bonded: whether to estimate, too, what changes if the layer is left out and the bodies are bonded.
        continuum: whether to bound the goals for any mesh, too, see `Estimate.continuum`.
        density: name of each body and each seam with a layer -> mass per volume, for `modes`; see `Inertia`.
        modes: number of natural modes whose frequencies are computed, and estimated with the layer meshed; 0: none.
        sensitivities: names of parameters by which the goals are differentiated, see `derivative`; True: all.
    """

    file_table: TomlTable
    mesh: Arguments
    body: Materials
    layer: Materials
    units: tuple[str, ...] | None = None
    supports: Mapping[Place, Support] = field(default_factory=dict)
    tractions: Mapping[str, Traction] = field(default_factory=dict)
    body_force: Vector | Mapping[str, Vector] | None = None
    fluxes: Mapping[str, float | TimeSeries] = field(default_factory=dict)
    sources: float | Mapping[str, float] | None = None
    films: Mapping[str, Arguments] = field(default_factory=dict)
    initial: float | None = None
    loads: Sequence[Arguments] = ()
    plane: str | None = None
    element: str | None = None
    bodies: str = "kept"
    times: tuple[float, ...] = ()
    goals: Mapping[str, Arguments] = field(default_factory=dict)
    tolerance: Mapping[str, float] = field(default_factory=dict)
    bonded: bool = False
    continuum: bool = False
    density: Mapping[str, float] = field(default_factory=dict)
    modes: int = 0
    sensitivities: Sequence[str] | bool = False

    @classmethod
    def read(cls, path: Path, settings: Sequence[str] = ()) -> Description:
        """Read an input file, check its entries, and return its content.

        Args:
            path: the file, in TOML.
            settings: texts "KEY=VALUE" that replace entries of the file, such as "layer.E=2e3".

        Raises:
            DescriptionError: an entry is wrong or missing; the message says which one, what is wrong, and what is
                allowed.
        """
        file_table = with_numbers(read_input_file(path, settings))
        description = cls(file_table, **file_table.entries(ENTRY_KEYS))
        motions = [v for u in description.supports.values() for v in (u.values() if isinstance(u, Mapping) else [u])]
        has_strain = any(entry.eigenstrain for entry in (*description.body.values(), *description.layer.values()))
        forces = description.tractions or description.body_force or description.loads
        flows = description.fluxes or description.sources or description.films
        if not (forces or flows or any(motions) or has_strain):
            file_table.refuse("nothing loads the structure; give tractions, body_force, loads, or supports that move")
        description._require_times()
        if bool(description.density) != bool(description.modes):
            what, key = ("density", "modes") if description.modes else ("modes", "density")
            file_table.refuse(f"it needs {what}, too: modes = 6 and a table [density] of bodies and seams", key)
        if description.tolerance and None not in description.layer:
            file_table.refuse("a tolerance needs one layer for all seams; give [layer] without names", "tolerance")
        return description

    def _require_times(self) -> None:
        """Check that the entry `times` suits the loads and supports that depend on time.

        Raises:
            DescriptionError: a load or support depends on time, and `times` is missing; or its values do not cover the
                interval from 0 to the last of `times`.
        """
        for series in self.file_table.time_series:
            start, end = min(series.values), max(series.values)
            if not self.times:
                self.file_table.refuse("a time series needs times, the ends of time steps", *series.key_path)
            if start > 0 or end < self.times[-1]:
                text = f"the time series is from {start:g} to {end:g}; it must cover the times 0 to {self.times[-1]:g}"
                self.file_table.refuse(text, *series.key_path)


def description_schema() -> Schema:
    """Return the JSON schema of input files of `estimate`, by which editors complete and check them."""
    schema = ENTRY_KEYS.schema(attribute_texts(Description))
    entries = {key: with_unit_texts(entry, key) for key, entry in schema["properties"].items()}
    definitions = {"material": with_unit_texts(material_schema(), "material")}
    draft = {"$schema": "http://json-schema.org/draft-07/schema#", "title": "Input file of thinlayer's estimate"}
    return {**draft, **schema, "properties": entries, "definitions": definitions}


MESH_HINT, LAW_HINT = (
    'the name of a mesh file, mesh = "joint.msh"',
    "the parameters of a law, such as E and nu, in a table",
)
# one name of a facet set, several, or a table with the sides of each seam by its name, which `geometry.read` checks
FACETS = table_or_other_reader(Reader(lambda section, key: section.values[key], {"type": "object"}), TEXTS)
MESH_KEYS = Keys(
    {"path": TEXT, "S": FACETS, "upper": TEXTS, "lower": TEXTS, "direction": VECTOR, "names": FACETS, "regions": TEXT}
    | {"join": positive_reader("a part of the size"), "scale": positive_reader("a factor")},
    {"path": MESH_HINT},
)


def _read_mesh(section: TomlTable, key: str) -> Arguments:
    """Read the mesh entry of the input file, and return the arguments of `geometry.read` by name.

    With regions in `upper` and `lower`, `S` is set to None if it is missing. S then consists of all facets between
    these regions.

    Args:
        section: the whole input file.
        key: "mesh". Its value is the path of the mesh file, or a table of arguments.
    """
    value = section.values[key]
    table = section.as_table({"path": value} if isinstance(value, str) else value, "path and arguments of read", key)
    arguments = table.entries(MESH_KEYS)
    return {"S": None, **arguments} if {"upper", "lower"} <= arguments.keys() else arguments


def _read_supports(section: TomlTable, key: str) -> dict[Place, Support]:
    """Read the supports, a table at `key` in the input file `section`.

    Returns:
        Name of a facet set, or coordinates of a vertex -> prescribed displacement. It is one number for all components,
        or component -> number or values in time. Components are "x", "y", "z" and, on a facet set, "n", along its
        normal.
    """
    return {_parse_place(name): support for name, support in SUPPORTS(section, key).items()}


def _parse_place(text: str) -> Place:
    """Return where a support is, from its key `text` in the input file: the coordinates of a vertex, or a facet set.

    A text such as "(1, 0)" stands for a vertex; any other text is the name of a facet set.
    """
    if text.startswith("(") and text.endswith(")"):
        with suppress(ValueError):
            return tuple(float(c) for c in text[1:-1].split(","))
    return text


def _read_components(section: TomlTable, key: str) -> dict[str, float | TimeSeries]:
    keys = FACET_COMPONENTS if isinstance(_parse_place(key), str) else VERTEX_COMPONENTS
    if not section.values[key]:
        section.refuse("it has no components; give some, such as {x = 0}", key)
    return section.table(key, "components").entries(keys, kind="component")


FACET_COMPONENTS, VERTEX_COMPONENTS = (Keys(dict.fromkeys(names, series_reader(NUMBER))) for names in ("xyznT", "xyzT"))
COMPONENTS = Reader(_read_components, {**FACET_COMPONENTS.schema(), "minProperties": 1})
SUPPORTS = names_reader(table_or_other_reader(COMPONENTS, NUMBER), "places with what they prescribe, such as LEFT = 0")
PRESSURE_KEYS = Keys({"pressure": series_reader(NUMBER)}, {"pressure": "a stress, > 0 where it presses"})
PRESSURE = Reader(lambda section, key: section.table(key, "pressure").entries(PRESSURE_KEYS), PRESSURE_KEYS.schema())
TRACTION = series_reader(table_or_other_reader(PRESSURE, VECTOR))
FLOW = series_reader(NUMBER)
FILM_KEYS = Keys(
    {"h": positive_reader("flux over difference of values"), "T": FLOW},
    {"h": "the transfer coefficient, > 0", "T": "the value of the surroundings"},
)
FILM = Reader(lambda section, key: section.table(key, "h and T").entries(FILM_KEYS), FILM_KEYS.schema())
LOAD_READERS = {"force": series_reader(VECTOR), "body": TEXT}
LOAD_HINTS = {**dict.fromkeys(("place", "first", "second"), "where the load acts"), "force": "the vector of the force"}
POINT_LOAD_KEYS, LINE_LOAD_KEYS = (
    Keys({**places, **LOAD_READERS}, {key: LOAD_HINTS[key] for key in (*places, "force")})
    for places in ({"place": VECTOR}, {"first": TEXT, "second": TEXT})
)


def _read_loads(section: TomlTable, key: str) -> tuple[Arguments, ...]:
    """Read the concentrated loads, a list of tables at `key` in the input file `section`.

    Returns:
        For each load, arguments by name: those of `LineLoad` if its table names a first and a second facet set, else
        those of `PointLoad`.
    """
    tables = section.tables(key, "place and force, or first, second and force")
    keys = [LINE_LOAD_KEYS if {"first", "second"} & table.values.keys() else POINT_LOAD_KEYS for table in tables]
    return tuple(table.entries(table_keys) for table, table_keys in zip(tables, keys, strict=True))


def _read_times(section: TomlTable, key: str) -> tuple[float, ...]:
    wrong = "are not times; give numbers > 0 that grow, such as [0.5, 1]"
    return tuple(map(float, section.checked(key, lambda times: times and is_increasing(times) and times[0] > 0, wrong)))


def _read_goals(section: TomlTable, key: str) -> dict[str, Arguments]:
    table = section.table(key, "names with what they ask for, such as compliance = true")
    arguments: dict[str, Arguments] = {}
    for name, value in table.values.items():
        if name in STANDARD_QUANTITIES:
            table.refuse("every estimate has this quantity; give the goal another name", name)
        goal_table = table.as_table({} if value is True else value, "arguments of a goal, or is true", name)
        kind = goal_table.text("kind", GOAL_READERS) if "kind" in goal_table.values else name
        if kind not in GOAL_READERS:
            table.refuse(f"kind is missing; allowed: {', '.join(GOAL_READERS)}, also as the goal's key", name)
        arguments[name] = {"kind": kind, **goal_table.entries(_goal_keys(kind))}
    return arguments


def _goal_keys(kind: str) -> Keys:
    readers, text = GOAL_READERS[kind], f"{kind} has {', '.join(GOAL_READERS[kind])}"
    return Keys({"kind": TEXT, **readers}, {key: text for key in readers if key not in ("seam", "side")})


def _goals_schema() -> Schema:
    """Return the JSON schema of the table of goals, in which a goal's name may stand for its kind."""
    variants = {kind: _goal_keys(kind).schema() for kind in GOAL_READERS}
    properties: dict[str, Any] = {kind: variants_schema("kind", variants, kind) for kind in variants}
    properties["compliance"] = {"anyOf": [{"const": True}, properties["compliance"]]}
    properties |= dict.fromkeys(STANDARD_QUANTITIES, False)
    return {"type": "object", "properties": properties, "additionalProperties": variants_schema("kind", variants, "")}


def _read_tolerances(section: TomlTable, key: str) -> dict[str, float]:
    """Read the allowed changes at `key` in the input file `section`: name of a quantity -> largest relative change.

    A number in place of a table is the largest relative change of the traction.
    """
    value, what = section.values[key], "the largest relative change that is allowed, between 0 and 1"
    table = section.as_table(value if isinstance(value, Mapping) else {"traction": value}, what, key)
    goals = section.values.get("goals") or {"compliance": True}
    keys = Keys(dict.fromkeys([*STANDARD_QUANTITIES, *goals], positive_reader(what)))
    tolerances = table.entries(keys, kind="quantity")
    return {name: table.checked(name, lambda number: number < 1, f"is not < 1; it is {what}") for name in tolerances}


def _is_names_or_switch(value: object) -> bool:
    return isinstance(value, bool) or (isinstance(value, list) and all(isinstance(name, str) for name in value))


POSITIVE_SCHEMA = {**NUMBER.schema, "exclusiveMinimum": 0}
CHANGE_SCHEMA = {**POSITIVE_SCHEMA, "exclusiveMaximum": 1}
TOLERANCE_SCHEMA = {**CHANGE_SCHEMA, "type": ["number", "object"], "additionalProperties": CHANGE_SCHEMA}
LOADS_SCHEMA = {"type": "array", "items": {"anyOf": [POINT_LOAD_KEYS.schema(), LINE_LOAD_KEYS.schema()]}}
SWITCH = Reader(
    lambda file, key: file.checked(key, lambda is_on: isinstance(is_on, bool), "is neither true nor false"),
    {"type": "boolean"},
)
ENTRY_READERS: dict[str, Reader] = {
    "mesh": Reader(_read_mesh, {**MESH_KEYS.schema(), **TEXT.schema, "type": ["string", "object"]}),
    "units": UNITS,
    "body": materials_reader("body"),
    "layer": materials_reader("layer"),
    "supports": Reader(_read_supports, SUPPORTS.schema),
    "tractions": names_reader(TRACTION, "names of facet sets with a vector, such as TOP = [0, -50]"),
    "body_force": table_or_other_reader(names_reader(VECTOR, "names of regions and seams"), VECTOR),
    "fluxes": names_reader(FLOW, "names of facet sets with a flux, such as TOP = 0.05"),
    "sources": table_or_other_reader(names_reader(NUMBER, "names of regions and seams"), NUMBER),
    "films": names_reader(FILM, "names of facet sets, such as TOP = {h = 1e-5, T = 20}"),
    "initial": NUMBER,
    "loads": Reader(_read_loads, LOADS_SCHEMA),
    "plane": choice_reader("strain", "stress", "axisymmetric"),
    "element": choice_reader("P2", "Q2", "S2"),  # of degree 2, as interface laws of order 1 need it
    "bodies": choice_reader("kept", "extended"),
    "times": Reader(_read_times, {"type": "array", "items": POSITIVE_SCHEMA, "minItems": 1}),
    "goals": Reader(_read_goals, _goals_schema()),
    "tolerance": Reader(_read_tolerances, TOLERANCE_SCHEMA),
    "bonded": SWITCH,
    "continuum": SWITCH,
    "density": names_reader(NUMBER, "names of bodies and seams, such as S = 1.2e-9"),
    "modes": Reader(
        lambda file, key: file.checked(key, lambda n: is_integer(n, 1), "is not a whole number > 0"),
        {"type": "integer", "minimum": 1},
    ),
    "sensitivities": Reader(
        lambda file, key: file.checked(key, _is_names_or_switch, "is neither true, false nor a list of names"),
        {"type": ["boolean", "array"], "items": {"type": "string"}},
    ),
}
ENTRY_KEYS = Keys(ENTRY_READERS, {"mesh": MESH_HINT, "body": f"{LAW_HINT} [body]", "layer": f"{LAW_HINT} [layer]"})
