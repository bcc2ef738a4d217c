"""A table of what the package can do, by traits of models: each cell has an independent number, or its refusal."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import pyvista
import ufl
from scipy.spatial import cKDTree

from geometry.parallel import on_root
from tests.capabilities import COLUMNS, EPS, LOAD, TIMES, Column, column, slopes
from tests.on_ranks import Asked
from tests.refused import refused
from thinlayer import (
    Probe,
    RangeWarning,
    Surface,
    Zoom,
    compare,
    derivative,
    ensemble,
    estimate,
    fields,
    goals,
    march,
    solve,
    sweep,
    thin_enough,
)  # fmt: skip
from thinlayer.errors import ThinlayerError
from thinlayer.estimating.derivative import chosen_changes
from thinlayer.running.case import DescribedCase
from thinlayer.running.description import Description

Numbers = list[tuple[float, int, int]]  # values, and their powers of length and of stress
ROUNDING = 1e-8  # relative: of solves by MUMPS, and of Newton's method


def near(a, b, rel=ROUNDING, size=0.0):
    scale = max(np.abs(a).max(), np.abs(b).max(), size)
    assert np.abs(np.asarray(a) - b).max() <= rel * scale, (a, b)


def in_balance(c: Column, state) -> np.ndarray:
    """Force of the place that holds the lower body, once all forces have been found to add up to zero."""
    if not (forces := [reaction.components for reaction in state.reactions_by_place().values()]):
        return np.zeros(2)
    unseen = c.unseen(state, state.model.domain.joint.regions) if c.unseen else 0.0
    near(sum(forces) + state.applied().components + unseen, 0.0, size=np.abs(forces).max())
    return state.reaction(c.supported).components


def forces(c: Column, state) -> Numbers:
    return [(value, len(c.at) - 1, 1) for value in c.turned(in_balance(c, state))]


# ---------------------------------------------------------------- rows
def solved(c, folder):
    """All forces add up to zero; in a periodic cell the mean stress works in the mean strain what is stored (Hill)."""
    state = solve(c.model, 1.0)
    if c.structure.strain:
        size, stored = np.ptp(c.structure.joint.points, axis=0).prod(), state.energies()
        near(2 * (stored["bodies"] + stored["layer"]), size * (state.mean_stress() * state.mean_strain()).sum())
    return forces(c, state)


def marched(c, folder):
    """Energies balance at every step; without a past the last state is that of one solve."""
    history = march(c.model, TIMES)
    first = int(c.scalar)  # where the value is uniform, so that energies are rounding
    assert not (np.abs(history.table["imbalance"][first:]) > ROUNDING).any()
    if not c.past:
        near(history.last.u.x.array, solve(c.model, 1.0).u.x.array)
    return forces(c, history.last)


def resumed(c, folder):
    """A march that is broken off and resumed ends as one that is not."""
    march(c.model, TIMES[:1], out=folder / "run")
    resumed = march(c.model, TIMES, out=folder / "run", resume=True).last
    near(resumed.u.x.array, march(c.model, TIMES).last.u.x.array)
    return forces(c, resumed)


def compared(c, folder):
    """Law and mesh agree, roughly, and forces on the mesh add up to zero."""
    meshed = c.meshed()
    errors = [compare(meshed, c.state)[f"error_{name}"] for name in (c.traction, "jump")]
    assert 1e-6 < min(errors) < max(errors) < 0.25
    return [*forces(c, meshed), *((error, 0, 0) for error in errors)]


def estimated(goal: Callable[[Column], goals.Goal], powers, c, folder):
    """A goal's bounds contain that of the structure with the same cells in its layer; its change is known to a tenth."""
    asked = goal(c)
    result = estimate(c.follow(c.model), c.layers if c.bonded else None, [asked])
    goal_error, rounding = result.goals[asked.name], 1e-6 * result.goals[asked.name].scale
    meshed = asked.value(c.meshed({name: each.layer for name, each in result.layers.items()}), result.better.model)
    assert not goal_error.bounded or goal_error.lower - rounding <= meshed <= goal_error.upper + rounding
    assert abs(goal_error.better - meshed) <= max(0.1 * abs(meshed - goal_error.value), rounding)
    errors = [(value, 0, 0) for value in (result.traction, result.jump) if np.isfinite(value)]
    share = c.whole(*powers(len(c.at))) if asked.name == "compliance" else 1.0
    return [*((value / share, *powers(len(c.at))) for value in (goal_error.value, goal_error.better)), *errors]


