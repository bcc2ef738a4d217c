"""Columns of the table of capabilities: small models, each of one trait, and what is known of each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import ufl

from forms import Breaking, Conduction, HolonomicCoulomb, KelvinVoigt, LinearElastic, Maxwell
from geometry import fibre, periodic, ring, sandwich, wall
from geometry.joint import Joint
from geometry.seam import Seam
from tests.meshes import blocks_of, write
from tests.own_laws import AgeingSpring, Cubic, Damaging, Mises, Radiating, Skew
from tests.own_scripts.inertia import Inertia
from thinlayer import Bond, Gap, Prestress, RigidPlate, Springs, Structure, ThinLayer, UflPart, march, solve
from thinlayer.discretisation.state import State

EPS, TIMES, LOAD = 0.05, (0.4, 1.0), (0.3, -0.5, 0.1)
LMBDA, MU, E, NU = 3.0, 2.0, 100.0, 0.2  # of the layer, and of the bodies
MESH = '{path = "column.msh", S = "S", upper = "UPPER"}'


def glue(law: Any = None, eps: float = EPS, stress: float = 1.0, **data: Any) -> ThinLayer:
    return ThinLayer(law or LinearElastic(LMBDA * stress, MU * stress), eps, **data)


class Column:
    """A structure with a trait, loaded by a traction up to t = 1, and what tests must know of it.

    Attributes:
        seam: through which all that loads the upper body goes.
        supported, loaded, roller: places that are supported, loaded, and on rollers along x.
        at: a place in the upper body.
        times: of a march in place of a solve; `past`: whether the layer, or a part, remembers.
        length, stress: units.
        turn: what turns vectors of the plain column to those of this one, and, as it is symmetric, back.
        unseen: force in regions that no reaction has.
        toml: keys of its description that are not those of the plain one.
        data: of `Structure`.
    """

    joint: Callable[..., Any] = staticmethod(partial(sandwich, 2.0, 0.6, 0.9, 0.5, cell="quadrilateral"))
    layers, bodies, bonded, data, toml = glue(), "kept", False, {}, {}
    seam, supported, loaded, roller, at = "S", "BOTTOM", "TOP", "RIGHT/UPPER", (0.0, 0.9)
    times, past, length, stress, unseen, statuses = (), False, 1.0, 1.0, None, {"elastic"}
    turn: Any = np.eye(3)
    scalar, traction, stresses, values, load_name = False, "traction", "stress", "displacement", "load"

    def __init__(self, **attributes: Any) -> None:
        vars(self).update(attributes)

    @property
    def load(self) -> Callable[..., tuple[Any, ...]]:
        """Not a method: its identity would have all that the column has gathered so far."""
        force = [float(c) * self.stress for c in self.turned(LOAD)]
        return lambda x, t: tuple(c * t for c in force)

    def turned(self, v: Any) -> Any:
        return self.turn[: len(self.at), : len(self.at)] @ v[: len(self.at)]

    def along(self, axis: Any) -> Any:
        """The direction of a goal."""
        return self.turned(axis)

    def vector(self, u: Any) -> Any:
        """Displacements, to which Gauss' theorem applies."""
        return u

    def whole(self, *powers: int) -> float:
        """A sum over the structure, over that of the part that is asked; powers: of length and stress."""
        return 1.0

    def at_eps(self, eps: float) -> Any:
        """The layers of this thickness, or of others in their ratio, with the cells that they have."""
        every, ratio = self.layers, eps / EPS / self.length
        of = lambda layer: replace(layer, eps=ratio * layer.eps, at=layer.eps) if hasattr(layer, "law") else layer
        return {name: of(layer) for name, layer in every.items()} if isinstance(every, dict) else of(every)

    @cached_property
    def structure(self) -> Structure:
        supports = {self.supported: 0.0} | ({self.roller: {"x": 0.0}} if self.roller else {})
        data = {"supports": supports, "tractions": {self.loaded: self.load}} | self.data
        return Structure(self.joint(), body=LinearElastic.young(E * self.stress, NU), **data)

    @cached_property
    def model(self) -> Any:
        return self.interface(Bond() if self.bonded else self.layers)

    def interface(self, layers: Any) -> Any:
        return self.structure.interface(layers, bodies=self.bodies)

    def meshed(self, layers: Any = None) -> State:
        """The state with the layers meshed."""
        return self.reach(self.structure.full(layers or self.layers, bodies=self.bodies))

    def follow(self, model: Any, t: float = 1.0) -> Any:
        """What an estimate takes: a history where the past counts, else a state."""
        if not self.times:
            return solve(model, t)
        history = march(model, [t * fraction for fraction in self.times])
        return history if self.past else history.last

    def reach(self, model: Any, t: float = 1.0) -> State:
        return getattr(solution := self.follow(model, t), "last", solution)

    @cached_property
    def state(self) -> State:
        return self.reach(self.model)

    def described(self, folder: Path) -> Path:
        """A mesh file and a description."""
        joint, path = self.structure.joint, folder / "column.toml"
        sets = (joint.dim - 1, joint.facets), (joint.dim, joint.regions)
        names = {name: (k, d) for d, of in sets for k, name in enumerate(of, 1)}
        write(folder / "column.msh", joint.points, *blocks_of(joint), names)
        supports = f'{self.supported} = 0, "{self.roller}" = {{x = 0}}' if self.roller else f"{self.supported} = 0"
        keys = {
            "mesh": MESH, "supports": f"{{{supports}}}",
            "tractions": f"{{{self.loaded} = {np.atleast_1d(self.load(None, 1.0)).tolist()}}}",
            "body": f"{{E = {E * self.stress}, nu = {NU}}}",
            "layer": f"{{lmbda = {LMBDA * self.stress}, mu = {MU * self.stress}, eps = {EPS * self.length}}}",
        } | self.toml  # fmt: skip
        path.write_text("\n".join(f"{key} = {value}" for key, value in keys.items()))
        return path


