"""Mixed models: the layer meshed near its free ends, its law elsewhere; errors over thickness and distance of the cut."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from forms import BulkLaw, LinearElastic, VonMises
from geometry import sandwich
from thinlayer import Model, State, Structure, ThinLayer, compare, march, observed_orders, plotting, solve
from thinlayer.files.progress import track
from thinlayer.running.record import Record

BODY, ELASTIC = LinearElastic.young(E=100.0, nu=0.3), LinearElastic.shear(40.0, 0.3)
YIELDING = VonMises(60.0, 40.0, strength=1.2, hardening=4.0)  # at its free ends alone, which the law on S does not see
TIMES = (0.5, 1.0)
LOAD = (0.3, -1.0)
EPS = (1 / 32, 1 / 64, 1 / 128)
THICK = 1 / 12  # of the picture
AWAY = 4.0  # of the cut from the free ends, over the thickness
DISTANCES = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
CELLS_THROUGH = 8
MEASURED = {
    "inner traction": "traction",
    "inner jump": "jump",
    "work of the loads": "work",
    "traction on all of S": "all",
}
LAWS = ("order 0", "order 1", "order 1, ends free", "mixed")


def run(record: Record, *, eps: Sequence[float] = EPS, quick: bool = False) -> None:
    """Compare interface and mixed models of two blocks with free sides with the full model.

    Args:
        record: where to write.
        eps: thicknesses of the layer; the blocks are 1 wide.
        quick: the two largest thicknesses, and every other distance.
    """
    some = tuple(eps)[:2] if quick else tuple(eps)
    record.parameters = {"cut": AWAY, "cells_through": CELLS_THROUGH}
    for name, law in {"elastic": ELASTIC, "yielding": YIELDING}.items():
        _thicknesses(record, name, law, some)
    _distances(record, some[-1], DISTANCES[1::2] if quick else DISTANCES)
    _picture(record)


class _Blocks:
    """Two blocks with free sides and a layer between them, and its full model, solved."""

    def __init__(self, record: Record, law: BulkLaw, eps: float) -> None:
        self.record, self.law, self.eps = record, law, eps
        joint = sandwich(1.0, 0.5, 0.5, h=1 / 8, h_S=1 / 32, h_ends=eps / 8, cell="quadrilateral")
        load = LOAD if law.traits.linear else lambda x, t: (LOAD[0] * t, LOAD[1] * t)
        self.structure = Structure(joint, body=BODY, supports={"BOTTOM": 0}, tractions={"TOP": load})
        self.full = self.state(self.structure.full(ThinLayer(law, eps), cells_through=CELLS_THROUGH))

    def state(self, model: Model) -> State:
        return self.record.solved(solve(model) if self.law.traits.linear else march(model, TIMES).last)

    def by_law(self, order: int, edges: str) -> State:
        layer = ThinLayer(self.law, self.eps, order=order, edges=edges if order else None)
        return self.state(self.structure.interface(layer))

    def mixed(self, thicknesses: float) -> State:
        """The state of the mixed model whose cuts are so far from the free ends."""
        length = thicknesses * self.eps

        def near_ends(x: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
            return np.asarray(np.minimum(x[0], 1 - x[0]) < length)

        layer = ThinLayer(self.law, self.eps, order=1)
        return self.state(self.structure.mixed(layer, where=near_ends, cells_through=CELLS_THROUGH))

    def errors(self, state: State) -> dict[str, float]:
        """Errors on the inner half of S, of the work of the loads, of tractions on all of S; share of the unknowns."""
        inner = compare(self.full, state, where=lambda x: abs(x[0] - 0.5) < 0.25)
        works = [one.energies()["loads"] for one in (self.full, state)]
        return {
            "error_traction": inner["error_traction"],
            "error_jump": inner["error_jump"],
            "error_work": abs(works[1] / works[0] - 1),
            "error_all": compare(self.full, state)["error_traction"],
            "unknowns": _unknowns(state.model) / _unknowns(self.full.model),
        }


def _unknowns(model: Model) -> int:
    followers = model.comm.allreduce(0 if model.followers is None else len(model.followers.rows))
    return int(model.V.dofmap.index_map.size_global * model.V.dofmap.index_map_bs - followers)


def _thicknesses(record: Record, name: str, law: BulkLaw, thicknesses: Sequence[float]) -> None:
    tables = {one: record.table(f"{name}_{one.replace(', ', '_').replace(' ', '_')}.csv") for one in _laws(law)}
    for eps in track(list(thicknesses), "mixed", f"{name}, eps = {{:g}}"):
        blocks = _Blocks(record, law, float(eps))
        for one, table in tables.items():
            table.append({"eps": float(eps)} | blocks.errors(_state(blocks, one)))
    for one, table in tables.items():
        record.say(f"{name}, {one}")
        record.say(table)
    orders = {
        one: [
            observed_orders(table["eps"], table[f"error_{of}"])[-1] or math.nan for of in ("traction", "jump", "work")
        ]
        for one, table in tables.items()
    }
    record.check(f"{name}: least last order of the mixed model", min(orders["mixed"]), low=1.7)
    record.check(f"{name}: largest last order of the law of order 1", max(orders["order 1"]), high=1.2)
    last = {one: table["error_all"][-1] for one, table in tables.items()}
    record.check(
        f"{name}: error of tractions on all of S, of the mixed model over the law's",
        last["mixed"] / last["order 1"],
        high=0.1,
    )


def _laws(law: BulkLaw) -> tuple[str, ...]:
    return LAWS if law is ELASTIC else tuple(one for one in LAWS if "free" not in one)


def _state(blocks: _Blocks, name: str) -> State:
    if name == "mixed":
        return blocks.mixed(AWAY)
    return blocks.by_law(int(name[6]), "free" if "free" in name else "plain")


def _distances(record: Record, eps: float, distances: Sequence[float]) -> None:
    table = record.table("distances.csv")
    blocks = _Blocks(record, ELASTIC, eps)
    for thicknesses in track(list(distances), "mixed", "cut {:g} eps from the ends"):
        state = blocks.mixed(thicknesses)
        table.append({"distance": thicknesses} | blocks.errors(state))
    record.say(table)
    near, far = (table["error_work"][k] for k in (0, -1))
    record.check("error of the work, cut far from the ends over cut near them", far / near, high=0.3)


def _picture(record: Record) -> None:
    """Draw the right end of a thick layer."""
    blocks = _Blocks(record, ELASTIC, THICK)
    plotting.deformed(
        {"full": blocks.full, "mixed": blocks.mixed(2.0)},
        zoom=(1 - 5 * THICK, 1 + 2 * THICK, -3 * THICK, 3 * THICK),
        scale=1.0,
        save=record.path("mixed.png"),
    )


def draw(record: Record) -> None:
    """Draw errors against the thickness, and against the distance of the cut from the free ends."""
    for name, law in {"elastic": ELASTIC, "yielding": YIELDING}.items():
        tables = {one: record.load(f"{name}_{one.replace(', ', '_').replace(' ', '_')}.csv") for one in _laws(law)}
        parts: Mapping[str, Mapping[str, tuple[object, object]]] = {
            what: {one: (np.log2(table["eps"]), table[f"error_{of}"]) for one, table in tables.items()}
            for what, of in MEASURED.items()
        }
        plotting.panels(
            parts,
            xlabel="log2 of the thickness over the width",
            ylabels=dict.fromkeys(parts, ""),
            styles=dict.fromkeys(LAWS, "o-"),
            colours=dict(zip(LAWS, ("tab:blue", "tab:orange", "tab:green", "black"), strict=True)),
            columns=4,
            yscale="log",
            save=record.path(f"{name}.png"),
        )
    table = record.load("distances.csv")
    plotting.curves(
        {what: (table["distance"], table[f"error_{of}"]) for what, of in MEASURED.items()},
        xlabel="distance of the cut from the free ends / thickness",
        ylabel="relative error",
        styles=dict.fromkeys(MEASURED, "o-"),
        logarithmic=True,
        save=record.path("distances.png"),
    )
