"""Where a description comes from: a file in TOML, words of the command line, or both."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path as File
from typing import Any

from thinlayer.describing import words
from thinlayer.describing.section import DescriptionError, Path, Section

OPTIONS = {
    "body": words.law("body"),
    "layer": words.law("layer"),
    "support": words.support,
    "load": words.load,
    "body-force": words.body_force,
    "goal": words.goal,
    "tolerance": words.tolerance,
}  # options of the command line that may be repeated -> how each is read
PLAIN = ("units", "plane", "element", "bodies", "times")  # options that are entries as they are
OF_MESH = ("S", "upper", "lower", "direction", "scale")  # options that are entries of mesh


@dataclass
class Source:
    """Entries of a description, with words for where each was given.

    Attributes:
        name: of the file, or of the command line.
        values: the entries.
        origins: keys of an entry that the file does not have -> words for where it was given.
    """

    name: str
    values: dict[str, Any] = field(default_factory=dict)
    origins: dict[Path, str] = field(default_factory=dict)

    @classmethod
    def read(cls, path: File) -> Source:
        """A description in TOML. The name of its mesh file is relative to its folder.

        Raises:
            DescriptionError: the file cannot be read, or is no TOML; the message has the line.
        """
        try:
            values = tomllib.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise DescriptionError(f"{path} cannot be read: {error.strerror}") from None
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise DescriptionError(f"{path} is no TOML: {error}") from None
        mesh = values.get("mesh")
        if isinstance(mesh, str):
            values["mesh"] = str(path.parent / mesh)
        elif isinstance(mesh, Mapping) and isinstance(mesh.get("path"), str):
            values["mesh"] = {**mesh, "path": str(path.parent / mesh["path"])}
        return cls(str(path), values)

    def section(self) -> Section:
        """All entries as one table."""
        return Section(self.values, (), self._told)

    def _told(self, path: Path) -> str:
        for k in range(len(path), 0, -1):
            if path[:k] in self.origins:
                return ": ".join([self.origins[path[:k]], *([".".join(path[k:])] if path[k:] else [])])
        return ": ".join([self.name, *([".".join(path)] if path else [])])

    def mesh(self, path: str) -> None:
        """Take another mesh file."""
        self._as_table("mesh", "path")
        self._put(("mesh", "path"), path, path)

    def take(self, option: str, given: Iterable[str] | str) -> None:
        """Take an option of the command line: it replaces or adds to what the file has.

        Raises:
            DescriptionError: its words cannot be read.
        """
        if option in PLAIN:
            assert isinstance(given, str)
            self._put((option,), _numbers(given) if option == "times" else given, f"--{option}")
        elif option in OF_MESH:
            self._as_table("mesh", "path")
            self._put(("mesh", option), _of_mesh(option, given), f"--{option}")
        else:
            for text in given:
                path, value = OPTIONS[option](text)
                self._merge(path, value, f"--{option} {text!r}")

    def _merge(self, path: Path, value: Any, origin: str) -> None:
        key = path[0]
        if key in ("body", "layer"):
            self._take_law(path, value, origin)
        elif key == "loads":
            loads = self.values.get("loads", [])
            self.values["loads"] = [*(loads if isinstance(loads, list) else []), value]
            self.origins["loads", str(len(self.values["loads"]))] = origin
        elif key == "goals" and self.origins.get(path):
            raise DescriptionError(f"{origin}: two goals are named {path[1]!r}; name them, --goal 'NAME: KIND ...'")
        else:
            if key == "tolerance":
                self._as_table("tolerance", "traction")
            self._put(path if key != "tolerance" or len(path) > 1 else (key, "traction"), value, origin)

    def _take_law(self, path: Path, value: dict[str, Any], origin: str) -> None:
        """A law that is named replaces the one in the file; parameters alone replace its parameters."""
        old: Any = self.values
        for key in path:
            old = old.get(key, {}) if isinstance(old, Mapping) else {}
        own = {k: v for k, v in old.items() if not isinstance(v, Mapping)} if isinstance(old, Mapping) else {}
        self._put(path, value if "law" in value else own | value, origin)

    def _as_table(self, key: str, inner: str) -> None:
        """Make an entry a table, of which a plain value is the entry `inner`."""
        value = self.values.get(key, {})
        if not isinstance(value, Mapping):
            value = {inner: value}
        self.values[key] = dict(value)

    def _put(self, path: Path, value: Any, origin: str) -> None:
        table = self.values
        for key in path[:-1]:
            inner = table.get(key)
            named = isinstance(inner, Mapping) and (
                path[0] not in ("body", "layer") or all(isinstance(one, Mapping) for one in inner.values())
            )
            table[key] = dict(inner) if isinstance(inner, Mapping) and named else {}
            table = table[key]
        table[path[-1]] = value
        self.origins = {one: words for one, words in self.origins.items() if one[: len(path)] != path}
        self.origins[path] = origin


def _numbers(text: str) -> Any:
    """Numbers parted by commas, in a list also if there is one."""
    value = words.value_of(text)
    return [value] if isinstance(value, float) else value


def _of_mesh(option: str, given: Any) -> Any:
    if option in ("direction", "scale"):
        return words.value_of(given)
    names = [name.strip() for name in given.split(",")]
    return names[0] if len(names) == 1 else names


def sorted_files(files: Iterable[str]) -> tuple[File | None, File | None]:
    """The mesh file and the description among the files of the command line; None: it is not given.

    Raises:
        DescriptionError: two of a kind.
    """
    mesh: File | None = None
    description: File | None = None
    for name in files:
        path = File(name)
        if path.suffix.lower() in (".toml", ".py"):
            if description:
                raise DescriptionError(f"two descriptions are given, {description} and {path}; give one")
            description = path
        else:
            if mesh:
                raise DescriptionError(
                    f"two mesh files are given, {mesh} and {path}; give one, and a description that ends with .toml or .py"
                )
            mesh = path
    return mesh, description