AXIS = (1.0, 0.4, 0.1)
GOALS = {
    "Compliance": (lambda c: goals.Compliance(), lambda d: (d, 1)),
    "Reaction": (lambda c: goals.Reaction(c.supported, c.along(AXIS)), lambda d: (d - 1, 1)),
    "MeanTraction": (lambda c: goals.MeanTraction(c.along(AXIS), c.seam), lambda d: (0, 1)),
    "Displacement": (lambda c: goals.Displacement(c.at, c.along(AXIS)), lambda d: (1, 0)),
    "Functional": (lambda c: goals.Functional("square", lambda u, model: ufl.inner(u, u)
        * model.ds(model.domain.values(c.loaded))), lambda d: (d + 1, 0)),
}  # fmt: skip


def differentiated(c, folder):
    """Derivatives of two goals, by a thickness or load and a parameter at random, are differences of whole solves."""
    changes, solution, k = chosen_changes(c.model, None, {}), c.follow(c.model), [*map(column, COLUMNS), c].index(c)
    first = [name for name in (f"{c.seam}.eps", f"{c.load_name} {c.loaded}") if name in changes][:1]
    others = [name for name in changes if name not in first]
    names = [*first, str(np.random.default_rng(k).choice(others))]
    asked = {name: GOALS[name][0](c) for name in ("Functional", "Displacement")}
    results = [derivative(solution, goal, names) for goal in asked.values()]
    for name in names:
        for result, slope in zip(results, slopes(changes[name], c.model, c.follow, asked.values()), strict=True):
            near(result.by[name], slope, 1e-6, abs(result.value))
    return [(r.by[name], *GOALS[of][1](len(c.at))) for of, r in zip(asked, results, strict=True) for name in first]


def thin(c, folder):
    """At the thickness found the meshed layer errs by the tolerance, and by no more."""
    options = {"times": c.times or None, "bodies": c.bodies, "bonded": c.bonded}
    goal, seam = goals.Compliance(), {"seam": c.seam} if isinstance(c.layers, dict) else {}
    result = thin_enough(c.structure, c.layers, 0.02, goal, t=1.0, **options, **seam)
    eps = result.eps
    layer = {**c.layers, c.seam: replace(c.layers[c.seam], eps=eps)} if seam else replace(c.layers, eps=eps)
    state = c.state if c.bonded else c.reach(c.interface(layer))
    error = abs(goal.value(state, state.model) / goal.value(c.meshed(layer), state.model) - 1)
    assert error < 1.1 * 0.02
    assert error > 0.8 * 0.02 or not result.at_tolerance
    return [(result.eps, 1, 0)]


def zoomed(c, folder):
    """The stress in the middle of the layer is that in the meshed one."""
    x = Surface(c.model, c.seam).x[:, 1, 0]
    stress, meshed = (getattr(Zoom(state, c.seam), c.stresses)(x) for state in (c.state, c.meshed()))
    near(stress, meshed, 0.15)
    return [(c.turned(c.turned(stress).T).T[1].sum() if c.scalar else c.turned(c.turned(stress).T)[1, 1], 0, 1)]


def probed(c, folder):
    """The displacements on both sides of S differ by its jump."""
    surface, sides = Surface(c.model, c.seam), ("lower", "upper")
    places = np.einsum("qa,sfad->sfqd", surface.shapes, surface.faces)[:, 1, 0]
    probe = getattr(Probe(c.state), c.values)
    lower, upper = (np.atleast_1d(probe(x, side=name)) for x, name in zip(places, sides, strict=True))
    near(upper - lower, surface.jump(c.state)[:, 1, 0], size=np.abs(upper).max())
    return [(value, 1, 0) for value in c.turned(upper)]


def crossed(field, c, folder):
    """All that loads the upper body goes through S to the place that holds the lower one."""
    surface = Surface(c.model, c.seam)
    force = surface.integral(getattr(surface, field)(c.state))
    if c.structure.plane == "axisymmetric" and not c.scalar:
        force[0] = 0.0  # forces along radii add up to zero over the revolution
    unseen = c.unseen(c.state, ("LOWER",)) if c.unseen else 0.0
    rel = 0.01 if c.scalar and field == "reaction" else ROUNDING  # at order 1 fluxes of both sides differ
    near(force, -in_balance(c, c.state) - unseen, rel, size=np.abs(LOAD).max() * c.stress)
    return [(value, len(c.at) - 1, 1) for value in c.turned(force)]


