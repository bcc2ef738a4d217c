"""What the class of a law declares, checked."""

from __future__ import annotations

import inspect
import logging
import math
import sys
import warnings
from collections.abc import Mapping
from typing import Any

from forms.base import PACKAGES, InputError, is_number

DEFAULTS = tuple(f"forms.{name}" for name in ("law", "traction", "kernel", "contact", "series"))  # of the base classes
ANSWERS = ("stress", "traction", "kernel", "source")  # of a law to a strain
CHANGES = ("advance", "evolve")  # of its memory
OF_ANSWERS = ("stiffness", "gradient", "plane_stress", "otherwise", "energetic")  # what is written for one stress alone
ENERGIES = ("energy", "dissipation", "dissipated")
SIZES = {(): 1, (3,): 3, (3, 3): 6}  # numbers in an internal variable of a shape
SWITCHED = ("phase", "drive", "bound")  # internal variables of a law whose phases switch


class LawError(InputError):
    """A parameter out of range, or a law used where it is not defined; says what, where and what is allowed."""


class RangeWarning(UserWarning):
    """A law, a model or a result outside the range in which it is accurate: the message has the number and the remedy."""


def warn_of_range(message: str) -> None:
    """Issue a RangeWarning, at the line that called this package."""
    show_warnings()
    level, frame = 1, sys._getframe()
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] in PACKAGES:
        level, frame = level + 1, frame.f_back
    warnings.warn(message, RangeWarning, stacklevel=level)


def show_warnings() -> None:
    """FFCx sends all warnings to a log as it is imported: where nobody listens to it, show them again."""
    handlers = [*logging.getLogger("py.warnings").handlers, *logging.getLogger().handlers]
    if all(isinstance(handler, logging.NullHandler) for handler in handlers):
        logging.captureWarnings(False)


def require_dataclass(kind: type) -> None:
    """Raise LawError if a class has parameters of its own and no constructor that takes them."""
    own = [n for n, note in inspect.get_annotations(kind).items() if "ClassVar" not in str(note)]
    if own and "__dataclass_params__" not in vars(kind):
        raise LawError(f"{kind.__name__} is no dataclass: write @dataclass(frozen=True) above the class")


def take_back(kind: Any) -> None:
    """Give a class the defaults in place of what it inherits and was written for another stress than its own.

    What a class writes itself stays, also as `plane_stress = Parent.plane_stress`. So do traits that are checked or only
    choose among the solvers (`linear`, `symmetric`, ...), and what belongs to parameters alone (`powers`, `at`). An energy
    stays where it is checked against the stress, or where the class writes one of `ENERGIES` beside it.
    """
    for name in OF_ANSWERS:
        if _is_of_another(kind, name, ANSWERS + CHANGES):
            _reset(kind, name)
    written = [name for name in ENERGIES if _own(kind, name)]
    unchecked = getattr(kind, "rate", False) or kind.internal or not getattr(kind, "symmetric", True)
    if unchecked and all(_is_of_another(kind, name, ANSWERS) for name in written):
        for name in written:
            _reset(kind, name)
    if _own(kind, "quadratic") and _place(kind, "energy") < _place(kind, "quadratic"):
        kind.quadratic = False


def _is_of_another(kind: Any, name: str, answers: tuple[str, ...]) -> bool:
    """Whether what a class has of this name is inherited from above one of its answers: written for other ones.

    In a base class without answers it is written for the first ones below it. A memory that is added changes no answer.
    """
    if not _own(kind, name):
        return False
    above = reversed(kind.__mro__[: _place(kind, name) + 1])
    now = _answers(kind, answers)
    before = next((found for one in above if (found := _answers(one, answers))), now)
    return any(before.get(one) is not now.get(one) for one in answers if one in before or one not in CHANGES)


def _answers(kind: Any, names: tuple[str, ...]) -> dict[str, Any]:
    """What a class has of these names that is not the default of all laws."""
    return {name: inspect.getattr_static(kind, name) for name in names if _own(kind, name)}


def _place(kind: Any, name: str) -> int:
    """Which class in the order of inheritance has something of this name, counted from the class itself."""
    return next((k for k, one in enumerate(kind.__mro__) if name in vars(one)), len(kind.__mro__))


