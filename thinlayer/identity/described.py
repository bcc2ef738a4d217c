"""Descriptions of data and code that two runs can compare."""

from __future__ import annotations

import random
from typing import Any

import numpy as np

from thinlayer.identity.containers import Brief
from thinlayer.identity.describer import SAME, Describer, followed
from thinlayer.identity.values import digest, name_of

MANY = 1000  # largest number of parts of a container that are described one by one


def described(value: Any) -> Any:
    """A value as JSON that is the same in another process, on any number of ranks, if the value is.

    Numbers, texts, arrays and containers of them stand for themselves; the order of a dict or set does not count. Of
    dataclasses (laws) the parameters count and the code of the class; of functions the code, the defaults, the attributes,
    and the data and functions that the code refers to. Functions that are the user's own, or in the same file or in none,
    are followed in the same way; for others only the values they close over count. For the user's modules, and for
    namespaces, the names count that the code reads. Other objects are described by the data that a copy is made from
    (`copyreg`, `__reduce_ex__`), the user's and callable ones by their attributes without cached properties, and the
    package's own by their method `identity`. Locks, standard streams and callable objects of a library's module count by
    name. Anything else, such as an open file or a function on a mesh, differs from the same object in another process.

    The content of files, `sys.argv`, `os.environ` and other data outside the process are not described.

    Raises:
        ModelError: objects refer to one another in a chain that is too long to follow.
    """
    with followed(name_of(type(value))):
        return Describer().of(value)


def in_full(value: Any) -> Any:
    """The description of a value with all its parts in place of hashes, as nested dicts and lists; see `described`."""
    with followed(name_of(type(value))):
        return _expanded(Describer(whole=True).of(value), {})


def referred(function: Any) -> dict[str, Any]:
    """Name -> description in full of an object that a function's code refers to; "(code)" is the code itself."""
    found = in_full(function)
    return found if isinstance(found, dict) else {"(function)": found}


def random_states(value: Any, shared: bool = False) -> list[str]:
    """The states of the generators of random numbers and iterators that a value refers to.

    With `shared` also of those that `random` and `numpy.random` share with all, unless its code seeds them.
    """
    found = Describer()
    with followed(name_of(type(value))):
        found.of(value)
        if shared and not found.seeds:
            found.of([random.random, np.random.random])
    return found.random


def _expanded(found: Any, seen: dict[int, str], path: str = "") -> Any:
    """A description with its parts; repeated parts refer to their first place, large containers are hashed."""
    if isinstance(found, Brief) and found.parts is not None:
        if id(found) in seen:
            return {SAME: seen[id(found)]}
        seen[id(found)] = path
        return _expanded(found.parts, seen, path)
    if isinstance(found, (dict, list)) and len(found) > MANY:
        return f"{len(found)} parts, {digest(found)}"
    if isinstance(found, dict):
        return {key: _expanded(found[key], seen, f"{path}.{key}") for key in sorted(found)}
    if isinstance(found, list):
        return [_expanded(one, seen, f"{path}.{k}") for k, one in enumerate(found)]
    return found
