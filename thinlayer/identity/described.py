"""What results were made from, as text and numbers that two runs can compare."""

from __future__ import annotations

from typing import Any

from thinlayer.identity.containers import Brief
from thinlayer.identity.describer import SAME, Describer, followed
from thinlayer.identity.values import digest, name_of

MANY = 1000  # parts of a container that are told apart


def described(value: Any) -> Any:
    """A value as JSON that is the same in another process, on any number of ranks, if the value is.

    Numbers, texts, arrays and containers of them stand for themselves; the order of a dict or set does not count. Of
    dataclasses (laws) the parameters count and the code of the class; of functions the code, the defaults, the attributes,
    and what the code refers to, again and again where that is the user's own, stands in the same file or in none, and of
    others the values they close over. Of modules of the user's, and of namespaces, the names count that the code reads. Of
    other objects what they are copied from counts (`copyreg`, `__reduce_ex__`), of the user's and of callable ones the
    attributes but cached properties; the package's own say themselves what does (`identity`). Locks, standard streams and
    callable objects that a library's module has count by name. What has nothing of all this, such as an open file or a
    function on a mesh, is the same as itself alone: in another process it is another one.

    Not seen are the content of files, `sys.argv`, `os.environ`, and whatever else code asks of the world around it.

    Raises:
        ModelError: things that refer to one another in a chain too long to follow.
    """
    with followed(name_of(type(value))):
        return Describer().of(value)


def in_full(value: Any) -> Any:
    """The same with all parts, none of them behind a digest: dicts and lists in one another. Errors as in `described`."""
    with followed(name_of(type(value))):
        return _expanded(Describer(whole=True).of(value), {})


def referred(function: Any) -> dict[str, Any]:
    """The same of a function: name -> what its code refers to by it; "(code)" is the code itself."""
    found = in_full(function)
    return found if isinstance(found, dict) else {"(function)": found}


def _expanded(found: Any, seen: dict[int, str], path: str = "") -> Any:
    """A description with its parts; of what it meets again where it was met, of large containers a digest."""
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
