"""Reader of the .inp files of Abaqus and CalculiX.

The reader of meshio loses data where a set, or the nodes, are written in several blocks, and it reads neither surfaces
nor instances of parts.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from forms.base import InputError
from geometry.importing.elements import add_face, mesh_of
from geometry.topology import FloatArray

if TYPE_CHECKING:
    import meshio

SOLIDS = {4: "tetra", 5: "pyramid", 6: "wedge", 8: "hexahedron", 10: "tetra10", 15: "wedge15", 20: "hexahedron20"}
MESHIO_TYPES = {  # start of an element's type -> number of its nodes -> meshio's name
    r"[AD]?C3D\d": SOLIDS,
    r"CP[SE]|CG?AX|D?C2D|STRI|S\d|S?F?M3D|R3D": {3: "triangle", 4: "quad", 6: "triangle6", 8: "quad8", 9: "quad9"},
    r"[TB][23]|[SMR]AX|R2D": {2: "line", 3: "line3"},
}
# keywords that create or move nodes or elements, refused if they have data
UNSUPPORTED_KEYWORDS = "SYSTEM", "NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY"
NODES, ELEMENTS = "NSET", "ELSET"  # kinds of members of sets
Rows = list[list[str]]  # for each line of data the texts between commas
# a keyword of the file, in capitals, with its options, its data, and its line and file as text for messages
Block = tuple[str, dict[str, str], Rows, str]


def load(path: Path) -> meshio.Mesh:
    """Return the mesh in an Abaqus .inp file and in the files that it includes.

    Instances of parts are moved to their places. Blocks of one set are joined. A set of an instance has its own name,
    or "INSTANCE.NAME" if other instances or the assembly have this name too. Faces in surfaces become elements.
    Surfaces of nodes, or of elements without faces, become sets of nodes. Sets with the option INTERNAL are left out.

    Args:
        path: the .inp file.

    Raises:
        InputError: data are wrong or not supported; the message names keyword and line.
    """
    blocks = [*_blocks(path)]
    model = _Model(any(block[0] == "INSTANCE" for block in blocks))
    for block in blocks:
        model.add(block)
    named: dict[str, dict[str, Collection[int]]] = {NODES: {}, ELEMENTS: {}}
    counts = Counter(name for _, name in {(scope, name.upper()) for _, scope, name in model.names})
    for kind, scope, name in model.names:
        text = f"{scope}.{name}" if scope and counts[name.upper()] > 1 else name
        named[kind][text] = model.members[kind][f"{scope}.{name}".upper()]
    return mesh_of(np.array(model.points), model.elements, named[ELEMENTS], named[NODES])


class _Model:
    """Nodes, elements and sets that have been read.

    A scope has its own numbers and names: an instance of a part, or the assembly, "". Without instances each part is
    one. Keys are "SCOPE#5" for the number 5 of a node or element, and "SCOPE.NAME" for a set, in capitals.
    """

    def __init__(self, has_instances: bool) -> None:
        self.has_instances = has_instances
        self.points: list[FloatArray] = []
        self.elements: list[tuple[str, Sequence[int]]] = []
        self.members: dict[str, dict[str, Collection[int]]] = {NODES: {}, ELEMENTS: {}}  # by kind and key
        self.names: list[tuple[str, str, str]] = []  # kind, scope and name of each set
        self.parts: dict[str, list[Block]] = {}
        self.part: list[Block] | None = None  # that is being read, if there are instances
        self.scopes, self.scope, self.motion = [""], "", Rows()

    def add(self, block: Block) -> None:
        """Add what a block describes; raise InputError if it is wrong or not supported."""
        keyword, options, rows, place = block
        try:
            if keyword in ("PART", "END PART", "INSTANCE", "END INSTANCE", "ASSEMBLY"):
                self._enter(keyword, options, rows)
            elif self.part is not None:
                self.part.append(block)
            elif (rows and keyword in UNSUPPORTED_KEYWORDS) or (keyword == "NODE" and "SYSTEM" in options):
                raise ValueError("it is not read; write all nodes, at their places, and all elements")
            elif keyword == "NODE":
                self._store(NODES, options, NODES, self._number(NODES, rows, len(self.points)))
                self.points.extend(self._moved([[float(c or 0) for c in (*x, "", "", "")[:3]] for _, *x in rows]))
            elif keyword == "ELEMENT":
                self._store(ELEMENTS, options, ELEMENTS, self._number(ELEMENTS, rows, len(self.elements)))
                self._add_elements(options.get("TYPE", "").upper(), rows)
            elif keyword in (NODES, ELEMENTS):
                texts, scope = [text for row in rows for text in row], options.get("INSTANCE", self.scope)
                if "GENERATE" in options:
                    ranges = (map(int, row) for row in rows)
                    texts = [str(k) for first, last, *step in ranges for k in range(first, last + 1, *step)]
                self._store(keyword, options, keyword, {k for text in texts for k in self._find(keyword, text, scope)})
            elif keyword == "SURFACE" and options.get("TYPE", "ELEMENT").upper() in ("ELEMENT", "NODE"):
                self._add_surface(options, rows)
        except (KeyError, ValueError) as error:
            missing = " does not exist before it" if isinstance(error, KeyError) else ""
            raise InputError(f"*{keyword} in {place}: {error}{missing}") from None

    def _enter(self, keyword: str, options: dict[str, str], rows: Rows) -> None:
        name, self.scope, self.part, self.motion = options.get("NAME", ""), "", None, rows
        if keyword == "PART" and self.has_instances:
            self.part = self.parts[name.upper()] = []
        elif keyword in ("PART", "INSTANCE"):
            self.scope = name
            self.scopes.append(name)
            for block in self.parts[options["PART"].upper()] if keyword == "INSTANCE" else ():
                self.add(block)

    def _moved(self, points: list[list[float]]) -> FloatArray:
        """Return coordinates as the current instance moves them: by a vector, then round an axis through two points."""
        shift, *turns = [[float(c or 0) for c in row] for row in self.motion] or [[]]
        x = np.array(points) + (shift + [0.0] * 3)[:3]
        for *ends, angle in turns:
            first, second = np.reshape(ends, (2, 3))
            axis = (second - first) / np.linalg.norm(second - first)
            x = first + Rotation.from_rotvec(np.radians(angle) * axis).apply(x - first)
        return x

    def _number(self, kind: str, rows: Rows, start: int) -> range:
        """Give the next nodes or elements, from `start`, the numbers that begin the rows; return all of them."""
        for member, (number, *_) in enumerate(rows, start):
            if self.members[kind].setdefault(f"{self.scope}#{int(number)}".upper(), (member,)) != (member,):
                raise ValueError(f"the number {number} is in the file twice")
        return range(start, start + len(rows))

    def _add_elements(self, kind: str, rows: Rows) -> None:
        by_size = next((types for start, types in MESHIO_TYPES.items() if re.match(start, kind)), {})
        for _, *numbers in rows:
            if len(numbers) not in by_size:
                raise ValueError(f"elements {kind} of {len(numbers)} nodes are not read")
            nodes = [node for number in numbers for node in self._find(NODES, number, self.scope)]
            self.elements.append((by_size[len(numbers)], nodes))

    def _add_surface(self, options: dict[str, str], rows: Rows) -> None:
        nodes, faces, kind = set[int](), set[int](), NODES if options.get("TYPE", "").upper() == "NODE" else ELEMENTS
        for name, *face in rows if "COMBINE" not in options else ():
            members, side = self._find(kind, name, self.scope), "".join(face[:1]).upper()
            if kind == NODES or not side:
                nodes.update(*([members] if kind == NODES else (self.elements[k][1] for k in members)))
            elif side in ("SPOS", "SNEG"):
                faces.update(members)
            elif re.fullmatch(r"S\d", side):
                faces.update(add_face(self.elements, k, int(side[1]) - 1) for k in members)
            else:
                raise ValueError(f"the face {side} is not read; give S1 to S6, SPOS or SNEG")
        self._store(NODES, options, "NAME", nodes)
        self._store(ELEMENTS, options, "NAME", faces)

    def _store(self, kind: str, options: dict[str, str], name_option: str, members: Collection[int]) -> None:
        """Add members to the set of the current scope that an option names, if there are any."""
        key = f"{self.scope}.{options.get(name_option, '')}".upper()
        if members and not key.endswith("."):
            if key not in self.members[kind] and "INTERNAL" not in options:
                self.names.append((kind, self.scope, options[name_option]))
            self.members[kind][key] = {*self.members[kind].get(key, ()), *members}

    def _find(self, kind: str, text: str, scope: str) -> Collection[int]:
        """Return the members of a set, or the node or element of a number; in the assembly also those of an instance."""
        (instance, _, last), table = text.rpartition("."), self.members[kind]
        mark = "#" if last.isdigit() else "."
        keys = [f"{name}{mark}{text}".upper() for name in ([scope] if scope else self.scopes)]
        matches = [key for key in (*keys, *[f"{instance}{mark}{last}".upper()] * bool(instance)) if key in table]
        if not matches:
            raise KeyError(text)
        if len(matches) > 1 and matches[0] != keys[0]:
            raise ValueError(f"{text!r} is in {len(matches)} instances; write INSTANCE.{text}")
        return table[matches[0]]


def _blocks(path: Path) -> Iterator[Block]:
    """Yield the blocks of the .inp file `path`, also of files that it includes; a block is a keyword with its data.

    Data of elements that continue on the next line, after a comma, are one row.
    """
    text = re.sub(r"(?m)^[ \t]*\*\*.*", "", path.read_text("utf-8-sig", "replace"))
    preamble, *blocks = re.split(r"(?m)^[ \t]*\*", text)
    line = 1 + preamble.count("\n")
    for block in blocks:
        header, _, data = re.sub(r"\A(.*,)[ \t]*\n", r"\1", block).partition("\n")
        keyword, *texts = header.split(",")
        keyword = keyword.strip().upper()
        options = {key.strip().upper(): value.strip(' \t"') for key, _, value in (arg.partition("=") for arg in texts)}
        if keyword == "INCLUDE":
            yield from _blocks(path.parent / options.get("INPUT", ""))
        if keyword == "ELEMENT":
            data = re.sub(r",\s*\n", ",", data)
        rows = [re.split(r"\s*,\s*", row.strip(" \t,")) for row in data.split("\n") if row.strip()]
        yield keyword, options, rows, f"line {line} of {path.name}"
        line += block.count("\n")