STIFF = {"LOWER": 1, "UPPER": 1, "LOWER 2": 3, "UPPER 2": 3}


class Twin(Column):
    """The plain column, and beside it one turned and mirrored, twice as large, thrice as stiff, which is asked."""

    layers = {"S 1": glue(), "S 2": glue(eps=2 * EPS, stress=3.0)}
    seam, supported, loaded, roller, at = "S 2", "BOTTOM 2", "TOP 2", None, (6.08, 2.56)
    length, stress = 2.0, 3.0
    turn = np.array([[0.8, 0.6, 0.0], [0.6, -0.8, 0.0], [0.0, 0.0, 1.0]])
    toml = {
        "mesh": '{path = "column.msh", S = {"S 1" = ["LOWER", "UPPER"], "S 2" = ["LOWER 2", "UPPER 2"]}}',
        "supports": '{BOTTOM = 0, "BOTTOM 2" = 0}',
        "tractions": '{TOP = [0.3, -0.5], "TOP 2" = [-0.18, 1.74]}',
        "body": "{" + ", ".join(f'"{name}" = {{E = {100 * k}, nu = 0.2}}' for name, k in STIFF.items()) + "}",
        "layer": '{"S 1" = {lmbda = 3, mu = 2, eps = 0.05}, "S 2" = {lmbda = 9, mu = 6, eps = 0.1}}',
    }

    def joint(self) -> Joint:
        plain = Column.joint()
        n, regions = len(plain.points), (*plain.regions, *(f"{name} 2" for name in plain.regions))
        facets = {name: rows for name, rows in plain.facets.items() if name != "S"} | {"S 1": plain.facets["S"]}
        facets |= {f"{name} 2": rows + n for name, rows in plain.facets.items()}
        points = np.concatenate([plain.points, 2 * plain.points @ self.turn[:2, :2] + (5.0, 4.0)])
        cells, region = (np.concatenate([a, a + k]) for a, k in ((plain.cells, n), (plain.region, 2)))
        seams = {"S 1": Seam(("LOWER",), ("UPPER",)), "S 2": Seam(("LOWER 2",), ("UPPER 2",))}
        return Joint(points, cells, plain.cell_type, region, regions, facets, seams)

    @cached_property
    def structure(self) -> Structure:
        body = {name: LinearElastic.young(E * k, NU) for name, k in STIFF.items()}
        tractions = {"TOP": lambda x, t: tuple(c * t for c in LOAD[:2]), "TOP 2": self.load}
        return Structure(self.joint(), body=body, supports={"BOTTOM": 0.0, "BOTTOM 2": 0.0}, tractions=tractions)

    def whole(self, *powers: int) -> float:
        return 1 + self.length ** -powers[0] * self.stress ** -powers[1]