def opened(c, folder):
    """What S opens by is what the bodies do not fill, by Gauss' theorem."""
    model, joint, surface, u = c.model, c.structure.joint, Surface(c.model), c.vector(c.state.u)
    n, x = ufl.FacetNormal(model.V.mesh), ufl.SpatialCoordinate(model.V.mesh)
    divergence = ufl.div(u) + (u[0] / x[0] if c.structure.plane == "axisymmetric" else 0)
    inner = [*joint.seams, *(joint.periods.side_names if joint.periods else ())]
    sides = [model.ds(model.domain.values(name)) for name in joint.facets if name not in inner]
    outside = sum(c.state.integral(ufl.inner(u, n) * ds) for ds in sides)
    opening = surface.integral((surface.jump(c.state) * (surface.n[1:2] if c.scalar else surface.n)).sum(axis=0))
    rel = ROUNDING if c.bodies == "kept" else EPS  # others stand half a thickness away from S
    near(opening, outside - c.state.integral(divergence * model.dx), rel, abs(outside))
    return [(opening / c.whole(joint.dim, 0), joint.dim, 0)]


def status_shares(c, folder):
    """Each facet has one of the statuses that its law can have, and shares of the areas add up to one."""
    surface = Surface(c.model)
    rows = surface.table(c.state).rows
    assert {*surface.status(c.state).ravel()} <= c.statuses
    near([sum(row.get(name) or 0.0 for name in c.statuses) for row in rows], 1.0)
    near(sum(row["size"] for row in rows), surface.integral(1.0))
    return [(row["size"], len(c.at) - 1, 0) for row in rows if row["seam"] == c.seam]


