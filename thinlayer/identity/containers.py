"""Containers, arrays and their parts in a description."""

from __future__ import annotations

import collections
import collections.abc
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from thinlayer.identity.known import only_here
from thinlayer.identity.values import digest, name_of, plain, text_of

VIEWS = (collections.abc.KeysView, collections.abc.ValuesView, collections.abc.ItemsView)
FEW = 24  # largest number of entries that are shown themselves; longer arrays are hashed


class Brief(str):
    """A short text, and the parts that it stands for."""

    parts: Any


class Containers(ABC):
    """Descriptions of containers and of objects with parts; `whole`: keep the parts beside their hash."""

    def __init__(self, whole: bool) -> None:
        self._whole = whole
        self._alone: list[str] = []  # names of objects that only this process knows

    @abstractmethod
    def of(self, value: Any, home: str = "") -> Any:
        """A value that stands in, or is referred to from, the module `home`."""

    def content(self, value: Any, home: str) -> Any:
        """Content of a container, or of a number or text of a subclass; None for anything else."""
        if isinstance(value, np.ma.MaskedArray):
            return [self.array(value.data), self.array(np.ma.getmaskarray(value))]
        if isinstance(value, np.ndarray):
            return self.array(value)
        if isinstance(value, memoryview):
            return f"memoryview {value.format} {value.shape}, {digest(value.tobytes())}"
        if isinstance(value, (dict, Mapping)):
            content = self.named(value, home)
            if isinstance(value, collections.OrderedDict):  # whose order counts when it is compared, too
                content["(order)"] = [self._key(key, home) for key in value]
            if isinstance(value, collections.defaultdict):
                content["(default)"] = self.of(value.default_factory, home)
            return content
        if isinstance(value, (list, tuple, *VIEWS)):
            if len(value) > FEW and {*map(type, value)} == {float}:
                return f"{len(value)} numbers, {digest(np.array([*value]).tobytes())}"
            return [self.of(one, home) for one in value]
        if isinstance(value, (set, frozenset)):
            return {self._key(one, home): "in the set" for one in value}
        return plain(value)

    def named(self, values: Mapping[Any, Any], home: str) -> dict[str, Any]:
        """Key -> value, in the same order in all processes: an object that appears twice is described the first time."""
        entries = sorted(((self._key(key, home), one) for key, one in values.items()), key=lambda entry: entry[0])
        return {key: self.of(one, home) for key, one in entries}

    def _key(self, key: Any, home: str) -> str:
        return key if type(key) is str else f"<{text_of(self.of(key, home))}>"

    def brief(self, what: str, compute: Callable[[], Any]) -> str:
        """Name of an object, hash of its parts, and names of parts that only this process knows."""
        before = len(self._alone)
        parts = compute()
        alone = ", ".join(dict.fromkeys(self._alone[before:]))
        return self.with_parts(
            parts, f"{what} {digest(parts)}" + f" with {alone}, which no other process knows" * bool(alone)
        )

    def with_parts(self, parts: Any, text: str) -> str:
        """A short text; in a description in full also its parts."""
        found = Brief(text)
        found.parts = parts if self._whole else None
        return found

    def as_one(self, kind: type, compute: Callable[[], Any]) -> str:
        """An object of a library, described as one: its parts may all change in use."""
        return str(self.brief(name_of(kind), compute))

    def only_here(self, value: Any) -> str:
        """An object that only this process knows; its name is recorded."""
        self._alone.append(name_of(type(value)))
        return only_here(value)

    def array(self, array: np.ndarray) -> Any:
        """Short arrays as numbers, long ones as a hash, other entries one by one."""
        if array.dtype.kind not in "biuf":
            return [list(array.dtype.names or ()), list(array.shape), [self.of(one) for one in array.ravel().tolist()]]
        if array.size <= FEW and np.isfinite(array).all():
            return self.of(array.tolist())
        return f"{array.dtype.name} {array.shape}, {digest(np.ascontiguousarray(array).tobytes())}"
