"""What each rank is told differently, or wrongly on one alone: prints the error that all ranks have, by case."""

from __future__ import annotations

import functools
import json
import math
import sys
from pathlib import Path

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from forms import KelvinVoigt, LinearElastic
from geometry import sandwich
from thinlayer import Structure, ThinLayer, compare, fields, march, solve, sweep

COMM = MPI.COMM_WORLD
JOINT = sandwich(1.0, 0.5, 0.5, 0.5)
SUPPORTS = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}}
BODY = LinearElastic.young(100.0, 0.3)
SLOW = KelvinVoigt(60.0, 40.0, theta_lmbda=0.3, theta_mu=0.5)


def model(eps=0.1, law=SLOW, profile=None, build=Structure.interface, **change):
    data = {"body": BODY, "supports": SUPPORTS, "tractions": {"TOP": (0.0, 1.0)}}
    return build(Structure(JOINT, **data | change), ThinLayer(law, eps, profile=profile))


def turned(given, rank):
    return dict(reversed(given.items())) if rank else given


def in_another_order(rank: int) -> None:
    """That of tractions, bodies and what is observed: columns have that of rank 0."""
    tractions = turned({"TOP": (0.0, 1.0), "RIGHT": lambda x, t: (0.2 * t, -0.1)}, rank)
    observe = turned({"one": lambda state: 2 * state.t, "other": lambda state: -state.t}, rank)
    body = turned(dict.fromkeys(JOINT.bodies, BODY), rank)
    table = march(model(body=body, tractions=tractions), [0.3], observe=observe).table
    assert table.columns[-2:] == ["one", "other"]
    assert table["one"].tolist() == [0.0, 0.6]
    assert table["other"].tolist() == [0.0, -0.3]


class Load:
    """A load with a value that is computed when it is first asked for."""

    @functools.cached_property
    def size(self):
        return 1.5

    def __call__(self, x, t):
        return (0.0, self.size * t)


def asked(rank: int) -> Load:
    load = Load()
    if rank:
        assert load.size > 0
    return load


def cases(rank: int, folder: Path):
    """Name -> what is done on a rank."""
    elastic, other, good = model(law=LinearElastic(60.0, 40.0)), model(law=LinearElastic(50.0, 40.0)), model()
    state = solve(elastic)
    full = solve(model(build=Structure.full, law=LinearElastic(60.0, 40.0)))
    if rank:  # numbers of constants count nothing
        fem.Constant(state.model.domain.mesh, 1.0)
    limit = fem.Constant(state.model.domain.mesh, 0.25)
    compare(full, state, where=lambda x: x[0] > limit)
    order = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"y": 0.1}}
    factor = 1.0 + rank
    return {
        "thickness": lambda: model(0.1 + 0.2 * rank),
        "law": lambda: model(law=LinearElastic(60.0 + rank, 40.0)),
        "body": lambda: model(body=LinearElastic.young(100.0 + rank, 0.3)),
        "tractions": lambda: model(tractions={"TOP": (0.0, 1.0 + 0.5 * rank)}),
        "a load that is no number": lambda: model(tractions={"TOP": (0.0, math.nan if rank else 1.0)}),
        "a function that fails": lambda: model(tractions={"TOP": lambda x, t: (0.0, 1.0 / (1 - rank))}),
        "supports": lambda: model(supports=SUPPORTS | {"RIGHT": {"y": 0.3 * rank}}),
        "fewer supports": lambda: model(supports=dict([*SUPPORTS.items()][: 2 - rank])),
        "order of supports": lambda: model(supports=turned(order, rank)),
        "order of others": lambda: in_another_order(rank),
        "cached values": lambda: model(tractions={"TOP": asked(rank)}),
        "what a load refers to": lambda: model(tractions={"TOP": lambda x, t: (0.0, factor * t)}),
        "element": lambda: model(element="P7" if rank else "P2"),
        "option": lambda: model(build=functools.partial(Structure.full, cells_through=2 + rank)),
        "wrong option": lambda: model(build=functools.partial(Structure.full, bodies="keep" if rank else "kept")),
        "kind of model": lambda: model(build=Structure.full if rank else Structure.interface),
        "no model": lambda: solve(None if rank else elastic),
        "t": lambda: solve(elastic, 0.5 * rank),
        "models": lambda: solve(other if rank else elastic),
        "method": lambda: solve(elastic, method="newton" if rank else "linear"),
        "options": lambda: solve(elastic, options={"ksp_type": "cg"} if rank else {}),
        "times": lambda: march(good, [0.1, 0.2 + 0.1 * rank]),
        "bad times": lambda: march(good, [0.2, 0.1] if rank else [0.1, 0.2]),
        "theta": lambda: march(good, [0.1], theta=1 - 0.5 * rank),
        "observe": lambda: march(good, [0.1], observe={} if rank else {"one": lambda state: 1.0}),
        "observed": lambda: march(good, [0.1], observe={"one": lambda state: 1.0 + rank}),
        "out": lambda: march(good, [0.1], out=folder / f"{rank}"),
        "sweep": lambda: sweep(lambda e: {"eps": e, "error_traction": e, "error_jump": e}, [0.2, 0.1][: 2 - rank]),
        "run": lambda: sweep(lambda e: {"eps": e / (1 - rank), "error_traction": e, "error_jump": e}, [0.2, 0.1]),
        "where": lambda: compare(full, state, where=lambda x: x[0] > 0.25 + 0.5 * rank),
        "where with a constant": lambda: compare(full, state, where=lambda x: x[0] > (1 + rank) * limit),
        "bad where": lambda: compare(full, state, where=lambda x: x[0] > 0.5 / (1 - rank)),
        "profile": lambda: model(profile=lambda x: np.where((x[0] > 0.5) & (rank == 1), math.nan, 1.0)),
        "observed by one": lambda: march(good, [0.1], observe={"one": lambda state: 1.0 / (1 - rank)}),
        "path": lambda: fields.write(state, folder / f"{rank}.pvd"),
        "ending": lambda: fields.write(state, folder / ("a.txt" if rank else "a.pvd")),
    }


def main(folder: str) -> None:
    """Run all cases."""
    found = {}
    for name, run in cases(COMM.rank, Path(folder)).items():
        try:
            run()
            text = "nothing"
        except Exception as error:
            text = f"{type(error).__name__}: {error}"
        texts = COMM.allgather(text)
        found[name] = texts[0] if len(set(texts)) == 1 else texts
    if COMM.rank == 0:
        print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1])