class Conducting(Column):
    """A structure of a scalar field: heat that enters on top, and leaves at a side of the lower body with the value 1.

    Attributes:
        body: law of the bodies.
    """

    layers, body = glue(Conduction(0.4)), Conduction(2.5)
    scalar, traction, stresses, values, load_name = True, "flux", "flux", "value", "flux"
    supported = "RIGHT/LOWER"
    toml = {
        "body": '{law = "Conduction", k = 2.5}', "layer": f'{{law = "Conduction", k = 0.4, eps = {EPS}}}',
        "supports": '{"RIGHT/LOWER" = 1}', "fluxes": "{TOP = 0.3}", "tractions": "{}",
    }  # fmt: skip

    @property
    def load(self) -> Callable[..., Any]:
        return lambda x, t: 0.3 * t

    def turned(self, v: Any) -> Any:
        return v

    def along(self, axis: Any) -> None:
        return None

    def vector(self, u: Any) -> Any:
        return ufl.as_vector([u[0] - 1 if k == 1 else 0 for k in range(len(self.at))])

    @cached_property
    def structure(self) -> Structure:
        data = {"supports": {self.supported: 1.0}, "fluxes": {self.loaded: self.load}}
        return Structure(self.joint(), body=self.body, **(data | self.data))


def on_top(state: State, regions: tuple[str, ...]) -> Any:
    """Force of the foundation that holds the top."""
    ds = state.model.ds(state.model.domain.values("TOP"))
    return -np.array([state.integral(7.0 * u * ds) for u in state.u]) * ("UPPER" in regions)


def of_inertia(state: State, regions: tuple[str, ...]) -> Any:
    dx = [state.model.dx(state.model.domain.region_tags(name)) for name in regions]
    return -np.array([sum(state.integral(2.0 * c * measure) for measure in dx) for c in state.memory["inertia"]["a"]])


def law(name: str, more: str = "") -> dict[str, str]:
    return {"layer": f'{{law = "{name}", lmbda = {LMBDA}, mu = {MU}, eps = {EPS}{more}}}'}


def moved(k: int, x: Any, t: Any) -> Any:
    return (0.01, 0.006)[k] * t


MARCHED = {"times": str([*TIMES]), "tractions": f"{{TOP = {{times = [0, 1], values = [[0, 0], {[*LOAD[:2]]}]}}}}"}
OLD: dict[str, Any] = {"times": TIMES, "past": True}
PUSHED = {"supports": "{BOTTOM = 0, TOP = {x = 0.01, y = 0.006}}", "tractions": "{}"}
PARTS = {"parts": "[]"}
SHIFT: dict[str, Any] = {"tractions": {},
    "supports": {"BOTTOM": 0.0, "TOP": {"x": partial(moved, 0), "y": partial(moved, 1)}}}  # fmt: skip
TOUCHING: dict[str, Any] = {"layers": HolonomicCoulomb(200.0, 80.0, 0.5), "statuses": {"stick", "sliding", "separated"},
    "toml": law("HolonomicCoulomb")}  # fmt: skip
