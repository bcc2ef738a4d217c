"""Laws by their names in `forms`, with real parameters by their names, and pairs of elastic moduli."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import MISSING, fields
from functools import cache
from typing import Any, NoReturn

import forms.laws
from forms.base import unknown
from forms.elastic import LinearElastic
from forms.kernel import KernelLaw
from forms.law import BulkLaw, Law, LawError, scalars
from forms.series import Stack
from thinlayer.describing.section import Section, as_array

DEFAULT = "LinearElastic"
ELASTIC = ("E", "nu", "K", "G", "mu", "lmbda")
PAIRS = "E and nu, G and nu, K and G, or lmbda and mu (G is mu)"


@cache
def known_laws() -> dict[str, type[BulkLaw]]:
    """The laws of strains that a description may name."""
    found = {name: getattr(forms.laws, name) for name in forms.laws.__all__}
    bases = (BulkLaw, KernelLaw)
    return {
        name: kind
        for name, kind in found.items()
        if isinstance(kind, type) and issubclass(kind, BulkLaw) and kind not in bases
    }


def law_of(section: Section, beside: Collection[str] = ()) -> BulkLaw:
    """The law of a table, with the parameters that stand there.

    Args:
        section: {law: its name, parameter: value}, or {sublayers: tables of laws, each with its fraction}.
        beside: other keys of the table.

    Raises:
        DescriptionError: an unknown law or parameter, one that is missing, moduli that are no pair, or a law's own error.
    """
    if "sublayers" in section.values or section.values.get("law") == "Stack":
        return _stack(section, beside)
    name = section.text("law") or DEFAULT
    if name not in known_laws():
        _refuse_law(section, name)
    kind: Any = known_laws()[name]
    parameters = {f.name: f for f in fields(kind) if f.init}
    elastic = [one for one in ELASTIC if {"lmbda", "mu"} <= parameters.keys()]
    elastic += ["E", "G"] if "mu" in parameters and not elastic else []
    section.allow([*dict.fromkeys(["law", *elastic, *parameters, *beside])], f"key of {name}")
    given = {key: _value(section, key, kind) for key in parameters if key in section.values}
    if elastic:
        given |= _moduli(section, name) if "lmbda" in parameters else _shear(section, name)
    for key, one in parameters.items():
        if key not in given and one.default is MISSING:
            section.refuse(f"{key} is missing; {name} has {_has(parameters, elastic)}")
    try:
        return kind(**given)
    except (LawError, TypeError, ValueError) as error:
        section.refuse(str(error))


def _stack(section: Section, beside: Collection[str]) -> Stack:
    section.allow(["law", "sublayers", *beside], "key of Stack")
    if section.values.get("law", "Stack") != "Stack":
        section.refuse(f"sublayers are those of a Stack, not of {section.values['law']!r}", "law")
    each = section.tables("sublayers", "a fraction of the thickness and a law")
    pairs = [(one.positive("fraction", "share of the thickness"), law_of(one, ["fraction"])) for one in each]
    try:
        return Stack(*pairs)
    except LawError as error:
        section.refuse(str(error), "sublayers")


def _refuse_law(section: Section, name: str) -> NoReturn:
    other: Any = getattr(forms.laws, name, None)
    if isinstance(other, type) and issubclass(other, Law) and other not in (BulkLaw, KernelLaw):
        section.refuse(
            f"{name} is no law of strains with a thickness; laws here: {', '.join(sorted(known_laws()))}", "law"
        )
    section.refuse(unknown("law", name, known_laws()), "law")


def _value(section: Section, key: str, kind: Any) -> Any:
    """The value of a parameter: a number where the law has a number, else what is given, lists as arrays."""
    if key in scalars(kind):
        return section.number(key)
    try:
        return as_array(section.values[key])
    except (TypeError, ValueError):
        section.refuse("it needs a table of numbers", key)


def _has(parameters: Collection[str], elastic: Collection[str]) -> str:
    others = [name for name in parameters if name not in ("lmbda", "mu")] if elastic else [*parameters]
    return ", ".join([*([PAIRS] if elastic else []), *others])


def _positive(section: Section, *keys: str) -> list[float]:
    return [section.positive(key, "a modulus") for key in keys]


def _shear(section: Section, name: str) -> dict[str, float]:
    """The shear modulus of an incompressible law."""
    given = [key for key in ("E", "G", "mu") if key in section.values]
    if len(given) != 1:
        section.refuse(f"moduli are {' and '.join(given) or 'missing'}; {name} has one: mu (which is G), or E = 3 mu")
    (value,) = _positive(section, *given)
    return {"mu": value / 3 if given == ["E"] else value}


def _moduli(section: Section, name: str) -> dict[str, float]:
    """Lame's moduli from a pair of elastic constants."""
    given = [key for key in ELASTIC if key in section.values]
    pair = {"G" if key == "mu" and "lmbda" not in given else key for key in given}
    if len(given) != 2 or pair not in ({"E", "nu"}, {"G", "nu"}, {"K", "G"}, {"lmbda", "mu"}):
        section.refuse(f"moduli are {' and '.join(given) or 'missing'}; {name} has a pair: {PAIRS}")
    if "nu" in given and not -1 < (section.number("nu") or 0.0) < 0.5:
        hint = "; laws with nu = 1/2: Incompressible" if section.values["nu"] == 0.5 else ""
        section.refuse(f"nu is {section.values['nu']!r}; allowed: -1 < nu < 0.5{hint}", "nu")
    shear = next((key for key in ("G", "mu") if key in given), "")
    if pair == {"lmbda", "mu"}:
        return {"lmbda": float(section.number("lmbda") or 0.0), "mu": float(section.number("mu") or 0.0)}
    if pair == {"K", "G"}:
        K, G = _positive(section, "K", shear)
        return {"lmbda": K - 2 * G / 3, "mu": G}
    nu = float(section.number("nu") or 0.0)
    (modulus,) = _positive(section, "E" if "E" in given else shear)
    law = LinearElastic.young(modulus, nu) if "E" in given else LinearElastic.shear(modulus, nu)
    return {"lmbda": law.lmbda, "mu": law.mu}
