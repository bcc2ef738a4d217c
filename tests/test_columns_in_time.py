"""Columns in time: uniform strain in each body and in the layer, so that both models agree at every step of a march.

Bodies are 0.5 high, E = 100, nu = 0.3. A column is pulled (sides u_T = 0) or sheared (sides u_n = 0). That both models
agree says nothing of the law, which they share: each law has its closed form as well.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import ufl
from mpi4py import MPI

from forms import BulkLaw, Incompressible, KelvinVoigt, LinearElastic, Maxwell, Norton, Stack, limits
from geometry import block, sandwich
from tests.own_laws import AgeingFluid, AgeingKelvinVoigt, AgeingSpring, Hardening, Slipping, StandardSolid
from thinlayer import History, ModelError, Structure, Surface, ThinLayer, march
from thinlayer.pointwise.material import Material

BODY = LinearElastic.young(100.0, 0.3)
LMBDA, MU = 60.0, 40.0
K = {"normal": LMBDA + 2 * MU, "shear": MU}
C = {"normal": 1 / (BODY.lmbda + 2 * BODY.mu), "shear": 1 / BODY.mu}  # compliance of both bodies together
G = {"normal": LMBDA * 0.3 + 2 * MU * 0.5, "shear": MU * 0.5}
T1, T2 = 0.7, 1.5
AXIS, LOAD, MOVE = {"normal": 1, "shear": 0}, {"normal": 1.0, "shear": 0.5}, {"normal": 0.02, "shear": 0.05}

ELASTIC = LinearElastic(20.0, 90.0)
KELVIN = KelvinVoigt(LMBDA, MU, 0.3, 0.5)
MAXWELL, MAXWELL_2 = Maxwell(LMBDA, MU, T1), Maxwell(LMBDA, MU, T1, T2)
NORTON_15, NORTON_3 = Norton(LMBDA, MU, 5.0, 1.5), Norton(LMBDA, MU, 5.0, 3.0)
LAWS = {
    "Kelvin-Voigt": KELVIN,
    "Maxwell": MAXWELL,
    "Maxwell t1 != t2": MAXWELL_2,
    "Norton 1.5": NORTON_15,
    "Norton 3": NORTON_3,
    "Maxwell, Kelvin-Voigt": Stack((0.3, MAXWELL), (0.7, KELVIN)),
    "elastic, Norton 1.5": Stack((0.4, ELASTIC), (0.6, NORTON_15)),
    "incompressible": Incompressible(MU),
    "user": StandardSolid(LMBDA, MU, 25.0, 0.4),
}
EXACT = 1e-9  # relative: MUMPS on cells as flat as 1e-4, Newton's method to 1e-10 of the forces
TIMES = [0.02, 0.05, 0.1]


def column(mode: str, **ends) -> dict:
    """Data of a column: `load` is the traction on top, or `move` the displacement of the top."""
    across, axis = "xy"[1 - AXIS[mode]], "xy"[AXIS[mode]]
    side = "x" if mode == "normal" else "y"
    top = {across: 0.0}
    tractions = {}
    if "move" in ends:
        top[axis] = ends["move"]
    else:
        load = ends["load"]
        vector = lambda value: (0.0, value) if mode == "normal" else (value, 0.0)
        tractions["TOP"] = (lambda x, t: vector(load(t))) if callable(load) else vector(load)
    supports = {"BOTTOM": 0.0, "LEFT": {side: 0.0}, "RIGHT": {side: 0.0}, "TOP": top}
    return {"body": BODY, "supports": supports, "tractions": tractions}


@cache
def joint(kind: str = "sandwich"):
    if kind == "block":
        return block(1.0, 0.5, 0.5, structured=True)
    return sandwich(1.0, 0.5, 0.5, 0.5, structured=True)


def check_same(limit: History, full: History, exact: float = EXACT) -> None:
    """Displacements of the bodies and energies at every step; jump and traction at the last one."""
    surface = Surface(limit.model)
    assert limit.t == pytest.approx(full.t)
    largest = max(np.abs(state.u.x.array).max() for state in limit)
    assert largest > 0
    for one, other in zip(limit, full, strict=True):
        assert np.abs(surface.displacement(other).x.array - one.u.x.array).max() < exact * largest, one.t
    energies = np.abs(limit.table["supplied"]).max()
    for name in ("supplied", "stored", "dissipated", "remainder"):
        assert full.table[name] == pytest.approx(limit.table[name], abs=exact * energies), name
    t = surface.traction(limit.last)
    assert surface.norm(surface.traction(full.last) - t) < exact * surface.norm(t)
    jump = surface.jump(limit.last)
    assert surface.norm(surface.jump(full.last) - jump) < exact * max(surface.norm(jump), 1e-3 * largest)


def check_balance(history: History) -> None:
    assert np.abs(history.table["imbalance"]).max() < 1e-10


def both(where, layer: ThinLayer, setup: dict, times, **options) -> tuple[History, History]:
    columns = Structure(where, **setup)
    models = columns.interface(layer), columns.full(layer, cells_through=1)
    return march(models[0], times, **options), march(models[1], times, **options)


# ---------------------------------------------------------------- interface = layer
@pytest.mark.parametrize(
    ("eps", "theta", "mode"),
    [
        (0.3, 1.0, "shear"),
        (0.3, 0.5, "normal"),
        (1e-2, 1.0, "normal"),
        (1e-2, 0.5, "shear"),
        (1e-4, 1.0, "shear"),
        (1e-4, 0.5, "normal"),
    ],
)
@pytest.mark.parametrize("name", LAWS)
def test_both_models_agree_at_every_step(name, eps, theta, mode):
    """A load that is sudden and then grows, in steps of several lengths."""
    setup = column(mode, load=lambda t: LOAD[mode] * (1 + 3 * t))
    limit, full = both(joint(), ThinLayer(LAWS[name], eps), setup, TIMES, theta=theta)
    check_same(limit, full)
    for history in (limit, full):
        check_balance(history)
        assert np.isfinite(history.table["stored"]).all()


@pytest.mark.parametrize("name", LAWS)
def test_rigid_base(name):
    mode = "normal" if name in ("Maxwell t1 != t2", "user", "elastic, Norton 1.5") else "shear"
    setup = column(mode, load=lambda t: LOAD[mode] * (1 + 3 * t))
    del setup["supports"]["BOTTOM"]
    limit, full = both(joint("block"), ThinLayer(LAWS[name], 0.02), setup, TIMES, theta=0.5)
    check_same(limit, full)
    for history in (limit, full):
        check_balance(history)


@pytest.mark.parametrize(
    ("law", "mode", "eps"),
    [
        (MAXWELL_2, "shear", 0.02),
        (NORTON_3, "shear", 0.02),
        (LAWS["Maxwell, Kelvin-Voigt"], "shear", 0.02),
        (Hardening(LMBDA, MU), "normal", 0.3),  # knows closing from opening
    ],
    ids=["Maxwell t1 != t2", "Norton 3", "Maxwell, Kelvin-Voigt", "user, closing"],
)
def test_moved_end(law, mode, eps):
    """The top is moved back and forth: loading, unloading, reversal."""
    setup = column(mode, move=lambda x, t: 0.05 * ufl.cos(20 * t))
    limit, full = both(joint(), ThinLayer(law, eps), setup, np.linspace(0, 0.3, 7)[1:])
    check_same(limit, full)
    for history in (limit, full):
        check_balance(history)


def test_cells_through_the_thickness_do_not_matter():
    layer = ThinLayer(LAWS["Maxwell, Kelvin-Voigt"], 0.05)
    setup = column("normal", load=1.0)
    limit = march(Structure(joint(), **setup).interface(layer), TIMES)
    check_same(limit, march(Structure(joint(), **setup).full(layer, cells_through=5), TIMES))


@pytest.mark.parametrize("angle", [np.pi / 2, np.pi])
def test_quarter_turns(angle):
    """The same column lying on its side and upside down."""
    straight, turned = column("shear", load=0.5), column("shear", load=0.5)
    if angle < 3:
        turned["supports"] = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}, "TOP": {"x": 0.0}}
        turned["tractions"] = {"TOP": (0.0, 0.5)}
    else:
        turned["tractions"] = {"TOP": (-0.5, 0.0)}
    layer = ThinLayer(LAWS["elastic, Norton 1.5"], 0.02)
    upright = march(Structure(joint(), **straight).interface(layer), TIMES)
    limit, full = both(joint().rotated(angle), layer, turned, TIMES)
    check_same(limit, full)
    for name in ("supplied", "stored", "dissipated"):
        assert limit.table[name] == pytest.approx(upright.table[name], rel=1e-9, abs=1e-15), name


ANGLE = 0.4
TRACTION = np.array([0.3, -0.8])


def held_traction(law: BulkLaw, t: np.ndarray, n: np.ndarray, times: list[float]) -> tuple[list, list]:
    """Jumps and stresses (2, 2) of a layer under a traction that is held, step by step at one point."""
    material, n3 = Material(MPI.COMM_SELF, law), np.append(n, 0.0)[None]
    slots, root = [0, 1, 3], 2**0.5
    contract = np.array([[n[0], 0], [0, n[1]], [n[1] / root, n[0] / root]])  # w -> strain, and its transpose
    w, e, q = np.zeros(2), np.zeros((1, 3)), np.zeros((1, material.memory))
    jumps, stresses = [w], [np.zeros((2, 2))]
    for dt in np.diff(times) if law.traits.rate else [0.0, *np.diff(times)]:
        old = e
        for _ in range(50):
            e = (contract @ w)[None]
            s, tangent, new, _, failed = material.update(slots, e, old, q, n3, dt, 1.0)
            assert failed == 0
            w = w + np.linalg.solve(contract.T @ tangent[0] @ contract, t - contract.T @ s[0])
        q = new
        jumps.append(w)
        stresses.append(np.array([[s[0, 0], s[0, 2] / root], [s[0, 2] / root, s[0, 1]]]))
    return (jumps, stresses) if law.traits.rate else (jumps[1:], stresses[1:])


@pytest.mark.parametrize("name", ["Kelvin-Voigt", "Maxwell t1 != t2", "Norton 1.5"])
def test_any_direction(name):
    """A column at an angle, pulled and sheared at once; the tractions on its sides follow the stresses of the layer."""
    turn = np.array([[np.cos(ANGLE), -np.sin(ANGLE)], [np.sin(ANGLE), np.cos(ANGLE)]])
    n, tangent, t = turn @ [0.0, 1.0], turn @ [1.0, 0.0], turn @ TRACTION
    law, times = LAWS[name], [0.0, *TIMES]
    jumps, stresses = held_traction(law, t, n, times)

    def side(sign):
        """The polynomial in t through the tractions at the ends of the steps."""
        powers = np.linalg.solve(np.vander(times, increasing=True), [sign * s @ tangent for s in stresses])
        return lambda x, time: sum(row * time**k for k, row in enumerate(map(ufl.as_vector, powers.tolist())))

    a = np.linalg.solve(limits.elastic_stiffness(BODY.lmbda, BODY.mu, n), t)
    e = (np.outer(a, n) + np.outer(n, a)) / 2
    body = BODY.lmbda * np.trace(e) * np.eye(2) + 2 * BODY.mu * e
    tractions = {"TOP": tuple(t)}
    for edge, sign in (("LEFT", -1), ("RIGHT", 1)):
        tractions |= {f"{edge}/{region}": tuple(sign * body @ tangent) for region in ("LOWER", "UPPER")}
        tractions[f"{edge}/LAYER"] = side(sign)
    setup = {"body": BODY, "supports": {"BOTTOM": 0.0}, "tractions": tractions}
    limit, full = both(joint().rotated(ANGLE), ThinLayer(law, 0.05), setup, TIMES)
    check_same(limit, full)
    surface = Surface(limit.model)
    for state, w in zip(limit, jumps, strict=True):
        difference = surface.jump(state) - ufl.as_vector(w.tolist())
        assert surface.norm(difference) < EXACT * np.linalg.norm(jumps[-1])


@pytest.mark.parametrize(("cell", "mode"), [("hexahedron", "normal"), ("tetrahedron", "shear")])
def test_three_dimensions(cell, mode):
    """A law with memory of the whole stress, rate and layers in series; as in two dimensions."""
    where = sandwich(1.0, 0.5, 0.5, 0.5, depth=0.5, cell=cell, structured=True)
    law = Stack((0.5, MAXWELL_2), (0.5, KELVIN))
    setup = column(mode, load=LOAD[mode])
    plane = setup["supports"]
    sides = {"normal": {"z": 0.0}, "shear": {"y": 0.0, "z": 0.0}}[mode]
    plane |= {"BACK": sides, "FRONT": sides, "TOP": plane["TOP"] | {"z": 0.0}}
    if mode == "shear":
        plane |= {edge: sides for edge in ("LEFT", "RIGHT")}
    setup["tractions"] = {"TOP": (*setup["tractions"]["TOP"], 0.0)}
    limit, full = both(where, ThinLayer(law, 0.05), setup, TIMES)
    check_same(limit, full)
    check_balance(full)
    flat = march(Structure(joint(), **column(mode, load=LOAD[mode])).interface(ThinLayer(law, 0.05)), TIMES)
    assert limit.table["supplied"] == pytest.approx(0.5 * flat.table["supplied"], rel=1e-9, abs=1e-15)


# ---------------------------------------------------------------- closed forms
def jump_of(history: History, mode: str, state=None) -> float:
    surface = Surface(history.model)
    return surface.integral(surface.jump(state or history.last)[AXIS[mode]])


def marched(law: BulkLaw, mode: str, theta: float, times, **ends) -> History:
    model = Structure(joint(), **column(mode, **ends)).interface(ThinLayer(law, 0.1))
    return march(model, times, theta=theta)


SERIES = Stack((0.3, MAXWELL), (0.5, KELVIN), (0.2, LinearElastic(LMBDA, MU)))


def series_creep(mode, t):
    parts = [
        limits.maxwell_creep(LOAD[mode], K[mode], T1, t),
        limits.kelvin_voigt_creep(LOAD[mode], K[mode], G[mode], t),
        LOAD[mode] / K[mode],
    ]
    return limits.stack_creep(SERIES.fractions, parts)


def kelvin_creep(mode, t):
    return limits.kelvin_voigt_creep(LOAD[mode], K[mode], G[mode], t)


def kelvin_moved(mode, t):
    return limits.kelvin_voigt_displaced(MOVE[mode], K[mode], G[mode], C[mode], t)


def maxwell_moved(mode, t):
    return MOVE[mode] - C[mode] * limits.maxwell_relaxation(MOVE[mode], K[mode], C[mode], T1, t)


def two_times_creep(mode, t):
    return limits.maxwell_normal_creep(LMBDA, MU, T1, T2, LOAD[mode], t)


def norton_creep(p):
    return lambda mode, t: limits.norton_creep(LOAD[mode], K[mode], 5.0, p, t, shear=mode == "shear")


CLOSED = {  # law, mode, whether the end is moved, end of time, jump(mode, t), number at t = 1 from independent code
    "Kelvin-Voigt creep N": (KELVIN, "normal", False, 1.0, kelvin_creep, 0.00650374813452),
    "Kelvin-Voigt creep T": (KELVIN, "shear", False, 1.0, kelvin_creep, 0.0108083089595),
    "Kelvin-Voigt moved N": (KELVIN, "normal", True, 0.3, kelvin_moved, None),
    "Maxwell moved N": (MAXWELL, "normal", True, 1.0, maxwell_moved, 0.02 - C["normal"] * 0.681396777691),
    "Maxwell moved T": (MAXWELL, "shear", True, 1.0, maxwell_moved, 0.05 - C["shear"] * 0.486711984065),
    "Maxwell t1 != t2 creep N": (MAXWELL_2, "normal", False, 1.0, two_times_creep, None),
    "Norton 1.5 creep N": (NORTON_15, "normal", False, 0.3, norton_creep(1.5), None),
    "Norton 1.5 creep T": (NORTON_15, "shear", False, 1.0, norton_creep(1.5), 0.00866886620207),
    "Norton 3 creep N": (NORTON_3, "normal", False, 0.01, norton_creep(3.0), None),
    "Norton 3 creep T": (NORTON_3, "shear", False, 0.01, norton_creep(3.0), None),
    "stack creep N": (SERIES, "normal", False, 1.0, series_creep, None),
    "stack creep T": (SERIES, "shear", False, 1.0, series_creep, None),
}


@pytest.mark.parametrize(("theta", "order"), [(1.0, 1), (0.5, 2)])
@pytest.mark.parametrize("name", CLOSED)
def test_order_in_time(name, theta, order):
    """Jumps at the last time; their extrapolation to steps of length zero is the closed form, and the number."""
    law, mode, moved, end, closed, number = CLOSED[name]
    ends = {"move": MOVE[mode]} if moved else {"load": LOAD[mode]}
    expected = float(closed(mode, end))
    steps = (16, 32)
    found = [jump_of(marched(law, mode, theta, np.linspace(0, end, n + 1)[1:], **ends), mode) for n in steps]
    coarse, fine = np.abs(np.array(found) / expected - 1)
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.12)
    extrapolated = found[-1] + (found[-1] - found[-2]) / (2**order - 1)
    near = 2e-3 if order == 1 else 2e-5
    assert extrapolated == pytest.approx(expected, rel=near)
    if number:
        assert expected == pytest.approx(number, rel=1e-11)
        assert extrapolated == pytest.approx(number, rel=near)


@pytest.mark.parametrize("mode", ["normal", "shear"])
def test_maxwell_creep_is_exact(mode):
    """A constant traction makes the jump linear in time: both schemes are exact."""
    for theta in (1.0, 0.5):
        history = marched(MAXWELL, mode, theta, [0.1, 0.5, 1.0], load=LOAD[mode])
        for state in history:
            expected = limits.maxwell_creep(LOAD[mode], K[mode], T1, state.t)
            assert jump_of(history, mode, state) == pytest.approx(expected, rel=1e-11)


def test_incompressible_column():
    """[u_N] = 0 whatever the normal traction; [u_T] = t_T/mu at any time."""
    for mode, expected in (("normal", 0.0), ("shear", 0.5 * 1.3 / MU)):
        history = marched(LAWS["incompressible"], mode, 0.5, TIMES, load=lambda t, m=mode: LOAD[m] * (1 + 3 * t))
        assert jump_of(history, mode) == pytest.approx(expected, rel=1e-10, abs=1e-14)
        surface = Surface(history.model)
        t = surface.integral(surface.traction(history.last)[AXIS[mode]])
        assert t == pytest.approx(LOAD[mode] * 1.3, rel=1e-10)


def test_traction_law_in_time():
    """A law of jump and traction on S, without eps: a Maxwell law when sheared, in closing stiffer than in opening."""
    law = Slipping(70.0, MU, MU * T1, 900.0)
    for mode, move in (("normal", 0.02), ("normal", -0.02), ("shear", 0.05)):
        setup = column(mode, move=move)
        history = march(Structure(joint(), **setup).interface(law), np.linspace(0, 1, 21)[1:], theta=0.5)
        if mode == "shear":
            assert jump_of(history, mode) == pytest.approx(maxwell_moved(mode, 1.0), rel=1e-4)
        else:  # (d - w)/c = k_N w - closed w^2
            b, c = 70.0 + 1 / C[mode], move / C[mode]
            root = 2 * c / (b + np.sqrt(b**2 - 4 * 900.0 * c))
            assert jump_of(history, mode) == pytest.approx(root, rel=1e-9)
        assert np.isnan(history.table["imbalance"]).all()  # it declares no energy
        assert np.isfinite(history.table["supplied"]).all()
    with pytest.raises(ModelError, match="Slipping is a law of jump and traction: it has no meshed layer"):
        Structure(joint(), **column("shear", load=0.5)).full(law)


# ---------------------------------------------------------------- the first state
@pytest.mark.parametrize("name", LAWS)
def test_first_state(name):
    """Laws that answer at once: the elastic response to the sudden load; laws with a rate: rest."""
    law = LAWS[name]
    history = marched(law, "shear", 1.0, [0.1], load=0.5)
    first = next(iter(history))
    assert first.t == 0.0
    assert len(history) == 2
    if law.traits.rate:
        assert not first.u.x.array.any()
        assert history.table["supplied"][0] == 0.0
        return
    stiffness = MU + 25.0 if name == "user" else MU  # both springs of the solid
    w = 0.5 / stiffness
    assert jump_of(history, "shear", first) == pytest.approx(w, rel=1e-10)
    work = 0.5 * (w + 0.5 * C["shear"])
    row = {key: history.table[key][0] for key in ("supplied", "stored", "dissipated", "remainder")}
    expected = {"supplied": work, "stored": work / 2, "dissipated": 0.0, "remainder": work / 2}
    assert row == pytest.approx(expected, rel=1e-10, abs=1e-15)


# ---------------------------------------------------------------- energies
def dissipated(name: str, mode: str, dt: float, rate: float, t: float) -> float:
    """Of a step: dt G v^2, dt t^2/(K t1), dt c v^p with the rate of the jump and the traction at t + theta dt."""
    if name == "Kelvin-Voigt":
        return dt * G[mode] * rate**2
    if name == "Maxwell":
        return dt * t**2 / (K[mode] * T1)
    p = LAWS[name].p
    return dt * 5.0 * (2 ** (-p / 2) if mode == "shear" else 1.0) * abs(rate) ** p


@pytest.mark.parametrize("theta", [1.0, 0.75, 0.5])
@pytest.mark.parametrize(
    ("name", "mode"),
    [("Kelvin-Voigt", "normal"), ("Maxwell", "shear"), ("Norton 1.5", "shear"), ("Norton 3", "normal")],
)
def test_energy_balance(name, mode, theta):
    """The remainder is (2 theta - 1) times the energy of the increments; what is dissipated has its closed form."""
    law, load = LAWS[name], lambda t: LOAD[mode] * (1 + 3 * t)
    history = marched(law, mode, theta, TIMES, load=load)
    check_balance(history)
    assert (history.table["dissipated"][1:] > 0).all()
    jumps = [jump_of(history, mode, state) for state in history]
    first = 1 if law.traits.rate else 0
    for k in range(1, len(history)):
        # the first interval of a march from rest is made of two backward Euler steps unless theta = 1
        share = 1.0 if law.traits.rate and k <= 2 and theta < 1 else theta
        row = {key: history.table[key][k] for key in ("dissipated", "remainder", "dt", "t", "supplied")}
        before = row["t"] - row["dt"]
        at_rest = law.traits.rate and k == first  # the traction was still zero
        t, t_old = load(row["t"]), 0.0 if at_rest else load(before)
        mid = share * load(row["t"]) + (1 - share) * load(before)
        change, rate = jumps[k] - jumps[k - 1], (jumps[k] - jumps[k - 1]) / row["dt"]
        spring = (t - t_old) ** 2 / K[mode] if name == "Maxwell" else K[mode] * change**2
        expected = (2 * share - 1) * (spring + C[mode] * (t - t_old) ** 2) / 2
        # forces balance at t + theta dt: tractions at the ends of steps are those of the load only for theta = 1
        if share == 1.0 or theta == 0.5:
            assert row["remainder"] == pytest.approx(expected, rel=1e-8, abs=1e-12 * row["supplied"])
        assert row["dissipated"] == pytest.approx(dissipated(name, mode, row["dt"], rate, mid), rel=1e-8)
    if theta < 1:
        assert len(history) == len(TIMES) + 1 + law.traits.rate
    if theta > 0.5:
        assert (history.table["remainder"][first:] > 0).all()


FLUID, SOLID = AgeingFluid(MU, 0.4, 3.0), AgeingKelvinVoigt(LMBDA, MU, 0.3, 0.5, 2.0)


@pytest.mark.parametrize(
    ("law", "theta"),
    [
        (AgeingSpring(MU, 5.0), 1.0),
        (FLUID, 1.0),
        (FLUID, 0.5),
        (SOLID, 0.75),
        (Stack((0.3, FLUID), (0.7, SOLID)), 1.0),
        (Stack((0.3, FLUID), (0.7, SOLID)), 0.5),
    ],
    ids=["spring", "fluid", "fluid, midpoint", "solid", "stack", "stack, midpoint"],
)
def test_parameters_that_vary_in_time(law, theta):
    """Energies of both models: a stack's own, on S, are those of its laws one by one, in the meshed layer."""
    setup = column("shear", load=lambda t: 0.5 * (1 + 3 * t))
    limit, full = both(joint(), ThinLayer(law, 0.02), setup, TIMES, theta=theta)
    check_same(limit, full)
    for history in (limit, full):
        check_balance(history)


