"""Laws by their names in `forms`, with real parameters by their names; pairs of elastic moduli; layers' thicknesses."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import MISSING, dataclass, fields
from functools import cache
from typing import Any

import numpy as np

import forms.laws
from forms.base import unknown
from forms.elastic import LinearElastic
from forms.kernel import KernelLaw
from forms.law import BulkLaw, LawError, scalars
from forms.series import Stack
from thinlayer.describing.section import Section

ELASTIC = ("E", "nu", "K", "G", "mu", "lmbda")
PAIRS = "E and nu, G and nu, K and G, or lmbda and mu (G is mu)"


@dataclass(frozen=True)
class Material:
    """A law with real parameters, and what else belongs to it.

    Attributes:
        law: the law.
        eps: thickness of a layer; 0: of a body.
        eigenstrain: strain that it would have without stress; None: none.
    """

    law: BulkLaw
    eps: float
    eigenstrain: float | None


def materials(section: Section, key: str, *, thin: bool) -> dict[str | None, Material]:
    """The materials in the table of a key, of layers with a thickness, by name; None stands for all.

    Raises:
        DescriptionError: an unknown law or parameter, one that is missing, moduli that are no pair, or a law's own error.
    """
    what = "the parameters of a law, such as E and nu"
    if not section.values.get(key):
        section.refuse(f"{key} is missing: {what}, in a table [{key}]")
    whole = section.table(key, what)
    inside = [isinstance(value, dict) for value in whole.values.values()]
    if any(inside) and not all(inside):
        whole.refuse(f"it has tables with names beside keys without one; give each name a table with {what}")
    tables = {name: whole.table(name, what) for name in whole.values} if any(inside) else {None: whole}
    beside = ["eps", "eigenstrain"] if thin else ["eigenstrain"]
    return {
        name: Material(
            _law(one, beside),
            one.positive("eps", "the thickness of the layer, a length") if thin else 0.0,
            one.number("eigenstrain") if "eigenstrain" in one.values else None,
        )
        for name, one in tables.items()
    }


@cache
def known_laws() -> dict[str, type[BulkLaw]]:
    """The laws of strains that a description may name."""
    found = {name: getattr(forms.laws, name) for name in forms.laws.__all__}
    return {
        name: kind
        for name, kind in found.items()
        if isinstance(kind, type) and issubclass(kind, BulkLaw) and kind not in (BulkLaw, KernelLaw)
    }


def _law(section: Section, beside: Collection[str]) -> BulkLaw:
    """The law {law: its name, parameter: value}, or {sublayers: ...}, of a table with other keys beside these."""
    if "sublayers" in section.values or section.values.get("law") == "Stack":
        section.allow(["law", "sublayers", *beside], "key of Stack")
        if section.values.get("law", "Stack") != "Stack":
            section.refuse(f"sublayers are those of a Stack, not of {section.values['law']!r}", "law")
        each = section.tables("sublayers", "a fraction of the thickness and a law")
        pairs = [(one.positive("fraction", "share of the thickness"), _law(one, ["fraction"])) for one in each]
        try:
            return Stack(*pairs)
        except LawError as error:
            section.refuse(str(error), "sublayers")
    name = section.text("law") or "LinearElastic"
    if name not in known_laws():
        section.refuse(unknown("law of strains", name, known_laws()), "law")
    kind: Any = known_laws()[name]
    parameters = {f.name: f for f in fields(kind) if f.init}
    pair, shear = {"lmbda", "mu"} <= parameters.keys(), "mu" in parameters
    elastic = ELASTIC if pair else ("E", "G") if shear else ()
    section.allow([*dict.fromkeys(["law", *elastic, *parameters, *beside])], f"key of {name}")
    given = {key: _value(section, key, kind) for key in parameters if key in section.values}
    if shear:
        given |= _pair(section, name) if pair else {"mu": _shear(section, name)}
    for key, one in parameters.items():
        if key not in given and one.default is MISSING:
            others = [one for one in parameters if not (shear and one in ("lmbda", "mu"))]
            section.refuse(f"{key} is missing; {name} has {', '.join([PAIRS, *others] if shear else others)}")
    try:
        return kind(**given)
    except (LawError, TypeError, ValueError) as error:
        section.refuse(str(error))


def _value(section: Section, key: str, kind: Any) -> Any:
    """The value of a parameter: a number where the law has a number, else what is given, lists as arrays."""
    if key in scalars(kind):
        return section.number(key)
    value = section.values[key]
    try:
        return np.array(value, float) if isinstance(value, list) else value
    except (TypeError, ValueError):
        section.refuse("it needs a table of numbers", key)


def _shear(section: Section, name: str) -> float:
    """The shear modulus of an incompressible law."""
    given = [key for key in ("E", "G", "mu") if key in section.values]
    if len(given) != 1:
        section.refuse(f"moduli are {' and '.join(given) or 'missing'}; {name} has one: mu (which is G), or E = 3 mu")
    value = section.positive(given[0], "a modulus")
    return value / 3 if given == ["E"] else value


def _pair(section: Section, name: str) -> dict[str, float]:
    """Lame's moduli from a pair of elastic constants."""
    given = {key: section.number(key) for key in ELASTIC if key in section.values}
    known = {"G" if key == "mu" and "lmbda" not in given else key: value for key, value in given.items()}
    if len(given) != 2 or known.keys() not in ({"E", "nu"}, {"G", "nu"}, {"K", "G"}, {"lmbda", "mu"}):
        section.refuse(f"moduli are {' and '.join(given) or 'missing'}; {name} has a pair: {PAIRS}")
    if "lmbda" in known:
        return known
    for key in given.keys() - {"nu"}:
        section.positive(key, "a modulus")
    if "K" in known:
        return {"lmbda": known["K"] - 2 * known["G"] / 3, "mu": known["G"]}
    if not -1 < known["nu"] < 0.5:
        hint = "; laws with nu = 1/2: Incompressible" if known["nu"] == 0.5 else ""
        section.refuse(f"nu is {known['nu']!r}; allowed: -1 < nu < 0.5{hint}", "nu")
    law = LinearElastic.young(known["E"], known["nu"]) if "E" in known else LinearElastic.shear(known["G"], known["nu"])
    return {"lmbda": law.lmbda, "mu": law.mu}
