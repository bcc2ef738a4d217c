"""Texts with a unit, such as "2 GPa", as numbers in the units of a model."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

from forms.base import InputError, import_optional, require

QUANTITY = re.compile(r" *[-+]?(?:\d+\.?\d*+|\.\d+)(?:[eE][-+]?\d+)?+ *[^\d\s.,?][^,?\n]*")  # not 7e3, not 2,5 GPa
BASES = ("length", "mass", "time", "temperature")
DIMENSIONS = {  # kind of a quantity -> its dimension in pint
    "length": "[length]", "stress": "[pressure]", "time": "[time]", "ratio": "[]", "angle": "[]", "force": "[force]",
    "force per length": "[force]/[length]", "force per volume": "[force]/[length]**3",
}  # fmt: skip


def percent(x: float, sign: str = "") -> str:
    """Return a fraction as text in per cent, with two digits; with "+" as `sign`, with its sign."""
    return f"{100 * x:{sign}.2g} %" if abs(x) < 0.995 else f"{100 * x:{sign}.0f} %"


@dataclass(frozen=True)
class Units:
    """Units of all plain numbers of a model, by which texts with a unit become such numbers; needs the extra `units`.

    Numbers without a text stay as they are. Forces have the unit stress times length squared, angles that of degrees,
    temperatures kelvin.

    Attributes:
        length, stress: names of units, as pint knows them.
        time: name of the unit of times; None: the model has no times.

    Raises:
        InputError: not a name of such a unit; when called, a text that is not a number with a unit, or another kind.

    Example:
        >>> from thinlayer import Units
        >>> units = Units("mm", "MPa")
        >>> units("2 GPa"), units("200 um"), units("12e-6/K")
        (2000.0, 0.2, 1.2e-05)
        >>> units("2 mm", "stress")
        Traceback (most recent call last):
        ...
        forms.base.InputError: the stress is '2 mm'; give one with a unit of stress, not of length
    """

    length: str
    stress: str
    time: str | None = None

    def __post_init__(self) -> None:
        for kind in ("length", "stress", "time"):
            if (unit := getattr(self, kind)) is not None:
                _parse(f"1 {unit}", kind)

    def __call__(self, text: str, kind: str | None = None) -> float:
        """Return the number that a text such as "2 GPa" stands for, in these units.

        Args:
            text: a number and a unit.
            kind: what the text must be, a key of `DIMENSIONS`, such as "stress"; None: anything.
        """
        quantity = _parse(text, kind)
        length, mass, time, temperature = (quantity.dimensionality.get(f"[{base}]", 0) for base in BASES)
        is_angle = {name for name, _ in quantity.unit_items()} in ({"degree"}, {"radian"})
        exponents = {self.stress: mass, self.length: length + mass, "K": temperature, "deg": is_angle}
        exponents[self.time or ""] = time + 2 * mass  # a mass is a stress times length times time squared
        target = math.prod(_registry().Unit(unit) ** power for unit, power in exponents.items())
        require(quantity.is_compatible_with(target), "a quantity", text, "name a third unit, of times, such as 's'")
        return float(quantity.to(target).magnitude)


_registry: Callable[[], Any] = cache(lambda: import_optional("pint").UnitRegistry())


def _parse(text: str, kind: str | None) -> Any:
    """Return a text as a quantity of pint, after checks of it and of its kind."""
    registry = _registry()
    require(isinstance(text, str) and QUANTITY.fullmatch(text), "a quantity", text, "give a text such as '0.2 mm'")
    require(kind is None or kind in DIMENSIONS, "the kind of a quantity", kind, f"allowed: {', '.join(DIMENSIONS)}")
    try:
        quantity = 1 * registry.Quantity(text)  # refuses 20 degC, a temperature or a difference of two
    except Exception as error:  # of pint and of the tokenizer of Python
        raise InputError(f"{text!r} cannot be read ({error}); give a text such as '0.2 mm' or '12e-6/K'") from None
    kinds = [name for name, dimension in DIMENSIONS.items() if quantity.check(dimension)]
    actual = kinds[0] if kinds else quantity.dimensionality
    require(kind in (None, *kinds), f"the {kind}", text, f"give one with a unit of {kind}, not of {actual}")
    return quantity