WALL: dict[str, Any] = {"joint": partial(wall, 2, 2, (1.0, 0.5), 0.25), "seam": "BED", "roller": None, "at": (0.0, 1.0)}
SEAMS = {"mesh": '{path = "column.msh", S = {BED = ["COURSE 1", "COURSE 2"], HEAD = [1, 0]}}'}
RING: dict[str, Any] = {"supported": "INSIDE", "loaded": "OUTSIDE", "roller": "START/OUTER", "at": (2.0, 0.0)}
COLUMNS: dict[str, Callable[[], Column]] = {
    "not symmetric": lambda: Column(layers=glue(Skew(MU, 0.7)), toml=law("Skew")),
    "memory": lambda: Column(layers=glue(Maxwell(LMBDA, MU, t1=0.8)), **OLD, toml=law("Maxwell", ", t1 = 0.8") | MARCHED),
    "rate": lambda: Column(layers=glue(KelvinVoigt(LMBDA, MU, 2.0, 1.5)), **OLD,
        toml=law("KelvinVoigt", ", theta_lmbda = 2, theta_mu = 1.5") | MARCHED),
    "softening": lambda: Column(layers=glue(Damaging(LMBDA, MU, 0.01, 6.0)), **OLD, toml=law("Damaging"), data=SHIFT),
    "breaking": lambda: Column(layers=glue(Breaking(LMBDA, MU, 0.5, 0.3, 0.15, 0.2, 2.0)), **OLD, data=SHIFT,
        statuses={"elastic", "breaking", "broken"},
        toml=law("Breaking", ", t_N = 0.5, t_T = 0.3, G_I = 0.15, G_II = 0.2, eta = 2.0") | MARCHED | PUSHED),
    "fields": lambda: Column(layers=glue(LinearElastic(LMBDA, lambda x: MU * (1 + 0.3 * x[0]))),
        toml={"layer": f'{{lmbda = {LMBDA}, mu = "2 + 0.6 x", eps = {EPS}}}'}),
    "in time": lambda: Column(layers=glue(AgeingSpring(MU, 0.5)), toml=law("AgeingSpring")),
    "eigenstrain": lambda: Column(layers=glue(eigenstrain=0.02), data={"eigenstrain": 0.001},
        toml=law("LinearElastic", ", eigenstrain = 0.02") | {"body": f"{{E = {E}, nu = {NU}, eigenstrain = 0.001}}"}),
    "prestress": lambda: Column(data={"eigenstrain": Prestress([[0.2, 0.1], [0.1, -0.3]])},
        toml={"body": f"{{E = {E}, nu = {NU}, eigenstrain = [0.2, 0.1]}}"}),
    "plates": lambda: Column(roller=None, toml=PARTS,
        data={"tractions": {}, "parts": [RigidPlate("TOP", force=(0.6, -1.0), moment=0.2)]}),
    "springs": lambda: Column(toml=PARTS,
        data={"supports": {"RIGHT/UPPER": {"x": 0}}, "parts": [Springs("BOTTOM", 20.0, 30.0)]}),
    "own form": lambda: Column(unseen=on_top, toml=PARTS, data={"parts": [
        UflPart(energy=lambda u, model: 3.5 * ufl.inner(u, u) * model.ds(model.domain.values("TOP")))]}),
    "inertia": lambda: Column(data={"parts": [Inertia(2.0)]}, **OLD, unseen=of_inertia, toml=PARTS),
    "law in UFL": lambda: Column(layers=glue(Cubic(2.0, 300.0)), toml=law("Cubic")),
    "law in C": lambda: Column(layers=glue(Mises(LMBDA, MU, 0.5, 2.0)), toml=law("Mises")),
    "contact 1": lambda: Column(data={"element": "Q1"}, **TOUCHING),
    "contact 2": lambda: Column(**TOUCHING),
    "gaps": lambda: Column(layers={"BED": glue(), "HEAD": Gap(0.03)}, **WALL, statuses={"elastic", "no layer"},
        toml=SEAMS | {"layer": "{BED = {E = 5, nu = 0.3, eps = 0.05}}"}),
    "bonds": lambda: Column(bonded=True, statuses={"bonded"}, toml={"bonded": "true"}),
    "networks": lambda: Column(**WALL, toml=SEAMS),
    "periodic": lambda: Column(roller=None, toml={"periodic": "1"},
        joint=lambda: periodic(Column.joint(), ("LEFT", "RIGHT"))),
    "cell": lambda: Column(joint=lambda: periodic(fibre(0.3, (1.0, 1.2), 0.2), ("LEFT", "RIGHT"), ("BOTTOM", "TOP")),
        bodies="extended", roller=None, at=(0.1, 0.5), toml={"strain": "1"}, data={"supports": {}, "tractions": {},
        "strain": lambda x, t: ((0.01 * t, 0.004 * t), (0.004 * t, -0.02 * t))}),
    "revolution": lambda: Column(data={"plane": "axisymmetric"}, toml={"plane": '"axisymmetric"'}),
    "curved": lambda: Column(joint=partial(ring, 1.0, 1.5, 2.0, 0.5, angle=1.2, cell="quadrilateral"), **RING,
        bodies="extended", toml=Conducting.toml | {"bodies": '"extended"', "mesh": MESH.replace("UPPER", "OUTER")}),
    "tapered": lambda: Column(layers=glue(profile=lambda x: 1 + 0.3 * x[0]), bodies="extended",
        toml=law("LinearElastic", ", profile = [1, 2]")),
    "3D": lambda: Column(joint=partial(sandwich, 2.0, 0.6, 0.9, 0.5, depth=1.0, cell="hexahedron"), at=(0.0, 0.9, 1.0)),
    "S2": lambda: Column(data={"element": "S2"}, toml={"element": '"S2"'}),
    "units": lambda: Column(joint=lambda: replace(joint := Column.joint(), points=1e3 * joint.points),
        layers=glue(eps=1e3 * EPS, stress=1e-3), at=(0.0, 900.0), length=1e3, stress=1e-3),
    "twin": Twin,
    "heat": Conducting,
    "heat fields": lambda: Conducting(layers=glue(Conduction(lambda x: 0.4 * (1 + 0.3 * x[0]))),
        toml=Conducting.toml | {"layer": f'{{law = "Conduction", k = "0.4 + 0.12 x", eps = {EPS}}}'}),
    "heat in UFL": lambda: Conducting(layers=glue(Radiating(0.4)), toml=Conducting.toml | law("Radiating")),
    "heat networks": lambda: Conducting(**WALL, supported="BOTTOM",
        toml=Conducting.toml | SEAMS | {"supports": "{BOTTOM = 1}"}),
    "heat revolution": lambda: Conducting(data={"plane": "axisymmetric"},
        toml=Conducting.toml | {"plane": '"axisymmetric"'}),
    "heat curved": lambda: Conducting(joint=partial(ring, 1.0, 1.5, 2.0, 0.5, angle=1.2, cell="quadrilateral"),
        supported="START/INNER", loaded="OUTSIDE", at=(2.0, 0.0),
        bodies="extended", toml=Conducting.toml | {"bodies": '"extended"', "mesh": MESH.replace("UPPER", "OUTER"),
            "supports": '{"START/INNER" = 1}', "fluxes": "{OUTSIDE = 0.3}"}),
    "heat tapered": lambda: Conducting(layers=glue(Conduction(0.4), profile=lambda x: 1 + 0.3 * x[0]), bodies="extended",
        toml=Conducting.toml | {"layer": f'{{law = "Conduction", k = 0.4, eps = {EPS}, profile = [1, 2]}}'}),
    "heat 3D": lambda: Conducting(at=(0.0, 0.9, 1.0),
        joint=partial(sandwich, 2.0, 0.6, 0.9, 0.5, depth=1.0, cell="hexahedron")),
    "march": lambda: Column(times=TIMES, toml=MARCHED),
}  # fmt: skip


def slopes(change: Any, model: Any, follow: Callable[[Any], Any], asked: Any) -> Any:
    """Differences of whole solves or marches, p dQ/dp of goals Q by a parameter p; their error is of the size of h^4."""
    values, h = [], 1e-3  # their rounding is 1e-8
    for k in (-2, -1, 1, 2):
        changed = change(model, 1 + k * h)
        state = getattr(solution := follow(changed), "last", solution)
        values.append([goal.value(state, changed) for goal in asked])
    return np.array((1, -8, 8, -1)) @ values / (12 * h)


@cache
def column(name: str) -> Column:
    """A column by its name; "free" has no roller, others are the plain one."""
    return (COLUMNS | {"free": lambda: Column(roller=None)}).get(name, Column)()
