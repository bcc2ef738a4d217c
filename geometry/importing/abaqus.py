"""Reader of Abaqus .inp files.

The reader of meshio loses data where an element set, or the nodes, are written in several blocks.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from forms.base import InputError, import_optional

if TYPE_CHECKING:
    import meshio

MESHIO_TYPES = {  # start of an element's type -> number of its nodes -> meshio's name
    r"[AD]?C3D\d": {4: "tetra", 6: "wedge", 8: "hexahedron", 10: "tetra10", 15: "wedge15", 20: "hexahedron20"},
    r"CP[SE]|CG?AX|D?C2D|STRI|S\d|S?F?M3D|R3D": {3: "triangle", 4: "quad", 6: "triangle6", 8: "quad8", 9: "quad9"},
    r"[TB][23]|[SMR]AX|R2D": {2: "line", 3: "line3"},
}
# keywords that create or move nodes or elements, refused if they have data
UNSUPPORTED_KEYWORDS = "SYSTEM", "INSTANCE", "NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY"


def load(path: Path) -> meshio.Mesh:
    """Return the mesh in an Abaqus .inp file and in the files that it includes.

    The file must describe one part, and an *INSTANCE may not move it. Blocks of one element set are joined. Sets of
    nodes, surfaces, and sets with the option INTERNAL are left out.

    Args:
        path: the .inp file.

    Raises:
        InputError: data are wrong or not supported; the message names keyword and line.
    """
    points: list[list[float]] = []
    row_of: dict[int, int] = {}  # number -> row in `points`
    elements: dict[int, tuple[str, list[int]]] = {}
    sets: dict[str, tuple[str, bool, set[int]]] = {}  # in capitals -> as first written, if in the assembly, elements
    n_elements, in_assembly = 0, False
    for keyword, options, rows, place in _blocks(path):
        kind, name, members = options.get("TYPE", "").upper(), options.get("ELSET", ""), set[int]()
        in_assembly |= keyword == "ASSEMBLY"
        try:
            if (rows and keyword in UNSUPPORTED_KEYWORDS) or (keyword == "NODE" and "SYSTEM" in options):
                raise ValueError("it is not read; write all nodes, at their places, and all elements")
            if keyword == "NODE":
                row_of |= {int(number): k for k, (number, *_) in enumerate(rows, len(points))}
                points += [[float(c or 0) for c in (*x, "", "")][:3] for _, *x in rows]
            elif keyword == "ELEMENT":
                by_size = next((cell_types for start, cell_types in MESHIO_TYPES.items() if re.match(start, kind)), {})
                if {len(row) - 1 for row in rows} - {*by_size}:
                    raise ValueError(f"elements {kind} of {len(rows[0]) - 1} nodes are not read")
                elements |= {int(k): (by_size[len(numbers)], [row_of[int(n)] for n in numbers]) for k, *numbers in rows}
                members, n_elements = {int(row[0]) for row in rows}, n_elements + len(rows)
            elif keyword == "ELSET" and "GENERATE" in options:
                for first, last, *step in (map(int, row) for row in rows):
                    members |= {*range(first, last + 1, *step)}
            elif keyword == "ELSET":
                members.update(*({int(k)} if k.isdigit() else sets[k.upper()][2] for row in rows for k in row))
            if len(row_of) < len(points) or len(elements) < n_elements:
                raise ValueError("a number is in the file twice; write one part alone")
            if members and name and "INTERNAL" not in options:
                _, was_in_assembly, element_set = sets.setdefault(name.upper(), (name, in_assembly, set()))
                if was_in_assembly != in_assembly:
                    raise ValueError(f"the part has a set {name!r} too; give one of them another name")
                element_set.update(number for number in members if elements[number])
        except (KeyError, ValueError) as error:
            missing = " does not exist before it" if isinstance(error, KeyError) else ""
            raise InputError(f"*{keyword} in {place}: {error}{missing}") from None
    types = dict.fromkeys(kind for kind, _ in elements.values())
    ids_of = {kind: [k for k, (cell_type, _) in elements.items() if cell_type == kind] for kind in types}
    cells = [(kind, np.array([elements[k][1] for k in ids])) for kind, ids in ids_of.items()]
    lists = {name: [np.flatnonzero(np.isin(ids, [*its])) for ids in ids_of.values()] for name, _, its in sets.values()}
    return import_optional("meshio").Mesh(np.array(points), cells, cell_sets=lists)


def _blocks(path: Path) -> Iterator[tuple[str, dict[str, str], list[list[str]], str]]:
    """Yield the blocks of the .inp file `path`, also of files that it includes; a block is a keyword with its data.

    A block is yielded as (keyword in capitals, {option: value}, rows of data, place). Each row is a list of the texts
    between commas. The place is the line and the file, for messages.
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
        if keyword == "ELEMENT":  # data continue on the next line after a comma
            data = re.sub(r",\s*\n", ",", data)
        rows = [re.split(r"\s*,\s*", row.strip(" \t,")) for row in data.split("\n") if row.strip()]
        yield keyword, options, rows, f"line {line} of {path.name}"
        line += block.count("\n")
