"""Short forms of a description's entries, as words of a command line: "glue: LinearElastic E=2000 nu=0.4"."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from typing import Any

from thinlayer.describing.section import DescriptionError, Path

TEXTS = ("place", "seam", "side", "frame")  # keys whose values are names, also where these look like numbers
Entry = tuple[Path, Any]  # keys of an entry of the description, and its value


def value_of(text: str) -> Any:
    """A number, numbers parted by commas, or the text itself."""
    parts = text.split(",")
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        return text
    return numbers[0] if len(numbers) == 1 else numbers


def _pairs(text: str, form: str) -> tuple[list[str], dict[str, Any]]:
    """Words without and with "=" of a text."""
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise DescriptionError(f"{error}; {form}") from None
    alone = [word for word in words if "=" not in word]
    pairs = [word.partition("=") for word in words if "=" in word]
    keys = [key for key, _, _ in pairs]
    for key, _, value in pairs:
        if not key or not value:
            raise DescriptionError(f"{key}={value} has no {'value' if key else 'key'}; {form}")
        if keys.count(key) > 1:
            raise DescriptionError(f"{key} is given twice; {form}")
    return alone, {key: value if key in TEXTS else value_of(value) for key, _, value in pairs}


def _named(text: str) -> tuple[str | None, str]:
    """The name before a colon, and the rest."""
    found = re.match(r"\s*([^:=]+?)\s*:(.*)", text, re.DOTALL)
    return (found[1], found[2]) if found else (None, text)


def law(key: str) -> Callable[[str], Entry]:
    """Reads "[NAME:] [LAW] PARAMETER=VALUE ..." as an entry of body or layer."""
    form = f'--{key} takes "[NAME:] [LAW] PARAMETER=VALUE ...", such as "E=2e3 nu=0.4' + (
        ' eps=0.2"' if key == "layer" else '"'
    )

    def entry(text: str) -> Entry:
        name, rest = _named(text)
        alone, values = _pairs(rest, form)
        if len(alone) > 1 or not (alone or values):
            raise DescriptionError(f"{' and '.join(map(repr, alone)) or 'nothing'} cannot be a law; {form}")
        return ((key,) if name is None else (key, name)), ({"law": alone[0]} if alone else {}) | values

    return entry


def support(text: str) -> Entry:
    """Reads "PLACE=VALUE" or "PLACE COMPONENT=VALUE ..."."""
    form = '--support takes "PLACE=VALUE" or "PLACE x=VALUE y=VALUE", such as LEFT=0 or "(40,0) y=0"'
    place, values = _at_place(text, "xyzn", form)
    return ("supports", place), values


def load(text: str) -> Entry:
    """Reads "PLACE=VECTOR", "PLACE pressure=VALUE", or "(X,Y)=FORCE [body=REGION]"."""
    form = '--load takes "PLACE=VECTOR" or "PLACE pressure=VALUE", such as TOP=0,-50, or a force, "(20,10)=0,-300"'
    body = re.fullmatch(r"(.*\S)\s+body=(\S.*)", text, re.DOTALL)
    place, value = _at_place(body[1] if body else text, ("pressure",), form)
    if place.startswith("("):
        point = value_of(place.strip("()"))
        return ("loads",), {"place": point, "force": value} | ({"body": body[2].strip()} if body else {})
    if body:
        raise DescriptionError(f"body= is for forces at points; {form}")
    return ("tractions", place), value


def body_force(text: str) -> Entry:
    """Reads "VECTOR" or "NAME=VECTOR"."""
    name, equals, value = text.rpartition("=")
    return (("body_force", name.strip()) if equals else ("body_force",)), value_of(value)


def goal(text: str) -> Entry:
    """Reads "[NAME:] KIND [ARGUMENT=VALUE ...]"."""
    form = '--goal takes "[NAME:] KIND ARGUMENT=VALUE ...", such as compliance or "reaction place=LEFT direction=1,0"'
    name, rest = _named(text)
    alone, values = _pairs(rest, form)
    if len(alone) != 1:
        raise DescriptionError(f"{' and '.join(map(repr, alone)) or 'nothing'} cannot be a goal; {form}")
    return ("goals", name or alone[0]), {"kind": alone[0]} | values


def tolerance(text: str) -> Entry:
    """Reads "VALUE" or "QUANTITY=VALUE"."""
    name, equals, value = text.rpartition("=")
    return (("tolerance", name.strip()) if equals else ("tolerance",)), value_of(value)


def _at_place(text: str, keys: Any, form: str) -> tuple[str, Any]:
    """A place, and its value or {key: value}."""
    point = re.match(r"\s*\(([^()]*)\)", text)
    if point and isinstance(numbers := value_of(point[1]), list):  # as keys are written in messages
        text = f"({', '.join(f'{c:g}' for c in numbers)}){text[point.end() :]}"
    names = "|".join(keys)
    several = re.fullmatch(rf"\s*(\S.*?)\s*:?((?:\s+(?:{names})=\S+)+)\s*", text, re.DOTALL)
    if several:
        return several[1].rstrip(": "), _pairs(several[2], form)[1]
    one = re.fullmatch(r"\s*([^=]*[^=\s])\s*=\s*(\S[^=]*)", text, re.DOTALL)
    if not one:
        raise DescriptionError(f"{text!r} cannot be read; {form}")
    return one[1], value_of(one[2])
