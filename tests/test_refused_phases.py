"""Mistakes with phases, temperatures and paths: each is refused with what, where and what is allowed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import basix.ufl
import numpy as np
import pytest
import ufl
from mpi4py import MPI

from forms import BulkLaw, LinearElastic, NonMonotoneUnrelaxed, Tabulated
from forms.base import InputError
from geometry import sandwich
from tests.on_ranks import on_ranks
from thinlayer import Adaptive, ArcLength, Structure, ThinLayer, drive, march, solve
from thinlayer.discretisation.model import Model
from thinlayer.solving.history import History, phase_shares

JOINT = sandwich(2.0, 1.0, 1.0, 1.0)
SETUP = {"body": LinearElastic.young(1e4, 0.3), "supports": {"BOTTOM": 0.0, "TOP": {"x": 0.0}}}
TABLE = Tabulated([(0.0, 1.5), (100.0, 0.5)])
SLIP_AND_OPENING = [[0.0, 0.3], [0.3, 1.0]]


def pure(**changed: Any) -> NonMonotoneUnrelaxed:
    return NonMonotoneUnrelaxed(
        **{"lmbda": 2.0, "mu": 5.0, "alpha": 1.5, "transformation_energy": 0.3, "chi": SLIP_AND_OPENING, **changed}
    )


def model(law: BulkLaw, pull: float = 1.0) -> Model:
    """Two blocks with a layer of this law, pulled by pull * t."""
    loads = {"TOP": lambda x, t: (0.0, pull * t * (1 + 0.1 * x[0]))}
    return Structure(JOINT, tractions=loads, **SETUP).interface(ThinLayer(law, 0.1, at=1.0))


def refused(law: BulkLaw, message: str, tmp_path: Any) -> None:
    """A march with this law is refused, and writes nothing."""
    with pytest.raises(InputError, match=message):
        march(model(law), [0.5, 1.0], out=tmp_path / "run")
    assert not (tmp_path / "run").exists()


# ---------------------------------------------------------------- temperatures


@pytest.mark.parametrize("name", ["alpha", "transformation_energy", "T"])
def test_temperatures_in_ufl(name):
    mesh = ufl.Mesh(basix.ufl.element("Lagrange", "triangle", 1, shape=(2,)))
    space = ufl.FunctionSpace(mesh, basix.ufl.element("Lagrange", "triangle", 1))
    field = ufl.Coefficient(space)  # can be called, as a function
    for value in (field, ufl.SpatialCoordinate(mesh)[0]):
        with pytest.raises(InputError, match=f"{name} is a UFL expression; allowed: a number, a function in numpy"):
            pure(**{"T": 20.0, name: value})


def test_a_field_that_changes_its_places():
    """Places are those of the points whatever a field does to the array that it is given."""

    def cools(x: Any, t: float) -> Any:
        x[0] *= 0.5
        return 100 * x[0] / 2

    law = pure(alpha=TABLE, T=cools)
    again = [march(model(law, 0.1), [0.5, 1.0]).table["stored"][-1] for _ in range(2)]
    fixed = march(model(pure(alpha=TABLE, T=lambda x, t: 25 * x[0]), 0.1), [0.5, 1.0]).table["stored"][-1]
    assert again == pytest.approx([fixed, fixed], rel=1e-14)


def test_a_table_of_no_temperatures():
    for T in (1j, "20", None, np.array([True])):
        with pytest.raises(InputError, match=r"T is .*; a table is a function of temperatures, numbers"):
            TABLE(T)


# ---------------------------------------------------------------- laws of one's own
@dataclass(frozen=True)
class Switch(BulkLaw):
    """A spring whose phase tells whether it is open."""

    k: float
    powers: ClassVar = {"k": 1}
    internal: ClassVar = {"phase": ()}
    phases: ClassVar = True

    def advance(self, step):
        return {"phase": ufl.conditional(ufl.gt(step.e[1, 1], 0.05), 1.0, 0.0)}

    def stress(self, step):
        return self.k * step.mid


def kind(**declared: Any) -> BulkLaw:
    """The spring, of a class that declares this."""
    return dataclass(frozen=True)(type("Own", (Switch,), {"__annotations__": {}, "__module__": __name__} | declared))(
        5.0
    )


def test_phases_of_a_law_of_ones_own():
    history = march(model(Switch(5.0)), [0.5])
    assert history.table["plus"].tolist() == [0.0, 1.0]
    assert np.isnan(history.table["energy"]).all()  # it declares none
    assert phase_shares(history.last, "S")["plus"] == 1.0


SCALARS = {"phase": (), "drive": (), "bound": ()}


@pytest.mark.parametrize(
    ("declared", "message"),
    [
        ({"internal": {}}, "phases = True; it needs an internal variable 'phase' of shape ()"),
        ({"internal": {"phase": (3,)}}, "phases = True; it needs an internal variable 'phase' of shape ()"),
        ({"switches": True}, "switches = True; it needs phases = True and the scalars .*'drive', 'bound'"),
        ({"switches": True, "phases": False, "internal": SCALARS}, "switches = True; it needs phases = True"),
        ({"switches": True, "internal": SCALARS}, "switches = True; it needs a method excess"),
        ({"switches": True, "internal": SCALARS, "excess": lambda self, *_: 0}, "switches = True; it needs a method"),
    ],
)
def test_declared_phases_that_are_not_there(declared, message):
    with pytest.raises(InputError, match=f"^Own has {message}"):
        kind(**declared)


def test_functions_that_have_no_numbers():
    with pytest.raises(InputError, match=r"Own: parameters\(\) gives a function for k; it must give a number"):
        dataclass(frozen=True)(
            type("Own", (Switch,), {"__annotations__": {}, "__module__": __name__, "functions": ("k",)})
        )(lambda T: T)


@dataclass(frozen=True)
class Varying(Switch):
    """The spring, with a stiffness that varies in one of several ways that are wrong."""

    way: float = 0.0
    powers: ClassVar = {}
    varies: ClassVar = True

    def at(self, x, t):
        return list(WRONG.values())[int(self.way)](x, t)


WRONG = {
    r"gives \[\]; allowed: those that vary of k": lambda x, t: {},
    r"gives \['K'\]; allowed: those that vary of k": lambda x, t: {"K": x[0]},
    r"gives k of shape \(\); allowed: \(\d+,\), finite numbers": lambda x, t: {"k": 5.0},
    r"gives k of shape \(2, \d+\)": lambda x, t: {"k": x},
    r"gives k of shape \(\d+,\); allowed: .*finite": lambda x, t: {"k": np.where(x[0] > 1, np.nan, 5.0)},
    "fails: AttributeError": lambda x, t: x[0],
    "fails: ZeroDivisionError": lambda x, t: 1 / 0,
}


@pytest.mark.parametrize("way", range(len(WRONG)))
def test_parameters_that_do_not_vary_as_they_should(way, tmp_path):
    message = rf"^Varying\.at\(x, t\), for x of shape \(2, \d+\), {list(WRONG)[way]}"
    refused(Varying(5.0, way=way), message, tmp_path)


def test_parameters_of_a_law_without_memory_vary():
    """Such a law would be a part of the form, where nobody asks for its parameters at a place."""
    twice = {"varies": True, "at": lambda self, x, t: {"k": np.full(x.shape[1], 10 * self.k)}}
    plain = {"phases": False, "internal": {}, "advance": BulkLaw.advance}
    moved = [np.abs(solve(model(kind(**plain, **vary)), 1.0).u.x.array).max() for vary in ({}, twice)]
    assert moved[1] < 0.5 * moved[0]


# ---------------------------------------------------------------- marches
@pytest.mark.parametrize(
    ("times", "choices", "message"),
    [
        ([1.0], {"theta": 1j}, "theta is 1j; it must be a number"),
        ([1.0], {"start": 1j}, "start is 1j; it must be a number"),
        (Adaptive(1.0, 0.1), {}, "steps of NonMonotoneUnrelaxed have no error: give the times to stop at"),
        ([1.0], {"observe": {"a": lambda state: 1 / 0}}, r"observe\['a'\] at t = 0: ZeroDivisionError: division"),
        ([1.0], {"observe": {"a": lambda s: s.shares}}, r"observe\['a'\] at t = 0: AttributeError:"),
        (ArcLength(1.0, 0.1, steps=np.int64(5)), {}, "NonMonotoneUnrelaxed has pure phases"),
    ],
)
def test_marches(times, choices, message):
    with pytest.raises(InputError, match=message):
        march(model(pure()), times, **choices)


def test_a_point_with_pure_phases_holds_at_the_ends_of_steps():
    with pytest.raises(InputError, match=r"theta is 0\.5; NonMonotoneUnrelaxed holds at the ends of steps"):
        drive(pure(), [{"w_T": 0.0, "w_N": 0.4}], theta=0.5)


def test_loads_and_supports_that_are_no_numbers():
    layer = ThinLayer(pure(), 0.1, at=1.0)
    with pytest.raises(InputError, match="traction on 'TOP' gives nan; it needs 2 finite components"):
        Structure(JOINT, tractions={"TOP": lambda x, t: (0, np.nan)}, **SETUP).interface(layer)
    moved = SETUP | {"supports": {"BOTTOM": 0.0, "TOP": {"y": lambda x, t: np.inf}}}
    with pytest.raises(InputError, match="support on 'TOP': component y gives inf; it needs a finite number"):
        Structure(JOINT, **moved).interface(layer)
    with pytest.raises(InputError, match="cells_through is '4'; the layer needs a whole number"):
        Structure(JOINT, **SETUP).full(layer, cells_through="4")


def test_an_empty_history():
    history = History(model(pure()))
    assert history.snaps == []
    assert len(history.t) == 0
    with pytest.raises(InputError, match="no accepted state"):
        _ = history.last


# ---------------------------------------------------------------- ranks
def wrong_on_one_rank() -> list[list[str]]:
    """A field, or a function that observes, that is wrong on one rank only: the same error on all ranks."""
    texts = []
    for law in (pure(alpha=TABLE, T=lambda x, t: np.where(x[0] > 1, 150.0, 20.0)), Varying(5.0, way=4)):
        with pytest.raises(InputError) as found:
            march(model(law), [1.0], out="no/such/folder")
        texts.append(str(found.value))
    with pytest.raises(InputError) as found:
        march(model(pure()), [0.1], observe={"a": lambda state: 1 / (1 - MPI.COMM_WORLD.rank)})
    return MPI.COMM_WORLD.allgather([*texts, str(found.value)])


@pytest.mark.long
@on_ranks(wrong_on_one_rank, 2)
def test_all_ranks_refuse(there):
    one, two = there
    assert one == two
    assert "alpha(T): T is 150; the table knows 0 to 100" in one[0]
    assert "Varying.at(x, t)" in one[1]
    assert "observe['a'] at t = 0: rank 1: ZeroDivisionError" in one[2]
