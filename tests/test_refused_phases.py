"""Mistakes with phases, temperatures and paths: each is refused with what, where and what is allowed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest
import ufl
from mpi4py import MPI

from forms import BulkLaw, LinearElastic, NonMonotoneUnrelaxed, Tabulated
from forms.base import InputError
from geometry import sandwich
from tests.on_ranks import on_ranks
from thinlayer import Structure, ThinLayer, march
from thinlayer.discretisation.model import Model
from thinlayer.surface.law_points import layer_shares

JOINT = sandwich(2.0, 1.0, 1.0, 1.0)
SETUP = {"body": LinearElastic.young(1e4, 0.3), "supports": {"BOTTOM": 0.0, "TOP": {"x": 0.0}}}
TABLE = Tabulated([(0.0, 1.5), (100.0, 0.5)])
SLIP_AND_OPENING = [[0.0, 0.3], [0.3, 1.0]]


def pure(**changed: Any) -> NonMonotoneUnrelaxed:
    parameters = {"lmbda": 2.0, "mu": 5.0, "alpha": 1.5, "transformation_energy": 0.3, "chi": SLIP_AND_OPENING}
    return NonMonotoneUnrelaxed(**parameters | changed)


def model(law: BulkLaw, pull: float = 1.0) -> Model:
    """Two blocks with a layer of this law, pulled by pull * t."""
    loads = {"TOP": lambda x, t: (0.0, pull * t * (1 + 0.1 * x[0]))}
    return Structure(JOINT, tractions=loads, **SETUP).interface(ThinLayer(law, 0.1, at=1.0))


def refused(law: BulkLaw, message: str, tmp_path: Any) -> None:
    """A march with this law is refused, and writes nothing."""
    with pytest.raises(InputError, match=message):
        march(model(law), [0.5, 1.0], out=tmp_path / "run")
    assert not (tmp_path / "run").exists()


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


def test_phases_of_a_law_of_ones_own():
    history = march(model(Switch(5.0)), [0.5])
    assert history.table["plus"].tolist() == [0.0, 1.0]
    assert np.isnan(history.table["energy"]).all()  # it declares none
    assert layer_shares(history.last, "S")["plus"] == 1.0


@dataclass(frozen=True)
class Varying(Switch):
    """The spring, with a stiffness that varies in one of several ways that are wrong."""

    way: float = 0.0
    powers: ClassVar = {}
    varies: ClassVar = True

    def at(self, x, t):
        return list(WRONG.values())[int(self.way)](x, t)


WRONG = {
    r"gives \[\]; allowed: those of k, way that vary": lambda x, t: {},
    r"gives k of shape \(\); allowed: \(\d+,\), finite numbers": lambda x, t: {"k": 5.0},
    r"gives k of shape \(\d+,\); allowed: .*finite": lambda x, t: {"k": np.where(x[0] > 1, np.nan, 5.0)},
}


@pytest.mark.parametrize("way", range(len(WRONG)))
def test_parameters_that_do_not_vary_as_they_should(way, tmp_path):
    message = rf"^Varying\.at\(x, t\), for x of shape \(2, \d+\), {list(WRONG)[way]}"
    refused(Varying(5.0, way=way), message, tmp_path)


# ---------------------------------------------------------------- ranks
def wrong_on_one_rank() -> list[list[str]]:
    """A field, or a function that observes, that is wrong on one rank only: the same error on all ranks."""
    texts = []
    for law in (pure(alpha=TABLE, T=lambda x, t: np.where(x[0] > 1, 150.0, 20.0)), Varying(5.0, way=2)):
        with pytest.raises(InputError) as error:
            march(model(law), [1.0], out="no/such/folder")
        texts.append(str(error.value))
    with pytest.raises(InputError) as error:
        march(model(pure()), [0.1], observe={"a": lambda state: 1 / (1 - MPI.COMM_WORLD.rank)})
    return MPI.COMM_WORLD.allgather([*texts, str(error.value)])


@pytest.mark.long
@on_ranks(wrong_on_one_rank, 2)
def test_all_ranks_refuse(there):
    first, second = there
    assert first == second
    assert "alpha(T): T is 150; the table knows 0 to 100" in first[0]
    assert "Varying.at(x, t)" in first[1]
    assert "observe['a'] at t = 0: rank 1: ZeroDivisionError" in first[2]
