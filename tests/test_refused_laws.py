"""Laws of one's own that are written wrongly: C sources, conditions, substitutes that would give wrong numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pytest
from mpi4py import MPI

from forms import KernelLaw, LinearElastic
from forms.base import InputError
from geometry import sandwich
from tests.on_ranks import on_ranks
from tests.refused import refused
from thinlayer import Structure, ThinLayer, drive, march
from thinlayer.system.compilation import _loaded
from thinlayer.system.identity import described, digest

STEP = [{"w_T": 0.01, "w_N": -0.02}]
SPRING = """int kernel(double *out, const void *unused, const double *in)
{
    for (int i = 0; i < 6; i++) out[i] = out[6 + 7 * i] = in[17], out[i] *= in[i];
    return 0;
}
"""


def from_c(k: float, **declared: Any) -> KernelLaw:
    """A law of one parameter whose class declares this."""
    names = {"__annotations__": {"k": float}, "__module__": __name__, "powers": {"k": 1}}
    return dataclass(frozen=True)(type("FromC", (KernelLaw,), names | declared))(k)


@pytest.mark.parametrize("kind", [str, lambda path: path], ids=["str", "Path"])
def test_a_law_in_c(tmp_path, kind):
    source = tmp_path / "spring.c"
    source.write_text(SPRING)
    assert drive(from_c(5.0, source=kind(source)), STEP).tractions[0] == pytest.approx([0.025, -0.1], rel=1e-14)
    source.write_text(SPRING.replace("= in[17]", "= 2 * in[17]"))  # edited in the same session
    assert drive(from_c(5.0, source=kind(source)), STEP).tractions[0] == pytest.approx([0.05, -0.2], rel=1e-14)


def test_a_law_in_c_with_headers(tmp_path):
    """What a header says is a part of the law: of its compiled module, and of what a march is known by."""
    source, header, inner = tmp_path / "spring.c", tmp_path / "factor.h", tmp_path / "inner.h"
    source.write_text(f'#include <math.h>\n# include "{header}"\n' + SPRING.replace("= in[17]", "= FACTOR * in[17]"))
    header.write_text('#include "inner.h"\n#ifdef NEVER\n#include "no/such/file.h"\n#endif\n')
    known = set()
    for factor in (3, 7):
        inner.write_text(f'#pragma once\n#include "factor.h"\n#define FACTOR {factor}\n')
        law = from_c(5.0, source=source)
        expected = [0.025 * factor, -0.1 * factor]
        assert drive(law, STEP).tractions[0] == pytest.approx(expected, rel=1e-14)
        _loaded.cache_clear()  # as in another process
        assert drive(law, STEP).tractions[0] == pytest.approx(expected, rel=1e-14)
        known.add(digest(described(law)))
    assert len(known) == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, r"the C source '\S+law.c' cannot be compiled: FileNotFoundError"),
        ("", r"has no function int kernel\(double \*out, const void \*, const double \*in\)"),
        (SPRING.replace("kernel", "kernl"), "has no function int kernel"),
        (SPRING.replace("int kernel", "static int kernel"), "has no function int kernel"),
        (SPRING.replace("int kernel", "double kernel"), "has no function int kernel"),
        (SPRING.replace("const void *unused, ", ""), "has no function int kernel"),
        (SPRING.replace("return 0;", "return 0"), "cannot be compiled: VerificationError: CompileError"),
        (b"\xff\xfe", "cannot be compiled: UnicodeDecodeError"),
    ],
    ids=["missing", "empty", "name", "static", "double", "arguments", "syntax", "binary"],
)
def test_bad_c_sources(tmp_path, text, message):
    source = tmp_path / "law.c"
    if text is not None:
        source.write_bytes(text if isinstance(text, bytes) else text.encode())
    refused(InputError, f"FromC: .*{message}", lambda: drive(from_c(5.0, source=source), STEP))


@pytest.mark.parametrize(
    ("declared", "message"),
    [
        ({"source": 3}, "FromC.source is 3; it must be the name of a C file"),
        ({}, r"FromC needs a static method kernel\(...\), or source"),
        *(({"memory": memory}, f"memory is {memory!r}; allowed: a whole number") for memory in (-1, 2.0, "6", None)),
    ],
)
def test_bad_declarations(tmp_path, declared, message):
    source = tmp_path / "spring.c"
    source.write_text(SPRING)
    with pytest.raises(InputError, match=message):
        drive(from_c(5.0, **({"source": source} if "memory" in declared else {}) | declared), STEP)


# ---------------------------------------------------------------- ranks
def wrong_source() -> list[str]:
    """A source that does not compile: the same error on all ranks, before the march writes anything."""
    layer = ThinLayer(from_c(5.0, source="no/such/file.c"), 0.1, at=1.0)
    setup = {"body": LinearElastic.young(100.0, 0.3), "supports": {"BOTTOM": 0.0}, "tractions": {"TOP": (0.1, -1.0)}}
    with pytest.raises(InputError) as found:
        march(Structure(sandwich(1.0, 0.5, 0.5, 0.5), **setup).interface(layer), [1.0], out="no/such/folder")
    return MPI.COMM_WORLD.allgather(str(found.value))


@pytest.mark.long
@on_ranks(wrong_source, 2)
def test_all_ranks_refuse(there):
    one, two = there
    assert "FromC: the C source 'no/such/file.c' cannot be compiled" in one
    assert one == two
