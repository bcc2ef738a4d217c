"""Texts with a unit in an input file of `estimate`, such as eps = "0.2 mm", as numbers in the units of the file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from thinlayer.running.toml_table import Reader, TomlTable, types_of
from thinlayer.system.units import QUANTITY, Units

KEYS_BY_KIND = {  # keys of materials, loads and goals; None: of any kind, as it depends on an exponent
    "stress": "E K G mu lmbda C cohesion strength hardening saturation kinematic alpha transformation_energy",
    "ratio": "nu eigenstrain fraction elastic_fraction saturation_strain", "time": "theta_lmbda theta_mu t1 t2",
    "angle": "friction_angle dilatancy_angle", "length": "eps place x", None: "eta rest A",
}  # fmt: skip
KINDS = {key: kind for kind, keys in KEYS_BY_KIND.items() for key in keys.split()}
TABLE_KINDS = {"supports": "length", "tractions": "stress", "body_force": "force per volume", "tolerance": "ratio"}


LENGTH, FORCE = "(?:[nuµmcdk]?m|in|inch|ft)", "(?:[mkM]?N|lbf|kgf)"  # patterns of common units
UNIT_PATTERNS = {
    "length": LENGTH,
    "stress": f"(?:[hkMG]?Pa|m?bar|[kM]?psi|{FORCE} */ *{LENGTH} *(?:\\^|\\*\\*) *2)",
    "time": "(?:[num]?s|second|min|minute|h|hour|d|day|week|year)",
    "ratio": f"(?:%|percent|permille|ppm|{LENGTH} */ *{LENGTH})",
    "angle": "(?:deg|degree|rad|radian)",
    "force": f"{FORCE}(?: */ *{LENGTH})?",  # per length in plane structures
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


def _kinds_of_keys(*keys: str) -> dict[str, str | None]:
    """Return key -> kind of quantity for the entries of a table, which is reached from the file by `keys`."""
    kinds = TABLE_KINDS if not keys else {} if keys[0] in TABLE_KINDS else KINDS
    return {**kinds, "times": "time", "force": "force"}


def with_unit_texts(schema: Any, kind: str | None = "", *keys: str) -> Any:
    """Return a JSON schema of input files in which numbers of a kind may also be texts with a unit.

    Args:
        schema: the schema, or a part of it, with numbers.
        kind: kind of the quantity; "": only numbers.
        *keys: keys of the tables that lead to what the schema is about.
    """
    if isinstance(schema, list):
        return [with_unit_texts(item, kind, *keys) for item in schema]
    if not isinstance(schema, Mapping):
        return schema
    kinds = _kinds_of_keys(*keys)
    walked = {
        word: {name: with_unit_texts(item, kinds.get(name, kind), *keys, name) for name, item in value.items()}
        if word == "properties"
        else with_unit_texts(value, kind, *keys)
        for word, value in schema.items()
    }
    if kind == "" or "number" not in types_of(schema):
        return walked
    number = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
    return {**walked, "type": [*types_of(schema), "string"], "pattern": f"^ *{number} *{UNIT_PATTERNS[kind]} *$"}


def with_numbers(file_table: TomlTable) -> TomlTable:
    """Return the whole file with numbers in place of its texts with a unit.

    Raises:
        DescriptionError: such a text is of another kind than its entry, or the file does not say its units.
    """

    def convert(value: Any, kind: str | None, *keys: str) -> Any:
        """Return a value, or all values in a table or list, with numbers; texts of the kind "" stay texts."""
        if isinstance(value, Mapping):
            is_plane = isinstance(place := value.get("place"), list) and len(place) == 2
            per_length = (is_plane and file_table.values.get("plane") != "axisymmetric") or "first" in value
            kinds = {**_kinds_of_keys(*keys), "force": "force per length" if per_length else "force"}
            return {name: convert(item, kinds.get(name, kind), *keys, name) for name, item in value.items()}
        if isinstance(value, list):
            return [convert(item, kind, *keys, str(number)) for number, item in enumerate(value, 1)]
        if kind == "" or keys[-1] == "place" or not isinstance(value, str) or not QUANTITY.fullmatch(value):
            return value
        if "units" not in file_table.values and kind not in ("ratio", "angle"):
            file_table.refuse(f"{value!r} has a unit; name those of the plain numbers: units = 'mm, MPa'", *keys)
        with file_table.locate_errors("units"):
            units = Units("m", "Pa") if kind in ("ratio", "angle") else Units(*read_units(file_table, "units"))
        with file_table.locate_errors(*keys):
            return units(value, kind)

    return replace(file_table, values=convert(file_table.values, ""))