def test_energy_of_a_stiffness_that_varies_in_time():
    """Stored is K(t) w^2/2; the remainder also has what the change of K takes out at the strain before, -dK w_old^2/2."""
    load = lambda t: 1 + 3 * t
    history = marched(AgeingSpring(MU, 5.0), "normal", 1.0, TIMES, load=load)
    w = [jump_of(history, "normal", state) for state in history]
    for k, state in enumerate(history):
        now, before = (2 * MU * (1 + 5 * history.t[i]) for i in (k, max(k - 1, 0)))
        assert state.energies()["layer"] == pytest.approx(now * w[k] ** 2 / 2, rel=1e-8)
        if k:
            bodies = C["normal"] * (load(history.t[k]) - load(history.t[k - 1])) ** 2 / 2
            expected = bodies + now * (w[k] - w[k - 1]) ** 2 / 2 - (now - before) * w[k - 1] ** 2 / 2
            assert history.table["remainder"][k] == pytest.approx(expected, rel=1e-8)


def test_energy_at_the_end_of_a_midpoint_step():
    """It has the strain, the flow and the parameters of the end: mu(t) (w - eps flow)^2."""
    history = marched(FLUID, "normal", 0.5, TIMES, load=lambda t: 1 + 3 * t)
    for state in history:
        flow = state.memory["layer"][:, 1]
        assert flow == pytest.approx(flow[0], rel=1e-9)
        elastic = jump_of(history, "normal", state) - 0.1 * flow[0]
        expected = MU * (1 + 3 * state.t) * elastic**2
        assert state.energies()["layer"] == pytest.approx(expected, rel=1e-8)
