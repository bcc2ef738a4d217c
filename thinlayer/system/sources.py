"""C sources and the files they include."""

from __future__ import annotations

import os
import re
from pathlib import Path

NAMED = re.compile(rb'^[ \t]*#[^"<\n]*["<]([^">\n]+)[">]', re.MULTILINE)
SEARCHED = ("CPATH", "C_INCLUDE_PATH")  # folders in which compilers look for files, besides the system's


def contents(source: Path) -> dict[Path, bytes]:
    """File -> content: a C source, and recursively the files that its preprocessor lines name, without system headers.

    Nothing is preprocessed: a file counts even where a condition leaves it out.

    Raises:
        OSError: the source cannot be read. The compiler reports included files that cannot be read.
    """
    searched = [Path(folder) for name in SEARCHED for folder in os.environ.get(name, "").split(os.pathsep) if folder]
    found = {source: source.read_bytes()}
    todo = [source]
    while todo:
        file = todo.pop()
        for name in NAMED.findall(found[file]):
            for folder in (file.parent, *searched):
                try:
                    one = (folder / os.fsdecode(name)).resolve()
                    if one not in found:
                        found[one] = one.read_bytes()
                        todo.append(one)
                except (OSError, ValueError):
                    continue
    return found


def content(source: Path) -> bytes:
    """All these contents joined: the input of a compilation. Errors as in `contents`."""
    return b"\0".join(contents(source).values())