def _reset(kind: Any, name: str) -> None:
    """Give a class the default of all laws."""
    defaults = (vars(one)[name] for one in kind.__mro__ if one.__module__ in DEFAULTS and name in vars(one))
    setattr(kind, name, next(defaults, None))


def require_declarations(law: Any) -> None:
    """Raise LawError unless what the class of a law declares fits its parameters and its methods."""
    kind, known = type(law), law.parameters()
    require_dataclass(kind)
    if not isinstance(law.powers, Mapping) or not isinstance(law.internal, Mapping):
        raise LawError(f"{kind.__name__}: powers is {{parameter: power}}, internal is {{name: shape}}")
    for name, power in law.powers.items():
        if name not in known:
            raise LawError(f"{kind.__name__}: powers has {name!r}; parameters: {', '.join(known) or 'none'}")
        if not is_number(power) or not math.isfinite(power):
            raise LawError(f"{kind.__name__}: the power of {name} is {power!r}; allowed: a finite number")
    for name in law.functions:
        if callable(known.get(name)):
            raise LawError(
                f"{kind.__name__}: parameters() gives a function for {name}; it must give a number, NaN where it varies"
            )
    for name, shape in law.internal.items():
        if shape not in SIZES:
            allowed = ", ".join(map(str, SIZES))
            raise LawError(f"{kind.__name__}: internal variable {name!r} has the shape {shape!r}; allowed: {allowed}")
    _require_phases(law)
    _require_asked(law)


def _require_asked(law: Any) -> None:
    """Refuse a method, or a law otherwise, that nobody would ask: what it says would be ignored."""
    kind, name = type(law), type(law).__name__
    answering = min(_place(kind, one) for one in ("kernel", "source", "ignored"))
    for one in kind.ignored:
        if _own(kind, one) and _place(kind, one) < answering:
            raise LawError(
                f"{name} has a method {one} that is never asked: the answers are the kernel, the source, the sublayers or "
                f"the traction of {kind.__mro__[answering].__name__}; change those, or write a BulkLaw"
            )
    if getattr(kind, "source", None) is not None and _place(kind, "kernel") < _place(kind, "source"):
        raise LawError(
            f"{name} has a kernel and inherits a source, which would be taken; write source = None in the class"
        )
    advancing = [one for one in ("advance", "evolve") if _own(kind, one)]
    if advancing and not law.internal:
        raise LawError(
            f"{name} has a method {advancing[0]} and no internal variables; write internal = {{name: shape}}"
        )
    if (_own(kind, "dissipation") or _own(kind, "dissipated")) and not law.traits.has_energy:
        raise LawError(f"{name} declares a dissipation and no energy; write a method energy(step) too")
    if _own(kind, "at") and (not _own(kind, "varies") or inspect.getattr_static(kind, "varies") is False):
        raise LawError(f"{name} has a method at, and says that no parameters vary; write varies = True in the class")
    if _own(kind, "otherwise") and kind.otherwise is not None and not law.traits.compiled:
        raise LawError(f"{name} has a law otherwise, and holds everywhere; write a method holds(step), a UFL condition")


def _own(kind: Any, name: str) -> bool:
    """Whether a class has something of this name that is not the default of all laws."""
    defining = next((one for one in kind.__mro__ if name in vars(one)), None)
    if defining is None or defining.__module__ in DEFAULTS:
        return False
    return getattr(vars(defining)[name], "__module__", None) not in DEFAULTS  # a default may be taken back: Law.advance


def _require_phases(law: Any) -> None:
    kind, name = type(law), type(law).__name__
    if getattr(kind, "phases", False) is True and law.internal.get("phase") != ():
        raise LawError(f"{name} has phases = True; it needs an internal variable 'phase' of shape (), a UFL law")
    if getattr(kind, "switches", False) is not True:
        return
    if getattr(kind, "phases", False) is not True or any(law.internal.get(one) != () for one in SWITCHED):
        raise LawError(f"{name} has switches = True; it needs phases = True and the scalars {SWITCHED} in internal")
    for method in ("excess", "switched"):
        if not callable(getattr(law, method, None)):
            raise LawError(f"{name} has switches = True; it needs a method {method}, see NonMonotoneUnrelaxed")
