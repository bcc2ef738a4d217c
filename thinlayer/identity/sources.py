"""C sources and the files they include."""

from __future__ import annotations

import os
import re
from pathlib import Path

NAMED = re.compile(rb'^[ \t]*#[^"<\n]*["<]([^">\n]+)[">]', re.MULTILINE)
SEARCHED = ("CPATH", "C_INCLUDE_PATH")  # folders in which compilers look for files, besides the system's


def contents(source: Path) -> dict[Path, bytes]:
    """File -> what is in it: a C source, the files that its preprocessor lines name, and so on; no headers of the system.

    Nothing is preprocessed: a file counts even where a condition leaves it out.

    Raises:
        OSError: a source that cannot be read; included files that cannot are left to the compiler.
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
    """All of that, one after the other: what a compilation depends on. Errors as in `contents`."""
    return b"\0".join(contents(source).values())
