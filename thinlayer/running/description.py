"""Input file in TOML of the command `estimate`: mesh file, laws, supports, loads and goals.

The file is called a description. Its entries are checked without reading the mesh. Most keys are names of arguments: of
`geometry.read` in the table [mesh], of `ThinLayer` in [layer], of the classes of goals in [goals], of `Structure`
elsewhere. Moduli of layers are those of the material, not divided by the thickness.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from thinlayer.running.materials import Materials, read_materials
from thinlayer.running.quantities import read_units, with_numbers
from thinlayer.running.toml_table import (
    Reader,
    Readers,
    TimeSeries,
    TomlTable,
    choice_reader,
    is_increasing,
    positive_reader,
    read_input_file,
    series_reader,
)

Place = str | tuple[float, ...]
Vector = tuple[float, ...]
Support = float | Mapping[str, float | TimeSeries]  # one number for all components, or component -> number
Traction = Vector | TimeSeries | Mapping[str, float | TimeSeries]  # components, or {"pressure": number}
Arguments = Mapping[str, Any]  # arguments of a function of the package, by name

GOAL_READERS: dict[str, Readers] = {
    "compliance": {},
    "reaction": {"place": TomlTable.text, "direction": TomlTable.vector},
    "mean_traction": {"direction": TomlTable.vector, "seam": TomlTable.text},
    "displacement": {"x": TomlTable.vector, "direction": TomlTable.vector, "side": choice_reader("lower", "upper")},
}  # kind of goal -> readers of its arguments
STANDARD_QUANTITIES = ("traction", "jump")  # quantities that every estimate has, in addition to goals


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
        loads: for each concentrated load, the arguments of `PointLoad` or `LineLoad` by name.
        plane: "strain", "stress" or "axisymmetric", for plane meshes; None: plane strain.
        element: finite element of the displacements, "P2", "Q2" or "S2"; None: the default of `Structure`.
        bodies: "kept" (the meshed layer would move the bodies apart) or "extended" (it would be cut out of them).
        times: ends of the time steps, for laws with a rate or a memory; (): the structure is solved once, at t = 0.
        goals: name -> "kind" and further arguments of a quantity of interest.
        tolerance: name of a quantity -> its largest allowed relative change, < 1. The command then also looks for the
            thickness of the layer below which the change is smaller.
        bonded: whether to estimate, too, what changes if the layer is left out and the bodies are bonded.
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
    loads: Sequence[Arguments] = ()
    plane: str | None = None
    element: str | None = None
    bodies: str = "kept"
    times: tuple[float, ...] = ()
    goals: Mapping[str, Arguments] = field(default_factory=dict)
    tolerance: Mapping[str, float] = field(default_factory=dict)
    bonded: bool = False
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
        law_hint = "the parameters of a law, such as E and nu, in a table"
        required = {"mesh": MESH_HINT, "body": f"{law_hint} [body]", "layer": f"{law_hint} [layer]"}
        description = cls(file_table, **file_table.entries(ENTRY_READERS, required))
        motions = [v for u in description.supports.values() for v in (u.values() if isinstance(u, Mapping) else [u])]
        has_strain = any(entry.eigenstrain for entry in (*description.body.values(), *description.layer.values()))
        if not (description.tractions or description.body_force or description.loads or any(motions) or has_strain):
            file_table.refuse("nothing loads the structure; give tractions, body_force, loads, or supports that move")
        description._require_times()
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
                self.file_table.refuse("a history needs times, the ends of time steps", *series.key_path)
            if start > 0 or end < self.times[-1]:
                text = f"the history goes from {start:g} to {end:g}; it must cover all times, 0 to {self.times[-1]:g}"
                self.file_table.refuse(text, *series.key_path)


def _read_mesh(section: TomlTable, key: str) -> Arguments:
    """Read the mesh entry of the input file, and return the arguments of `geometry.read` by name.

    With regions in `upper` and `lower`, `S` is set to None if it is missing. S then consists of all facets between
    these regions.

    Args:
        section: the whole input file.
        key: "mesh". Its value is the path of the mesh file, or a table of arguments.
    """
    value, side_readers = section.values[key], dict[str, Reader].fromkeys(("upper", "lower"), TomlTable.texts)
    table = section.as_table({"path": value} if isinstance(value, str) else value, "path and arguments of read", key)
    readers: Readers = {"path": TomlTable.text, "S": _read_S_facets, **side_readers, "direction": TomlTable.vector}
    others: Readers = {
        "names": _read_S_facets,
        "regions": TomlTable.text,
        "join": positive_reader("a part of the size"),
    }
    arguments = table.entries({**readers, **others, "scale": positive_reader("a factor")}, {"path": MESH_HINT})
    return {"S": None, **arguments} if side_readers.keys() <= arguments.keys() else arguments


def _read_S_facets(section: TomlTable, key: str) -> object:
    """Read which facets form S, at `key` in the table `section`: one name of a facet set, several names, or a table.

    The table has the sides of each seam by the name of the seam; only `geometry.read` checks it.
    """
    value = section.values[key]
    return value if isinstance(value, Mapping) else section.texts(key)


def _read_supports(section: TomlTable, key: str) -> dict[Place, Support]:
    """Read the supports, a table at `key` in the input file `section`.

    Returns:
        Name of a facet set, or coordinates of a vertex -> prescribed displacement. It is one number for all components,
        or component -> number or values in time. Components are "x", "y", "z" and, on a facet set, "n", along its
        normal.
    """
    table, supports = section.table(key, "places with what they prescribe, such as LEFT = 0"), dict[Place, Support]()
    for name, value in table.values.items():
        place = _parse_place(name)
        if isinstance(value, Mapping):
            readers = dict.fromkeys("xyzn" if isinstance(place, str) else "xyz", series_reader(TomlTable.number))
            supports[place] = table.table(name, "components").entries(readers, kind="component")
            if not value:
                table.refuse("it has no components; give some, such as {x = 0}", name)
        else:
            supports[place] = table.number(name)
    return supports


def _parse_place(text: str) -> Place:
    """Return where a support is, from its key `text` in the input file: the coordinates of a vertex, or a facet set.

    A text such as "(1, 0)" stands for a vertex; any other text is the name of a facet set.
    """
    if text.startswith("(") and text.endswith(")"):
        with suppress(ValueError):
            return tuple(float(c) for c in text[1:-1].split(","))
    return text


def _read_tractions(section: TomlTable, key: str) -> dict[str, Traction]:
    """Read the tractions on facet sets, a table at `key` in the input file `section`.

    Returns:
        Name of a facet set -> components of the traction, or {"pressure": number}. Components and pressure may also be
        values in time.
    """
    table = section.table(key, "names of facet sets with a vector, such as TOP = [0, -50]")
    return {name: series_reader(_read_traction)(table, name) for name in table.values}


def _read_traction(section: TomlTable, key: str) -> Traction:
    if isinstance(section.values[key], Mapping):
        required = {"pressure": "a stress, > 0 where it presses"}
        return section.table(key, "pressure").entries({"pressure": series_reader(TomlTable.number)}, required)
    return section.vector(key)


def _read_body_force(section: TomlTable, key: str) -> Vector | dict[str, Vector]:
    """Read the force per volume at `key` in the input file `section`.

    Returns:
        Components of the force for all bodies, or name of a region or seam -> components.
    """
    value = section.values[key]
    if not isinstance(value, Mapping):
        return section.vector(key)
    return section.table(key, "names of regions and seams").entries(dict.fromkeys(value, TomlTable.vector))


def _read_loads(section: TomlTable, key: str) -> tuple[Arguments, ...]:
    """Read the concentrated loads, a list of tables at `key` in the input file `section`.

    Returns:
        For each load, arguments by name: those of `LineLoad` if its table names a first and a second facet set, else
        those of `PointLoad`.
    """
    loads = []
    for table in section.tables(key, "place and force, or first, second and force"):
        on_edges = {"first", "second"} & table.values.keys()
        where: Readers = dict.fromkeys(("first", "second"), TomlTable.text) if on_edges else {"place": TomlTable.vector}
        needed = {**dict.fromkeys(where, "where the load acts"), "force": "the vector of the force"}
        loads.append(table.entries({**where, "force": series_reader(TomlTable.vector), "body": TomlTable.text}, needed))
    return tuple(loads)


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
        readers = GOAL_READERS[kind]
        required = {key: f"{kind} has {', '.join(readers)}" for key in readers if key not in ("seam", "side")}
        arguments[name] = {"kind": kind, **goal_table.entries({"kind": TomlTable.text, **readers}, required)}
    return arguments


def _read_tolerances(section: TomlTable, key: str) -> dict[str, float]:
    """Read the allowed changes at `key` in the input file `section`: name of a quantity -> largest relative change.

    A number in place of a table is the largest relative change of the traction.
    """
    value, what = section.values[key], "the largest relative change that is allowed, between 0 and 1"
    table = section.as_table(value if isinstance(value, Mapping) else {"traction": value}, what, key)
    goals = section.values.get("goals") or {"compliance": True}
    tolerances = table.entries(dict.fromkeys([*STANDARD_QUANTITIES, *goals], positive_reader(what)), kind="quantity")
    return {name: table.checked(name, lambda number: number < 1, f"is not < 1; it is {what}") for name in tolerances}


def _is_names_or_switch(value: object) -> bool:
    return isinstance(value, bool) or (isinstance(value, list) and all(isinstance(name, str) for name in value))


MESH_HINT = 'the name of a mesh file, mesh = "joint.msh"'
ENTRY_READERS: dict[str, Reader] = {
    "mesh": _read_mesh,
    "units": read_units,
    "body": read_materials,
    "layer": partial(read_materials, are_layers=True),
    "supports": _read_supports,
    "tractions": _read_tractions,
    "body_force": _read_body_force,
    "loads": _read_loads,
    "plane": choice_reader("strain", "stress", "axisymmetric"),
    "element": choice_reader("P2", "Q2", "S2"),  # of degree 2, as interface laws of order 1 need it
    "bodies": choice_reader("kept", "extended"),
    "times": _read_times,
    "goals": _read_goals,
    "tolerance": _read_tolerances,
    "bonded": lambda file, key: file.checked(key, lambda is_on: isinstance(is_on, bool), "is neither true nor false"),
    "sensitivities": lambda file, key: file.checked(
        key, _is_names_or_switch, "is neither true, false nor a list of names"
    ),
}
