"""Mixed models: layers meshed near free ends and junctions, their laws elsewhere; errors over thickness and cuts."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from scipy.spatial import cKDTree

from forms import BulkLaw, LinearElastic, VonMises
from forms.base import Array
from geometry import wall
from geometry.topology import BoolArray
from studies.problems import FOURIER_BODY, free_blocks
from studies.sweeping import by_reaction, errors_of_work, last_order
from thinlayer import State, Structure, ThinLayer, compare, march, plotting, solve
from thinlayer.discretisation.model import Model
from thinlayer.running.record import Record
from thinlayer.system.progress import track

ELASTIC = LinearElastic.shear(40.0, 0.3)
YIELDING = VonMises(60.0, 40.0, strength=1.2, hardening=4.0)  # at its free ends alone, which the law on S does not see
TIMES = (0.5, 1.0)
LOAD = (0.3, -1.0)
EPS = (1 / 32, 1 / 64, 1 / 128)
THICK = 1 / 12  # of the picture
WALL_EPS, HEADS = (1 / 16, 1 / 32, 1 / 64), 0.7  # thickness of beds over the length of bricks; of heads over theirs
AROUND = 2.5  # length over which layers are meshed around junctions, over the thickness of beds
WALL_LAWS = ("order 0", "mixed, order 0", "mixed, order 1")
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
    """Compare interface and mixed models of two blocks with free sides, and of a wall, with full models.

    Args:
        record: where to write.
        eps: thicknesses of the layer; the blocks are 1 wide.
        quick: the two largest thicknesses, every other distance, and larger cells of the wall.
    """
    some = tuple(eps)[:2] if quick else tuple(eps)
    for name, law in {"elastic": ELASTIC, "yielding": YIELDING}.items():
        _thicknesses(record, name, law, some)
    _distances(record, some[-1], DISTANCES[1::2] if quick else DISTANCES)
    _wall(record, 1 / 16 if quick else 1 / 32, WALL_EPS[:2] if quick else WALL_EPS)
    _picture(record)


class _Blocks:
    """Two blocks with free sides and a layer between them, and its full model, solved."""

    def __init__(self, record: Record, law: BulkLaw, eps: float) -> None:
        self.record, self.law, self.eps = record, law, eps
        load = LOAD if law.traits.linear else lambda x, t: (LOAD[0] * t, LOAD[1] * t)
        self.structure = free_blocks(eps / 8, load)
        self.full = self.state(self.structure.full(ThinLayer(law, eps, at=1.0), cells_through=CELLS_THROUGH))

    def state(self, model: Model) -> State:
        return self.record.solved(solve(model) if self.law.traits.linear else march(model, TIMES).last)

    def by_law(self, order: int, edges: str) -> State:
        layer = ThinLayer(self.law, self.eps, order=order, edges=edges if order else None, at=1.0)
        return self.state(self.structure.interface(layer))

    def mixed(self, thicknesses: float) -> State:
        """The state of the mixed model whose cuts are so far from the free ends."""
        length = thicknesses * self.eps

        def near_ends(x: Array) -> BoolArray:
            return np.asarray(np.minimum(x[0], 1 - x[0]) < length)

        layer = ThinLayer(self.law, self.eps, order=1, at=1.0)
        return self.state(self.structure.mixed(layer, where=near_ends, cells_through=CELLS_THROUGH))

    def errors(self, state: State) -> dict[str, float]:
        """Errors on the inner half of S, of the work of the loads, of tractions on all of S; share of the unknowns."""

        found = errors_of_work(self.full, state, lambda x: abs(x[0] - 0.5) < 0.25)
        return {name: found[name] for name in ("error_traction", "error_jump", "error_work")} | {
            "error_all": by_reaction(self.full, state)["error_reaction"],
            "unknowns": _unknowns(state.model) / _unknowns(self.full.model),
        }


def _unknowns(model: Model) -> int:
    followers = model.comm.allreduce(0 if model.followers is None else len(model.followers.rows))
    return model.unknowns - int(followers)


def _thicknesses(record: Record, name: str, law: BulkLaw, thicknesses: Sequence[float]) -> None:
    tables = {one: record.table(f"{name}_{_file(one)}.csv") for one in _laws(law)}
    for eps in track(list(thicknesses), "mixed", f"{name}, eps = {{:g}}"):
        blocks = _Blocks(record, law, float(eps))
        for one, table in tables.items():
            table.append({"eps": float(eps)} | blocks.errors(_state(blocks, one)))
    errors = [f"error_{of}" for of in ("traction", "jump", "work")]
    orders = {one: [last_order(table, error) for error in errors] for one, table in tables.items()}
    record.check(f"{name}: least last order of the mixed model", min(orders["mixed"]), low=1.7)
    record.check(f"{name}: largest last order of the law of order 1", max(orders["order 1"]), high=1.2)
    last = {one: table["error_all"][-1] for one, table in tables.items()}
    what = f"{name}: error of tractions on all of S, of the mixed model over the law's"
    record.check(what, last["mixed"] / last["order 1"], high=0.1)


def _file(name: str) -> str:
    """A name as a part of that of a file."""
    return name.replace(", ", "_").replace(" ", "_")


def _laws(law: BulkLaw) -> tuple[str, ...]:
    return LAWS if law is ELASTIC else tuple(one for one in LAWS if "free" not in one)


def _state(blocks: _Blocks, name: str) -> State:
    if name == "mixed":
        return blocks.mixed(AWAY)
    return blocks.by_law(int(name[6]), "free" if "free" in name else "plain")


def _distances(record: Record, eps: float, distances: Sequence[float]) -> None:
    blocks = _Blocks(record, ELASTIC, eps)
    row = lambda cut: {"distance": cut} | blocks.errors(blocks.mixed(cut))  # noqa: E731
    table = record.rows("distances.csv", distances, row, "cut {:g} eps from the ends")
    near, far = (table["error_work"][k] for k in (0, -1))
    record.check("error of the work, cut far from the ends over cut near them", far / near, high=0.3)


def _wall(record: Record, h: float, thicknesses: Sequence[float]) -> None:
    """Write errors on all of S of two courses of bricks: laws, and mixed models with laws of order 0 and 1."""
    joint = wall(2, 2, (1.0, 0.5), h=h)
    structure = Structure(joint, body=FOURIER_BODY, supports={"BOTTOM": 0}, tractions={"TOP": LOAD})
    on_s, outer = np.unique(joint.surface), np.unique(joint.table.vertices[joint.table.cells[:, 1] < 0])
    special = joint.points[on_s[(joint.splitting.valence[on_s] > 2) | np.isin(on_s, outer)]]  # junctions, free ends
    tables = {name: record.table(f"wall_{_file(name)}.csv") for name in WALL_LAWS}
    for eps in track(list(thicknesses), "mixed", "wall, eps = {:g}"):
        full = record.solved(solve(structure.full(_mortar(eps, 0))))
        length = max(AROUND * eps, 1.01 * h)
        for name, table in tables.items():
            layers = _mortar(eps, int(name[-1]))
            where = partial(_within, special, length)
            model = structure.mixed(layers, where=where) if "mixed" in name else structure.interface(layers)
            state = record.solved(solve(model))
            errors = compare(full, state)
            row = {"eps": eps} | {name: errors[name] for name in ("error_traction", "error_jump")}
            row["error_work"] = abs(state.energies()["loads"] / full.energies()["loads"] - 1)
            table.append(row | {"unknowns": _unknowns(model) / _unknowns(full.model)})
    for of in ("traction", "jump"):
        ratio = tables["mixed, order 1"][f"error_{of}"][-1] / tables["order 0"][f"error_{of}"][-1]
        record.check(f"wall: error of the {of}, of the mixed model over the law's", ratio, high=0.1)


def _mortar(eps: float, order: int) -> dict[str, ThinLayer]:
    thicknesses = {"BED": eps, "HEAD": HEADS * eps}
    return {name: ThinLayer(ELASTIC, thickness, order=order, at=1.0) for name, thickness in thicknesses.items()}


def _within(special: Array, length: float, x: Array) -> BoolArray:
    """Whether places (d, n) are within a length of special ones (m, d)."""
    return np.asarray(cKDTree(special).query(x.T)[0] < length)


def _picture(record: Record) -> None:
    """Draw the right end of a thick layer."""
    blocks = _Blocks(record, ELASTIC, THICK)
    window = 1 - 5 * THICK, 1 + 2 * THICK, -3 * THICK, 3 * THICK
    states = {"full": blocks.full, "mixed": blocks.mixed(2.0)}
    plotting.deformed(states, zoom=window, scale=1.0, save=record.path("mixed.png"))


def draw(record: Record) -> None:
    """Draw errors against the thickness, and against the distance of the cut from the free ends."""
    walls = {name: record.load(f"wall_{_file(name)}.csv") for name in WALL_LAWS}
    plotting.rates(walls, title="two courses of bricks, all of S", save=record.path("wall.png"))
    for name, law in {"elastic": ELASTIC, "yielding": YIELDING}.items():
        tables = {one: record.load(f"{name}_{_file(one)}.csv") for one in _laws(law)}
        parts = {
            what: {one: (np.log2(table["eps"]), table[f"error_{of}"]) for one, table in tables.items()}
            for what, of in MEASURED.items()
        }
        width, save = "log2 of the thickness over the width", record.path(f"{name}.png")
        plotting.panels(parts, width, styles="o-", columns=4, yscale="log", save=save)
    table = record.load("distances.csv")
    lines = {what: (table["distance"], table[f"error_{of}"]) for what, of in MEASURED.items()}
    distance, save = "distance of the cut from the free ends / thickness", record.path("distances.png")
    plotting.curves(lines, distance, "relative error", styles="o-", logarithmic=True, save=save)