def filed(c, folder):
    """A file has the displacements that a probe finds at its points, and the tractions on S."""
    fields.write(c.state, folder / "run.pvd")
    blocks, surface, d = pyvista.read(next(folder.glob("run_pvd/*.vtm"))), Surface(c.model), len(c.at)
    body, on_s = blocks["bodies"], blocks["S"]
    off = cKDTree(on_s.points).query(body.points)[0] > 1e-6 * c.length
    d, u = (1, body["T"][:, None]) if c.scalar else (d, body["u"])
    near(np.reshape(getattr(Probe(c.state), c.values)(body.points[off, : len(c.at)]), (-1, d)), u[off, :d])
    tractions = on_s[c.traction].reshape(len(surface.rows), -1, on_s[c.traction].size // len(on_s.points))
    middle = tractions[:, : surface.corners.shape[1], :d].mean(axis=1)
    near(middle.T, surface.traction(c.state).mean(axis=2), size=c.stress)
    return [(np.linalg.norm(x, axis=1).max(), k, 1 - k) for k, x in ((1, u), (0, middle))]


def in_ensemble(c, folder):
    """Rows are those of single runs, in the table and in its file."""
    c.state.energies()  # before groups of ranks have models of their own
    run = lambda case: {"stored": c.reach(c.model, case["t"]).energies()["bodies"]}
    table = ensemble(lambda: run, [{"t": 0.5}, {"t": 1.0}], folder / "runs.csv")
    near(table["stored"][1], c.state.energies()["bodies"])
    near(np.genfromtxt(folder / "runs.csv", delimiter=",", names=True)["stored"], table["stored"])
    return [(value / c.whole(len(c.at), 1), len(c.at), 1) for value in table["stored"]]


def swept(c, folder):
    """The difference from the mesh falls with the thickness."""

    run = lambda eps: compare(c.meshed(c.at_eps(eps)), c.reach(c.interface(c.at_eps(eps))))
    errors = sweep(run, [EPS * c.length, EPS / 2 * c.length])[f"error_{c.traction}"]
    assert errors[1] < 0.75 * errors[0]
    return [(value, 0, 0) for value in errors]


def described(c, folder):
    """A structure that a file describes has the same work of its loads."""
    case = DescribedCase.from_description(Description.read(on_root(c.model.comm, lambda: c.described(folder))))
    model, times = case.structure.bonded() if case.description.bonded else case.make_model(), case.description.times
    state = march(model, times).last if times else solve(model)
    near(state.load_work(), c.state.load_work())
    return [(state.load_work() / c.whole(len(c.at), 1), len(c.at), 1)]


ROWS = {
    "solve": solved, "march": marched, "resume": resumed, "compare": compared,
    "derivative": differentiated,
    **{f"estimate {name}": partial(estimated, *args) for name, args in GOALS.items()}, "thin_enough": thin,
    "Zoom": zoomed, "Probe": probed, **{name: partial(crossed, name) for name in ("traction", "reaction")}, "jump": opened,
    "status": status_shares, "files": filed, "ensemble": in_ensemble, "sweep": swept, "TOML": described,
}  # fmt: skip

# ---------------------------------------------------------------- the table
RANKS = "two ranks"
ESTIMATES = [name for name in ROWS if name.startswith("estimate")]
CONTACT, LAWS = ["contact 1", "contact 2"], ["not symmetric", "softening", "in time", "law in UFL", "law in C"]
SOFTENING = ["softening", "breaking"]
REFUSALS = [
    (["solve"], ["rate", "inertia"], "depends on rates: no equilibrium without time"),
    (["solve"], SOFTENING, "falls as jumps grow, with several equilibria"),
    (["Zoom"], ["memory"], "it remembers earlier steps"),
    (["Zoom"], ["rate"], "has a rate, of which a state does not know"),
    ([*ESTIMATES, "thin_enough", "Zoom"], SOFTENING, "a stress that falls as strains grow"),
    (["derivative"], CONTACT, "a law of contact has kinks"),
    (["derivative"], SOFTENING, "'layer' has a kink in the step to t = 1"),
    (["derivative"], ["inertia"], "the part 'inertia' remembers; define its memory_forces and pullback"),
    (["compare", *ESTIMATES, "Zoom", "sweep"], CONTACT, "a law on S, without a thickness"),
    (["thin_enough"], CONTACT, "give a ThinLayer"),
    ([*ESTIMATES, "thin_enough", "Zoom"], ["gaps"], "BED meets HEAD, where bodies part without a layer"),
    ([*ESTIMATES, "thin_enough"], ["inertia"], "remembers steps beside the layers"),
    (["compare"], ["bonds"], "the same open or bonded seams, not none and S"),
    (["Zoom"], ["bonds"], "the seam 'S' has no layer"),
    (["compare", *ESTIMATES, "thin_enough", "Zoom", "sweep"], ["periodic"], "S reaches one of the periodic sides"),
    (["estimate Reaction"], ["cell"], "nothing holds 'BOTTOM'"),
    (["thin_enough"], ["cell"], "compliance is zero, and so has no relative error"),
    (["TOML"], [*LAWS, *CONTACT], "unknown law of strains"),
    (["TOML"], ["plates", "springs", "own form", "inertia", "periodic", "cell"], "unknown key '"),
    (["TOML"], ["breaking"], "the path has no direction"),  # supports in files do not grow
    (["TOML"], ["tapered"], "unknown key of LinearElastic 'profile'"),
    (["TOML"], ["fields", "prestress"], "number"),
    (["TOML"], ["gaps"], "the seam 'HEAD' has no layer"),
    (["TOML"], ["heat in UFL"], "unknown law of strains"),
    (["TOML"], ["heat fields"], "number"),
    (["TOML"], ["heat tapered"], "unknown key of Conduction 'profile'"),
]
REFUSED = {(row, name): words for rows, names, words in REFUSALS for row in rows for name in names}


def numbers(row: str, name: str, folder: Path) -> Numbers:
    with warnings.catch_warnings(action="ignore", category=RangeWarning):
        return [(float(value), *powers) for value, *powers in ROWS[row](column(name), folder)]


@pytest.mark.few(24)
@pytest.mark.parametrize(("row", "name"), [(row, name) for name in COLUMNS for row in ROWS])
def test_a_cell(row, name, tmp_path):
    """It has its independent number, or its refusal; units change no number, nor does a march of what has no past."""
    if (row, name) in REFUSED:
        refused(ThinlayerError, re.escape(REFUSED[row, name]), numbers, row, name, tmp_path)
    else:
        values, c = numbers(row, name, tmp_path), column(name)
        if plain := {"units": "plain", "march": "plain", "twin": "free"}.get(name):
            (tmp_path / "plain").mkdir()
            wanted = [x * c.length**a * c.stress**b for x, a, b in numbers(row, plain, tmp_path / "plain")]
            # steps end elsewhere: of Newton's method, and towards the mesh, which are judged for both copies at once
            rel = {"thin_enough march": 1e-3, "thin_enough twin": 0.1}.get(
                f"{row} {name}", 1e-5 if name == "twin" else 1e-6
            )
            near([x for x, *_ in values], wanted, rel)


for row in ROWS:  # for `Asked`, which finds functions by their names
    globals()[f"two ranks {row}"] = partial(lambda row, folder: numbers(row, RANKS, folder), row)


ASKED = [(Asked(f"{__name__}:two ranks {row}", 2), row) for row in ROWS]


@pytest.mark.few(24)
@pytest.mark.parametrize(("there", "row"), ASKED, indirect=["there"])
def test_a_cell_on_two_ranks(row, there, tmp_path):
    near([x for x, *_ in there], [x for x, *_ in numbers(row, RANKS, tmp_path)], 1e-6)


def test_every_pair_is_run_or_refused():
    """A new row or column changes these counts, once its refusals are known."""
    cells = {(row, name) for name in (*COLUMNS, RANKS) for row in ROWS}
    assert {*REFUSED} <= cells
    assert (len(cells) - len(REFUSED), len(REFUSED)) == (729, 90)
