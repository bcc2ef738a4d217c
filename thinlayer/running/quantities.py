"""Texts with a unit in an input file of `estimate`, such as eps = "0.2 mm", as numbers in the units of the file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from thinlayer.running.toml_table import Reader, Schema, TomlTable, types_of
from thinlayer.system.units import QUANTITY, Units

KEYS_BY_KIND = {  # keys of materials, loads and goals; None: of any kind, as it depends on an exponent
    "stress": "E K G mu lmbda C cohesion strength hardening saturation kinematic alpha transformation_energy",
    "ratio": "nu eigenstrain fraction elastic_fraction saturation_strain", "time": "theta_lmbda theta_mu t1 t2",
    "angle": "friction_angle dilatancy_angle", "length": "eps place x", None: "eta rest A",
}  # fmt: skip
KINDS = {key: kind for kind, keys in KEYS_BY_KIND.items() for key in keys.split()}
TABLE_KINDS = {"supports": "length", "tractions": "stress", "body_force": "force per volume", "tolerance": "ratio"}
ENTRY_KINDS = {**TABLE_KINDS, "times": "time"}


LENGTH, FORCE = "(?:[nuµmcdk]?m|in|inch|ft)", "(?:[mkM]?N|lbf|kgf)"  # patterns of common units
UNIT_PATTERNS = {
    "length": LENGTH,
    "stress": f"(?:[hkMG]?Pa|m?bar|[kM]?psi|{FORCE} */ *{LENGTH} *(?:\\^|\\*\\*) *2)",
    "time": "(?:[num]?s|second|min|minute|h|hour|d|day|week|year)",
    "ratio": f"(?:%|percent|permille|ppm|{LENGTH} */ *{LENGTH})",
    "angle": "(?:deg|degree|rad|radian)",
    "force": f"{FORCE}(?: */ *{LENGTH})?",  # per length in a plane structure
    "force per length": f"{FORCE} */ *{LENGTH}",
    "force per volume": f"{FORCE} */ *{LENGTH} *(?:\\^|\\*\\*) *3",
    None: "[^\\d\\s.,?][^,?]*",
}  # kind of a quantity -> regular expression, for editors, of its common units; a file may have others


def read_units(section: TomlTable, key: str) -> tuple[str, ...]:
    """Return the names, at `key` in the table `section`, of the units of lengths, stresses and perhaps times."""
    units = tuple(map(str.strip, section.text(key).split(",")))
    wrong = "are not two units, or three; give those of length, stress and perhaps time, such as 'mm, MPa'"
    section.checked(key, lambda _: len(units) in (2, 3) and all(units), wrong)
    return units


UNITS = Reader(read_units, {"type": "string", "pattern": "^[^,?]*[^,? ][^,?]*(,[^,?]*[^,? ][^,?]*){1,2}$"})


def _changed(value: Any, change: Callable[..., Any], kind: str | None, *keys: str) -> Any:
    """Return a value of an input file with `change(value, kind, *keys)` in place of each value in its tables and lists.

    Args:
        value: the value, also a table or a list; or a JSON schema of such a value.
        change: function of a value whose own values are already changed; see the next arguments.
        kind: kind of quantity; "": no quantity; None: a quantity of any kind.
        *keys: keys of nested tables, and last that of the value; in a list its number, from 1.
    """
    if isinstance(value, Mapping):
        force = "force in the plane" if isinstance(place := value.get("place"), list) and len(place) == 2 else "force"
        kinds = {} if keys[0] in TABLE_KINDS else KINDS
        kinds = {**kinds, "times": "time", "force": "force per length" if "first" in value else force}
        value = {name: _changed(item, change, kinds.get(name, kind), *keys, name) for name, item in value.items()}
    if isinstance(value, list):
        value = [_changed(item, change, kind, *keys, str(number)) for number, item in enumerate(value, 1)]
    return change(value, kind, *keys)


def with_unit_texts(schema: Schema, key: str) -> Schema:
    """Return the JSON schema of the value at `key` in an input file, in which quantities may be texts with a unit."""

    def add_text(part: Any, kind: str | None, *_: str) -> Any:
        if kind == "" or not isinstance(part, Mapping) or "number" not in types_of(part):
            return part
        number = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
        return {**part, "type": [*types_of(part), "string"], "pattern": f"^ *{number} *{UNIT_PATTERNS[kind]} *$"}

    changed: Schema = _changed(schema, add_text, ENTRY_KINDS.get(key, ""), key)
    return changed


def with_numbers(file_table: TomlTable) -> TomlTable:
    """Return the whole file with numbers in place of its texts with a unit.

    Raises:
        DescriptionError: such a text is of another kind than its entry, or the file does not say its units.
    """

    def convert(value: Any, kind: str | None, *keys: str) -> Any:
        if kind == "" or keys[-1] == "place" or not isinstance(value, str) or not QUANTITY.fullmatch(value):
            return value
        if kind == "force in the plane":
            kind = "force" if file_table.values.get("plane") == "axisymmetric" else "force per length"
        if "units" not in file_table.values and kind not in ("ratio", "angle"):
            file_table.refuse(f"{value!r} has a unit; name those of the plain numbers: units = 'mm, MPa'", *keys)
        with file_table.locate_errors("units"):
            units = Units("m", "Pa") if kind in ("ratio", "angle") else Units(*read_units(file_table, "units"))
        with file_table.locate_errors(*keys):
            return units(value, kind)

    entries = file_table.values.items()
    return replace(file_table, values={k: _changed(v, convert, ENTRY_KINDS.get(k, ""), k) for k, v in entries})
