"""Laws of one's own that are written wrongly: C sources, conditions, substitutes that would give wrong numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import pytest
import ufl
from mpi4py import MPI

from forms import BulkLaw, HolonomicCoulomb, KernelLaw, LawError, LinearElastic, Stack
from geometry import sandwich
from tests.on_ranks import on_ranks
from tests.refused import refused
from thinlayer import Structure, ThinLayer, drive, march
from thinlayer.compiling.compiled import _FILES, _LOADED
from thinlayer.identity import described, digest

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
        _FILES.clear(), _LOADED.clear()  # as in another process
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
    refused(LawError, f"FromC: .*{message}", lambda: drive(from_c(5.0, source=source), STEP))


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
    with pytest.raises(LawError, match=message):
        drive(from_c(5.0, **({"source": source} if "memory" in declared else {}) | declared), STEP)


# ---------------------------------------------------------------- laws that hold in part
@dataclass(frozen=True)
class Soft(BulkLaw):
    """A spring with a memory that it does not use."""

    k: float
    powers: ClassVar = {"k": 1}
    internal: ClassVar = {"a": (3, 3)}

    def advance(self, step):
        return dict(step.q)

    def stress(self, step):
        return self.k * step.mid


@dataclass(frozen=True)
class Stiff(Soft):
    def stress(self, step):
        return 100 * self.k * step.mid


@dataclass(frozen=True)
class Remembers(Soft):
    internal: ClassVar = {"a": (3, 3), "b": ()}


@dataclass(frozen=True)
class More(Soft):
    m: float = 3.0


def opens(law, step):
    return ufl.gt(step.e[1, 1], 0)


def partly(holds=opens, **declared: Any) -> BulkLaw:
    """A soft law that holds in part; `otherwise` gives the law for the other points."""
    otherwise = declared.pop("otherwise", lambda law: Stiff(law.k))
    names = {"__annotations__": {}, "__module__": __name__, "holds": holds, "otherwise": property(otherwise)}
    return dataclass(frozen=True)(type("Partly", (Soft,), names | declared))(5.0)


@pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")  # of the thick layer
def test_a_law_that_holds_in_part():
    steps = [{"w_T": 0.01, "w_N": 0.02}, {"w_T": 0.01, "w_N": -0.02}]
    assert drive(partly(otherwise=lambda law: Stiff(law.k)), steps[1:]).tractions[0] == pytest.approx([2.5, -10.0])
    in_plane = sandwich(1.0, 0.5, 0.5, 0.5)
    sides = {"BOTTOM": 0.0, "TOP": {"x": 0.0, "y": lambda x, t: 0.02 * t}}
    setup = {"body": LinearElastic.young(1e6, 0.0), "supports": sides}
    forces = []
    for law in (partly(), Soft(5.0), partly(lambda law, step: ufl.lt(step.e[1, 1], 0)), Stiff(5.0)):
        state = march(Structure(in_plane, **setup).interface(ThinLayer(law, 1.0)), [1.0]).last
        forces.append(state.energies()["bodies"])
    assert forces[0] == pytest.approx(forces[1], rel=1e-9)
    assert forces[2] == pytest.approx(forces[3], rel=1e-9) != forces[1]


@pytest.mark.parametrize(
    ("declared", "message"),
    [
        ({"otherwise": lambda law: Stiff}, r"Partly.otherwise is <class .*; it must be a law"),
        ({"otherwise": lambda law: "stiff"}, "Partly.otherwise is 'stiff'; it must be a law"),
        ({"otherwise": lambda law: Stack((1.0, Stiff(law.k)))}, "it must be a law"),
        ({"otherwise": lambda law: HolonomicCoulomb(1.0, 1.0, 0.5)}, "it must be a law"),
        ({"otherwise": lambda law: law}, "which has a law otherwise too"),
        ({"otherwise": lambda law: Stiff(2 * law.k)}, r"has the parameters {'k': 10.0}; it must have .* {'k': 5.0}"),
        ({"otherwise": lambda law: More(law.k)}, "has the parameters {'k': 5.0, 'm': 3.0}; it must have those of"),
        ({"otherwise": lambda law: LinearElastic(1.0, 1.0)}, "has the parameters {'lmbda': 1.0, 'mu': 1.0}"),
        ({"otherwise": lambda law: Remembers(law.k)}, "keeps internal values {.*'b'.*}; it must keep those of Partly"),
        ({"otherwise": lambda law: from_c(law.k, memory=0)}, "keeps 0 internal values; it must keep .* 6 numbers"),
        ({"holds": lambda law, step: True}, "Partly.holds gives True; it must give a UFL condition"),
        ({"holds": lambda law, step: None}, "Partly.holds gives None"),
        ({"holds": lambda law, step: step.e[0, 0]}, "Partly.holds gives Indexed"),
        ({"holds": lambda law, step: 0 < step.e[0, 0] < 1}, "Partly.holds: ValueError: UFL conditions cannot be"),
    ],
)
def test_bad_substitutes_and_conditions(declared, message):
    refused(LawError, message, lambda: drive(partly(**declared), STEP))


def test_a_condition_is_not_forgotten_without_memory():
    """A law without memory would be a part of the form, where nobody asks whether it holds."""

    @dataclass(frozen=True)
    class Static(BulkLaw):
        k: float
        otherwise: ClassVar = LinearElastic(1.0, 1.0)
        holds = opens

        def stress(self, step):
            return self.k * step.mid

    assert Static(5.0).traits.compiled
    refused(LawError, r"Static\.otherwise has the parameters", lambda: drive(Static(5.0), STEP))


# ---------------------------------------------------------------- ranks
def wrong_source() -> list[str]:
    """A source that does not compile: the same error on all ranks, before the march writes anything."""
    layer = ThinLayer(from_c(5.0, source="no/such/file.c"), 0.1, at=1.0)
    setup = {"body": LinearElastic.young(100.0, 0.3), "supports": {"BOTTOM": 0.0}, "tractions": {"TOP": (0.1, -1.0)}}
    with pytest.raises(LawError) as found:
        march(Structure(sandwich(1.0, 0.5, 0.5, 0.5), **setup).interface(layer), [1.0], out="no/such/folder")
    return MPI.COMM_WORLD.allgather(str(found.value))


@pytest.mark.long
@on_ranks(wrong_source, 2)
def test_all_ranks_refuse(there):
    one, two = there
    assert "FromC: the C source 'no/such/file.c' cannot be compiled" in one
    assert one == two
