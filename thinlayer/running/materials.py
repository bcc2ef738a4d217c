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
from forms.kernel import KernelLaw
from forms.law import BulkLaw, scalar_field_names
from forms.series import Stack
from thinlayer.running.toml_table import Reader, TomlTable, choice_reader, positive_reader

LawType = TypeVar("LawType", bound=BulkLaw)
ELASTIC_KEYS = ("E", "nu", "K", "G", "mu", "lmbda")
ELASTIC_PAIRS_TEXT = "E and nu, G and nu, K and G, or lmbda and mu (G is mu)"


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


def read_materials(section: TomlTable, key: str, *, are_layers: bool = False) -> Materials:
    """Read the materials of all bodies, or those of all layers, from an input file.

    The table of materials has the parameters of one law for all; or it has a table of parameters for each name of a
    region or seam.

    Args:
        section: the whole input file.
        key: key of the table of materials, "body" or "layer".
        are_layers: whether the materials are those of layers, which have a thickness.

    Returns:
        Name of a region or seam -> its material. The key None stands for all regions or seams.

    Raises:
        DescriptionError: an unknown law, an unknown or missing parameter, moduli that do not determine an elastic law,
            or parameters that the law refuses.
    """
    content, eps_hint = "the parameters of a law, such as E and nu", "the thickness of the layer, a length"
    whole = section.table(key, content)
    are_tables = [isinstance(value, dict) for value in whole.values.values()]
    if any(are_tables) and not all(are_tables):
        whole.refuse(f"it has tables with names beside keys without one; give each name a table with {content}")
    tables = {name: whole.table(name, content) for name in whole.values} if any(are_tables) else {None: whole}
    materials, needed = dict[str | None, MaterialEntry](), {"eps": positive_reader(eps_hint)} if are_layers else {}
    for name, table in tables.items():
        law, entries = _read_law(table, {**needed, "eigenstrain": TomlTable.number}, dict.fromkeys(needed, eps_hint))
        materials[name] = MaterialEntry(law, entries.get("eps", 0.0), entries.get("eigenstrain"))
    return materials


@cache
def laws_by_name() -> dict[str, type[BulkLaw]]:
    """Return name -> class of the laws of stress and strain that an input file may name."""
    classes = {name: law for name, law in sorted(vars(forms).items()) if isinstance(law, type)}
    return {name: law for name, law in classes.items() if issubclass(law, BulkLaw) and law not in (BulkLaw, KernelLaw)}


def _read_law(
    section: TomlTable, extra_readers: Mapping[str, Reader], required: Mapping[str, str]
) -> tuple[BulkLaw, dict[str, Any]]:
    """Read a law from a table {law = name, parameter = value, ...}, or the law of a stack from {sublayers = [...]}.

    Args:
        section: the table.
        extra_readers: key that the table may have besides the law -> function that reads its value.
        required: key that the table must have besides the law -> explanation of the key, for errors.

    Returns:
        The law, and key -> value of all entries of the table.
    """
    if "sublayers" in section.values or section.values.get("law") == "Stack":
        stack_readers = {"law": choice_reader("Stack"), "sublayers": _read_sublayers, **extra_readers}
        entries = section.entries(stack_readers, {**required, "sublayers": "tables with a law"}, "key of Stack")
        return _make_law(section, lambda: Stack(*entries["sublayers"])), entries
    name = section.text("law", laws_by_name(), "law of strains") if "law" in section.values else "LinearElastic"
    law_class: Any = laws_by_name()[name]  # mypy does not see that classes can be hashed, as `scalar_field_names` needs
    parameters = {f.name: f for f in fields(law_class) if f.init}
    elastic_keys = ELASTIC_KEYS if "lmbda" in parameters else ("E", "G", "mu") if "mu" in parameters else ()
    non_elastic_keys = [key for key in parameters if key not in elastic_keys]
    number_keys = {*elastic_keys, *scalar_field_names(law_class)}
    readers = {k: TomlTable.number if k in number_keys else _read_parameter for k in (*elastic_keys, *non_elastic_keys)}
    allowed_text = f"{name} has {', '.join([ELASTIC_PAIRS_TEXT] * bool(elastic_keys) + non_elastic_keys)}"
    hints = {**{key: allowed_text for key in non_elastic_keys if parameters[key].default is MISSING}, **required}
    entries = section.entries({"law": TomlTable.text, **extra_readers, **readers}, hints, f"key of {name}")
    moduli = {key: entries[key] for key in elastic_keys if key in entries}
    arguments = {key: entries[key] for key in non_elastic_keys if key in entries}
    if elastic_keys:
        arguments |= _lame_moduli(section, name, moduli) if "lmbda" in parameters else _find_mu(section, name, moduli)
    return _make_law(section, lambda: law_class(**arguments)), entries


def _make_law(section: TomlTable, make: Callable[[], LawType]) -> LawType:
    try:
        return make()
    except (InputError, TypeError, ValueError) as error:
        section.refuse(str(error))


def _read_sublayers(section: TomlTable, key: str) -> list[tuple[float, BulkLaw]]:
    explanation, tables = "share of the thickness", section.tables(key, "a fraction of the thickness and a law")
    laws = [_read_law(table, {"fraction": positive_reader(explanation)}, {"fraction": explanation}) for table in tables]
    return [(entries["fraction"], law) for law, entries in laws]


def _read_parameter(section: TomlTable, key: str) -> object:
    """Return the parameter of a law at `key` in the table `section`: a list as an array, any other value as it is."""
    value = section.values[key]
    try:
        return np.array(value, float) if isinstance(value, list) else value
    except (TypeError, ValueError):
        section.refuse("it must be a table of numbers", key)


def _find_mu(section: TomlTable, name: str, moduli: Mapping[str, float]) -> dict[str, float]:
    """Return {"mu": shear modulus} for an incompressible law, from the one modulus that the user gives.

    Args:
        section: table of the law, for errors.
        name: name of the law, for errors.
        moduli: the given modulus: "mu", "G" (the same) or "E", which is 3 mu.
    """
    if len(moduli) != 1:
        section.refuse(f"moduli are {' and '.join(moduli) or 'missing'}; {name} has one: mu (which is G), or E = 3 mu")
    ((key, value),) = moduli.items()
    return {"mu": value / 3 if key == "E" else value}


def _lame_moduli(section: TomlTable, name: str, moduli: Mapping[str, float]) -> dict[str, float]:
    """Return Lamé's moduli, {"lmbda": ..., "mu": ...}, of an isotropic law, from two constants that the user gives.

    Args:
        section: table of the law, for errors.
        name: name of the law, for errors.
        moduli: the given constants: E and nu, G and nu, K and G, or lmbda and mu. Other sets are refused.
    """
    constants = {"G" if key == "mu" and "lmbda" not in moduli else key: value for key, value in moduli.items()}
    if len(moduli) != 2 or constants.keys() not in ({"E", "nu"}, {"G", "nu"}, {"K", "G"}, {"lmbda", "mu"}):
        section.refuse(f"moduli are {' and '.join(moduli) or 'missing'}; {name} has a pair: {ELASTIC_PAIRS_TEXT}")
    if "lmbda" in constants:
        return constants
    if "K" in constants:
        return {"lmbda": constants["K"] - 2 * constants["G"] / 3, "mu": constants["G"]}
    make, modulus = (LinearElastic.young, "E") if "E" in constants else (LinearElastic.shear, "G")
    law = _make_law(section, lambda: make(constants[modulus], constants["nu"]))
    return {"lmbda": law.lmbda, "mu": law.mu}
