"""Laws of one's own that are written wrongly: C sources, conditions, substitutes that would give wrong numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pytest

from forms import KernelLaw
from forms.base import InputError, ThinlayerError
from tests.refused import refused
from thinlayer import drive
from thinlayer.system.compilation import _load_once
from thinlayer.system.fingerprint import describe, digest

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


def test_a_law_in_c(tmp_path):
    source = tmp_path / "spring.c"
    source.write_text(SPRING)
    assert drive(from_c(5.0, source=str(source)), STEP).tractions[0] == pytest.approx([0.025, -0.1], rel=1e-14)
    source.write_text(SPRING.replace("= in[17]", "= 2 * in[17]"))  # edited in the same session
    assert drive(from_c(5.0, source=source), STEP).tractions[0] == pytest.approx([0.05, -0.2], rel=1e-14)


def test_whether_a_kernel_reads_dt_is_what_it_says(tmp_path):
    for slope, declared, message in [
        ("in[17]", {"relaxes": True}, "relaxes = True, but does not depend on dt; write relaxes = False"),
        ("in[17] / (1 + in[15])", {}, "relaxes = False, but depends on dt; write relaxes = True"),
        ("in[17] / (1 + in[15])", {"relaxes": True}, None),
    ]:
        source = tmp_path / "spring.c"
        source.write_text(SPRING.replace("= in[17]", f"= {slope}"))
        law = from_c(5.0, source=source, **declared)
        if message:
            refused(InputError, message, drive, law, STEP, dt=0.25)
        else:
            assert drive(law, STEP, dt=0.25).tractions[0] == pytest.approx([0.02, -0.08], rel=1e-14)


def test_a_law_in_c_with_headers(tmp_path):
    """What a header says is a part of the law: of its compiled module, and of what a march is known by."""
    source, header, inner = tmp_path / "spring.c", tmp_path / "factor.h", tmp_path / "inner.h"
    source.write_text(f'#include <math.h>\n# include "{header}"\n' + SPRING.replace("= in[17]", "= FACTOR * in[17]"))
    header.write_text('#include "inner.h"\n#ifdef NEVER\n#include "no/such/file.h"\n#endif\n')
    digests = set()
    for factor in (3, 7):
        inner.write_text(f'#pragma once\n#include "factor.h"\n#define FACTOR {factor}\n')
        law = from_c(5.0, source=source)
        expected = [0.025 * factor, -0.1 * factor]
        assert drive(law, STEP).tractions[0] == pytest.approx(expected, rel=1e-14)
        _load_once.cache_clear()  # as in another process
        assert drive(law, STEP).tractions[0] == pytest.approx(expected, rel=1e-14)
        digests.add(digest(describe(law)))
    assert len(digests) == 2


def test_bad_c_sources(tmp_path):
    source = tmp_path / "law.c"
    for text, message in [
        (None, r"the C source '\S+law.c' cannot be compiled: FileNotFoundError"),
        ("", r"has no function int kernel\(double \*out, const void \*, const double \*in\)"),
        (SPRING.replace("int kernel", "double kernel"), "has no function int kernel"),
        (SPRING.replace("return 0;", "return 0"), "cannot be compiled: VerificationError: CompileError"),
        (b"\xff\xfe", "cannot be compiled: UnicodeDecodeError"),
    ]:
        if text is not None:
            source.write_bytes(text if isinstance(text, bytes) else text.encode())
        refused(ThinlayerError, message, drive, from_c(5.0, source=source), STEP)


def test_bad_declarations(tmp_path):
    source = tmp_path / "spring.c"
    source.write_text(SPRING)
    for declared, message in [
        ({"source": 3}, "FromC.source is 3; it must be the name of a C file"),
        ({}, "FromC.source is None; it must be the name of a C file"),
        *(({"memory": memory}, f"memory is {memory!r}; allowed: a whole number") for memory in (-1, 2.0)),
    ]:
        arguments = ({"source": source} if "memory" in declared else {}) | declared
        refused(InputError, message, lambda arguments=arguments: drive(from_c(5.0, **arguments), STEP))
