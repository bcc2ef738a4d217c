"""Materials in an input file of `estimate`: laws by name, parameters, pairs of elastic moduli, thicknesses."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields
from functools import cache
from typing import Any, TypeVar

import numpy as np

import forms
from forms.base import InputError
from forms.elastic import LinearElastic
from forms.flux import FluxLaw
from forms.kernel import KernelLaw
from forms.law import BulkLaw, scalar_field_names
from forms.series import Stack
from thinlayer.running.toml_table import (
    NUMBER,
    Keys,
    Reader,
    Schema,
    TomlTable,
    attribute_texts,
    choice_reader,
    positive_reader,
    variants_schema,
)

LawType = TypeVar("LawType", bound=BulkLaw)
Moduli = tuple[tuple[str, ...], ...]  # sets of names of moduli, one of which a law has
ELASTIC_PAIRS: Moduli = (("E", "nu"), ("G", "nu"), ("mu", "nu"), ("K", "G"), ("K", "mu"), ("lmbda", "mu"))
ELASTIC_PAIRS_TEXT = "E and nu, G and nu, K and G, or lmbda and mu (G is mu)"
SHEAR_MODULI: Moduli = (("E",), ("G",), ("mu",))
DEFAULT_LAW = "LinearElastic"
HINTS = {"eps": "the thickness of the layer, a length", "fraction": "share of the thickness"}
OTHER_READERS: dict[str, dict[str, Reader]] = {
    "body": {"eigenstrain": NUMBER},
    "layer": {"eps": positive_reader(HINTS["eps"]), "eigenstrain": NUMBER},
    "sublayer": {"fraction": positive_reader(HINTS["fraction"])},
}  # kind of a material -> readers of its keys besides those of its law


@dataclass(frozen=True)
class MaterialEntry:
    """Material of a body or a layer in an input file of the command `estimate`.

    Attributes:
        law: law of stress and strain, with the moduli of the material.
        eps: thickness of a layer; 0 for a body.
        eigenstrain: isotropic strain that the material would have without stress, positive if it expands; None: none.
    """

    law: BulkLaw
    eps: float
    eigenstrain: float | None


Materials = Mapping[str | None, MaterialEntry]  # by the name of a region or seam; None: all


def materials_reader(kind: str) -> Reader:
    """Return a reader of the materials of all bodies, or of all layers, in an input file.

    The table of materials has the parameters of one law for all; or it has a table of parameters for each name of a
    region or seam. The reader returns name -> `MaterialEntry`. The name None stands for all regions or seams.

    Args:
        kind: "body" or "layer".

    Raises:
        DescriptionError: (the reader) an unknown law, an unknown or missing parameter, moduli that do not determine an
            elastic law, or parameters that the law refuses.
    """
    content, material = "the parameters of a law, such as E and nu", _reference_schema(kind)

    def read(section: TomlTable, key: str) -> Materials:
        whole = section.table(key, content)
        are_tables = [isinstance(value, dict) for value in whole.values.values()]
        if any(are_tables) and not all(are_tables):
            whole.refuse(f"it has tables with names beside keys without one; give each name a table with {content}")
        tables = {name: whole.table(name, content) for name in whole.values} if any(are_tables) else {None: whole}
        materials = dict[str | None, MaterialEntry]()
        for name, table in tables.items():
            law, entries = _read_law(table, kind)
            materials[name] = MaterialEntry(law, entries.get("eps", 0.0), entries.get("eigenstrain"))
        return materials

    named = {"type": "object", "additionalProperties": material}
    are_all_tables = {"additionalProperties": {"type": "object"}, "minProperties": 1}
    completed = {"anyOf": [material, named, True]}  # true; Taplo completes keys by "anyOf", and not by "if"
    return Reader(read, {"if": are_all_tables, "then": named, "else": material, **completed})


def _needed(kind: str) -> dict[str, str]:
    return {key: HINTS[key] for key in OTHER_READERS[kind] if key in HINTS}


def _reference_schema(kind: str) -> Schema:
    """Return the JSON schema of a material of a kind, which refers to `material_schema`."""
    refused = {key: False for keys in OTHER_READERS.values() for key in keys if key not in OTHER_READERS[kind]}
    return {"allOf": [{"$ref": "#/definitions/material"}], "required": [*_needed(kind)], "properties": refused}


@cache
def laws_by_name() -> dict[str, type[BulkLaw]]:
    """Return name -> class of the laws of stress and strain that an input file may name."""
    classes = {name: law for name, law in sorted(vars(forms).items()) if isinstance(law, type)}
    bases = (BulkLaw, FluxLaw, KernelLaw)
    return {name: law for name, law in classes.items() if issubclass(law, BulkLaw) and law not in bases}


PARAMETER_SCHEMAS: dict[str, Schema] = {
    "Array": {"type": "array", "items": {"type": ["array", "number"], "items": NUMBER.schema}},
    "str": {"type": "string"},
    "bool": {"type": "boolean"},
}  # type of a law's parameter other than a number -> JSON schema


@cache
def _law_keys(name: str) -> tuple[Keys, Moduli]:
    """Return the keys of a law in an input file, and the sets of elastic moduli of which it has one; (): none."""
    if name == "Stack":
        sublayers = Reader(_read_sublayers, {"type": "array", "items": _reference_schema("sublayer")})
        return Keys({"law": choice_reader(name), "sublayers": sublayers}, {"sublayers": "tables with a law"}), ()
    law_class: Any = laws_by_name()[name]  # mypy does not see that classes can be hashed, as `scalar_field_names` needs
    parameters = {f.name: f for f in fields(law_class) if f.init}
    moduli = ELASTIC_PAIRS if "lmbda" in parameters else SHEAR_MODULI if "mu" in parameters else ()
    elastic_keys = dict.fromkeys(key for keys in moduli for key in keys)
    non_elastic_keys = [key for key in parameters if key not in elastic_keys]
    numbers = dict.fromkeys((*elastic_keys, *scalar_field_names(law_class)), NUMBER)
    readers = {
        key: numbers.get(key) or Reader(_read_parameter, PARAMETER_SCHEMAS[str(parameters[key].type)])
        for key in (*elastic_keys, *non_elastic_keys)
    }
    allowed_text = f"{name} has {', '.join([ELASTIC_PAIRS_TEXT] * bool(moduli) + non_elastic_keys)}"
    hints = {key: allowed_text for key in non_elastic_keys if parameters[key].default is MISSING}
    return Keys({"law": choice_reader(name), **readers}, hints), moduli


def _read_law(section: TomlTable, kind: str) -> tuple[BulkLaw, dict[str, Any]]:
    """Read a law from a table {law = name, parameter = value, ...}, or the law of a stack from {sublayers = [...]}.

    Args:
        section: the table.
        kind: "body", "layer" or "sublayer".

    Returns:
        The law, and key -> value of all entries of the table.
    """
    name = "Stack" if "sublayers" in section.values else DEFAULT_LAW
    if "law" in section.values and name != "Stack":
        name = section.text("law", laws_by_name(), "law of strains")
    keys, moduli = _law_keys(name)
    all_keys = Keys({**keys.readers, **OTHER_READERS[kind]}, {**keys.hints, **_needed(kind)})
    entries = section.entries(all_keys, f"key of {name}")
    if name == "Stack":
        return _make_law(section, lambda: Stack(*entries["sublayers"])), entries
    arguments = {key: value for key, value in entries.items() if key not in ("law", *OTHER_READERS[kind])}
    given_moduli = {key: arguments.pop(key) for key in [*arguments] if any(key in keys for keys in moduli)}
    if moduli and {*given_moduli} not in map(set, moduli):
        allowed = f"a pair: {ELASTIC_PAIRS_TEXT}" if moduli == ELASTIC_PAIRS else "one: mu (which is G), or E = 3 mu"
        section.refuse(f"moduli are {' and '.join(given_moduli) or 'missing'}; {name} has {allowed}")
    return _make_law(section, lambda: laws_by_name()[name](**_lame_moduli(given_moduli), **arguments)), entries


def material_schema() -> Schema:
    """Return the JSON schema of a material in an input file, with the keys of bodies, layers and sublayers."""
    variants = {}
    for name, law in laws_by_name().items():
        keys, moduli = _law_keys(name)
        readers = {key: reader for group in (*OTHER_READERS.values(), keys.readers) for key, reader in group.items()}
        if name == DEFAULT_LAW:  # the table of a stack needs no key `law`
            readers, moduli = {**_law_keys("Stack")[0].readers, **readers}, (*moduli, ("sublayers",))
        names = {key for choice in moduli for key in choice}
        choices = [{"required": m, "properties": dict.fromkeys(sorted(names - {*m}), False)} for m in moduli]
        texts = {key: f"{name}: {text}" for key, text in attribute_texts(law).items()}
        variants[name] = {**Keys(readers, keys.hints).schema(texts), **({"oneOf": choices} if choices else {})}
    return variants_schema("law", variants, DEFAULT_LAW)


def _make_law(section: TomlTable, make: Callable[[], LawType]) -> LawType:
    try:
        return make()
    except (InputError, TypeError, ValueError) as error:
        section.refuse(str(error))


def _read_sublayers(section: TomlTable, key: str) -> list[tuple[float, BulkLaw]]:
    tables = section.tables(key, "a fraction of the thickness and a law")
    return [(entries["fraction"], law) for law, entries in (_read_law(table, "sublayer") for table in tables)]


def _read_parameter(section: TomlTable, key: str) -> object:
    """Return the parameter of a law at `key` in the table `section`: lists as an array, any other value as it is."""
    value = section.values[key]
    try:
        return np.array(value, float) if isinstance(value, list) else value
    except (TypeError, ValueError):
        section.refuse("it must be a list of numbers, or of lists of them", key)


def _lame_moduli(moduli: Mapping[str, float]) -> Mapping[str, float]:
    """Return Lamé's moduli, {"lmbda": ..., "mu": ...}, from the moduli in an input file; for one modulus only "mu".

    Args:
        moduli: one of `ELASTIC_PAIRS` or of `SHEAR_MODULI` with values, or {}.
    """
    if "lmbda" in moduli or not moduli:
        return moduli
    constants = {"G" if key == "mu" else key: value for key, value in moduli.items()}
    if "K" in constants:
        return {"lmbda": constants["K"] - 2 * constants["G"] / 3, "mu": constants["G"]}
    if "nu" in constants:
        make, modulus = (LinearElastic.young, "E") if "E" in constants else (LinearElastic.shear, "G")
        law = make(constants[modulus], constants["nu"])
        return {"lmbda": law.lmbda, "mu": law.mu}
    return {"mu": constants["E"] / 3 if "E" in constants else constants["G"]}
