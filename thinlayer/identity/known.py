"""Objects of libraries that are known by a name in every process, or in one process alone."""

from __future__ import annotations

import random
import sys
import types
import uuid
from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy.special
import ufl
from ufl.algorithms.signature import compute_expression_signature
from ufl.constantvalue import ConstantValue
from ufl.core.multiindex import MultiIndex
from ufl.corealg.traversal import traverse_unique_terminals

from thinlayer.identity.values import name_of

OPAQUE = ("basix", "dolfinx", "petsc4py", "ufl")  # packages whose objects differ from one process to the next
GOES_ON = (  # what gives other numbers each time
    np.random.Generator, np.random.BitGenerator, np.random.RandomState, np.random.SeedSequence, random.Random, Iterator,
)  # fmt: skip
LOCKS = ("_thread.lock", "_thread.RLock")
STREAMS = (sys.__stdin__, sys.__stdout__, sys.__stderr__)
PROCESS = uuid.uuid4().hex[:8]
_ALONE: dict[int, Any] = {}  # objects that only this process knows; kept so that their ids are not reused


def known_as(value: Any) -> str | None:
    """Name of an object that is equal in all processes, without the objects that it holds; None if there is none."""
    kind = type(value)
    if isinstance(value, ufl.core.expr.Expr) and all(
        isinstance(one, (ConstantValue, MultiIndex)) for one in traverse_unique_terminals(value)
    ):
        signature = compute_expression_signature(value, {})  # free indices are numbered by process
        return f"{name_of(kind)}, {signature[:12]}"
    if kind.__module__.partition(".")[0] == "mpi4py" or name_of(kind) in LOCKS:  # communicators and locks hold no data
        return name_of(kind)
    if any(value is one for one in (*STREAMS, sys.stdin, sys.stdout, sys.stderr)):
        return "a standard stream"
    if isinstance(value, np.ufunc):
        known = value in (getattr(np, value.__name__, None), getattr(scipy.special, value.__name__, None))
        return f"ufunc {value.__name__}" if known else None
    if isinstance(value, types.BuiltinFunctionType) and isinstance(
        value.__self__, (type, types.ModuleType, type(None))
    ):
        return f"{value.__module__}.{value.__qualname__}"
    return None


def only_here(value: Any) -> str:
    """Name of an object that only this process knows."""
    _ALONE[id(value)] = value
    return f"{name_of(type(value))}, which no other process knows ({PROCESS} {id(value)})"
