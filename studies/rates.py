"""Comparisons of interface laws with meshed layers as eps -> 0: errors are O(eps), for laws of order 1 O(eps^2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np

from forms import (
    Conduction,
    Incompressible,
    KelvinVoigt,
    LinearElastic,
    Maxwell,
    MohrCoulombMonodirectional,
    Norton,
    Rubber,
    Stack,
    TractionLaw,
    VonMises,
)
from studies import bands, phases, problems
from studies import fig3_mohr_coulomb as fig3
from studies.bands import MODULI, RETURN_PATH
from studies.problems import (
    FOURIER_BODY,
    FOURIER_LAYER,
    MORTAR_LAW,
    LoadPath,
    Problem,
    fourier,
    layer_fn,
    pressed,
    sheared,
)
from studies.sweeping import (
    ErrorFloors,
    Sweep,
    Tables,
    check_floors,
    draw_along,
    end_state,
    halves,
    last_order,
    reaction_error,
    table_file,
)
from thinlayer import Structure, Surface, Table, ThinLayer, plotting, solve
from thinlayer.output.plotting.curves import COLOURS, ERROR_COLUMNS
from thinlayer.running.record import Record
from thinlayer.solving.history import History, Solution

# ---------------------------------------------------------------- checks in addition to the orders
EARLY, SPECTRAL = 0.05, {"traction": 0.56140781698, "jump": 7.0602412711e-4}  # time; norms on S, p = 1.5, same steps
FRACTION, LESS = 0.01, 1e-4  # elastic fractions: pulled layers have no shear strength, open layers none along n
FLOOR = {"traction": (0.14, 0.18), "jump": (0.26, 0.31)}  # relative errors of Coulomb's law with tan(Omega)
PRINTED_FLOOR = {"traction": (0.13, 0.16), "jump": (0.22, 0.26)}  # the same of wrong laws in `phases`
ONE_BRANCH_FLOOR, GAIN_FLOOR = {"traction": (0.12, 0.16), "jump": (0.29, 0.35)}, {"traction": (0.018, 0.026)}


def early_norms(_: Solution, limit: Solution) -> dict[str, float]:
    """Return the L2 norms on S of traction and jump of the interface law at the time 0.05.

    The first argument, the full model's solution, is not used.

    Args:
        limit: history of the interface model.

    Returns:
        "early_traction" and "early_jump" -> norm; problems of this study have no units.
    """
    assert isinstance(limit, History)
    state, surface = limit.at(EARLY), Surface(limit.model)
    return {f"early_{field.__name__}": surface.norm(field(state)) for field in (surface.traction, surface.jump)}


def check_spectral(record: Record, tables: Tables) -> None:
    """Check the norms "early_traction" and "early_jump" of a Norton layer against a solution by a spectral method.

    Args:
        record: record of the run, which receives the checks.
        tables: name of a `Sweep` of the study `rates` -> its table, with a line for each thickness.
    """
    for name, value in SPECTRAL.items():
        norm, tolerance = tables["norton"][f"early_{name}"][-1], 5e-4 if record.options.get("quick") else 1e-4
        record.check(f"{name} at t = {EARLY:g}, from a spectral solution", abs(norm / value - 1), high=tolerance)


def normal_jumps(full: Solution, limit: Solution) -> dict[str, float]:
    """Measure the normal jump on S in both models, relative to the interface model's jump, in L2 norms.

    The normal jump is first projected to functions linear on each facet, the space of the interface law's Lagrange
    multiplier.

    Args:
        full: solution with the meshed layer.
        limit: solution with the interface law.

    Returns:
        "normal_jump_full" and "normal_jump_interface" -> relative norm.
    """
    surface = Surface(end_state(limit).model)
    jump_norm, norms = surface.norm(surface.jump(end_state(limit))), {}
    for name, solution in {"full": full, "interface": limit}.items():
        projected = surface.at_points(surface.nodal(surface.jump(end_state(solution))))
        norms[f"normal_jump_{name}"] = surface.norm(surface.frame(projected)[1]) / jump_norm
    return norms


def check_normal_jump(record: Record, tables: Tables) -> None:
    """Check the normal jump of incompressible layers: zero with the interface law, O(eps) in the meshed layer.

    Args:
        record: record of the run, which receives the checks.
        tables: name of a `Sweep` of the study `rates` -> its table, with a line for each thickness.
    """
    table = tables["incompressible"]
    record.check("largest [u_N]/[u] of the interface law, projected", table["normal_jump_interface"].max(), high=1e-10)
    if len(table) > 1:
        order = last_order(table, "normal_jump_full")
        record.check("last observed order of the meshed layer's [u_N]", order, low=0.93, high=1.07)


def check_smaller_fraction(record: Record, tables: Tables) -> None:
    """Check that the interface law errs more, for pulled frictional layers, if the elastic fraction h is smaller.

    With cohesion c and friction angle Omega, only the elastic fraction h resists shear where the tension exceeds c
    cot(Omega). There the layer contracts along S as it is pulled along n. The interface law assumes that strains along
    S are small against strains along n. This holds only if eps is small against sqrt(h) times the length of S (an
    estimate).

    Args:
        record: record of the run, which receives the checks.
        tables: name of a `Sweep` of the study `rates` -> its table, with a line for each thickness.
    """
    for name in ERROR_COLUMNS:
        less, more = (tables[f"monodirectional {case}"][f"error_{name}"][-1] for case in ("pulled_less", "pulled"))
        what = f"pulled, h = {LESS:g} against h = {FRACTION:g}: last error of the {name}, ratio"
        record.check(what, less / more, low=2.5)


def check_ratios(record: Record, tables: Tables) -> None:
    """Compare three laws with meshed layers for nine ratios of conductivities, and check that order 1 is uniform.

    Args:
        record: record of the run. It writes table_conduction_ratios.csv: "eps", "ratio" of the conductivities of layer
            and blocks, and for each law the relative error of the compliance, the integral of flux times temperature
            on top.
        tables: tables of other sweeps, which are not used.
    """
    joint, setup = problems.conducting(1 / 8 if record.options.get("quick") else 1 / 16)
    structure, rows = Structure(joint, **setup), Table()
    bonded = solve(structure.bonded()).load_work()
    for eps in halves(3, 3):
        full, *limits = (
            model(ThinLayer(Conduction(1.0), eps, order=order))
            for model, order in ((structure.full, 1), (structure.interface, 0), (structure.interface, 1))
        )
        for ratio in np.logspace(-4, 4, 9):
            layers = (ThinLayer(Conduction(ratio), eps, order=order) for order in (1, 0, 1))
            exact, *values = (
                solve(model.with_layer(layer)).load_work() for model, layer in zip((full, *limits), layers, strict=True)
            )
            errors = dict(zip(RATIO_LAWS, (abs(value / exact - 1) for value in (bonded, *values)), strict=True))
            rows.append({"eps": eps, "ratio": float(ratio), **errors})
    record.write("table_conduction_ratios.csv", rows)
    largest = {law: [float(part[law].max()) for part in rows.split("eps").values()] for law in RATIO_LAWS}
    sup = Table.of({"eps": sorted({*rows["eps"]}, reverse=True), **largest})
    record.check("order of the largest error over nine ratios", last_order(sup, "order 1"), low=1.7, high=2.3)
    for law in RATIO_LAWS[:2]:
        record.check(f"largest error over nine ratios, {law}", largest[law][-1], low=0.04)


# ---------------------------------------------------------------- problems
def fig2_bar(sizes: tuple[float, float, float]) -> Problem:
    """The bar of Fig. 2 of the paper, on a rigid base, pressed by 0.0164 MPa, sheared by 0.164 MPa.

    Args:
        sizes: sizes of cells inside the bar, at S and at the ends of S, mm.

    Returns:
        The joint, and the arguments of its `Structure`.
    """
    return fig3.bar_joint(sizes), fig3.LOAD_READINGS["R1"].setup


METAL = VonMises(FOURIER_BODY.lmbda, FOURIER_BODY.mu, strength=3.0, hardening=20.0)  # of bodies that yield
metal_blocks = partial(sheared, body=METAL)


PUSH_PATH: LoadPath = {0: (0.0, 0.0, 0.0), 1: (0.3, 0.35, 0.0), 2: (0.3, 1.0, 1.5), 3: (0.3, 0.0, -0.9)}
SHEAR_TIMES = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5)
PATH_TIMES = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
pushed, pulled = partial(pressed, path=PUSH_PATH), partial(pressed, path=RETURN_PATH)


# ---------------------------------------------------------------- layers
KELVIN_VOIGT = KelvinVoigt(*MODULI, theta_lmbda=0.3, theta_mu=0.5)
MAXWELL = Maxwell(*MODULI, t1=0.7, t2=1.0)  # the mean stress relaxes with the time 1.04
NORTON = Norton(*MODULI, eta=5.0, p=1.5)  # at rest the tangent is infinite for p < 2, and zero for p > 2
SLIPPING = MohrCoulombMonodirectional(*MODULI, cohesion=0.05, friction_angle=25.0)
OPENING_LAW = replace(SLIPPING, elastic_fraction=FRACTION, unilateral=True)
COULOMB = MohrCoulombMonodirectional(*MODULI, cohesion=0.05, friction_angle=30.0, elastic_fraction=0.02)  # slips on S
BAR_LAW = replace(COULOMB, lmbda=fig3.GLUE.lmbda, mu=fig3.GLUE.mu, cohesion=0.0, elastic_fraction=0.01)
HARD_LAWS = {"hard_layer": LinearElastic(lmbda=600.0, mu=400.0), "hard_layer softer": LinearElastic(lmbda=6.0, mu=4.0)}
SUBLAYERS = Stack((0.3, LinearElastic(400.0, 20.0)), (0.3, LinearElastic(20.0, 60.0)), (0.4, LinearElastic(60.0, 5.0)))


RATIO_LAWS = ("bond", "order 0", "order 1")


def foil(eps: float, order: int = 1) -> ThinLayer:
    """Return a layer whose conductivity is the larger, the thinner it is, so that it conducts along S in the limit."""
    return ThinLayer(Conduction(1 / eps), eps, order=order)


# ---------------------------------------------------------------- the table
# fmt: off
EPS_MM = (0.8, 0.4, 0.2, 0.1)
FIFTHS, TENTHS, TWENTIETHS = (0.2, 0.4, 0.6, 0.8, 1.0), (0.1, 0.2, 0.3, 0.4, 0.5), (0.05, 0.1, 0.15, 0.2, 0.25)
# the mirrored stack is a wrong law
STACK_VARIANTS = {"_order0": layer_fn(SUBLAYERS), "_mirrored": layer_fn(Stack(*SUBLAYERS.sublayers[::-1]), order=1)}

static_sweep = partial(Sweep, problem=fourier, orders=(0.95, 1.05), drawn=1)
order_1_sweep = partial(Sweep, h=(1 / 32, 1 / 16), eps=halves(3, 5), orders=(1.9, 2.1), drawn=None)
heat_sweep = partial(Sweep, problem=problems.conducting, h=(1 / 16, 1 / 8), eps=halves(3, 6), drawn=None)
hard_sweep = partial(order_1_sweep, eps=halves(4, 5), orders=None, extras_fn=reaction_error)
rubber_sweep = partial(order_1_sweep, eps=halves(3), orders=(1.9, 2.3), cells_through=2, extras_fn=reaction_error)
glued_sweep = partial(Sweep, problem=problems.glued_hub, h=(1.0, 2.0), eps=EPS_MM, bodies="extended", unit="mm")
norton_sweep = partial(Sweep, h=(1 / 16, 1 / 8), times=(0.01, 0.02, 0.03, 0.04, *TWENTIETHS), extras_fn=early_norms)
fine_sweep = partial(Sweep, h=(1 / 16, 1 / 8), eps=halves(4), orders=(0.9, 1.1), quick_steps=slice(1, None, 2))
slip_sweep = partial(fine_sweep, problem=pushed, times=PATH_TIMES, cells_through=2)
yield_sweep = partial(fine_sweep, problem=sheared, orders=(0.9, 1.3), times=SHEAR_TIMES)
rub_sweep = partial(fine_sweep, layer_fn(bands.BAND_LAW), h=(1 / 128, 1 / 64), cells_through=1,
    extras_fn=bands.zone_lengths, along_fn=bands.tractions_along)
bar_sweep = partial(Sweep, problem=fig2_bar, h=((6.0, 3.0, 0.2), (8.0, 4.0, 0.4)), eps=(2.0, 1.0, 0.5, 0.25),
    orders=(0.9, 1.3), unit="mm", where=lambda x: abs(x[0] - fig3.SIDE / 2) < 0.45 * fig3.SIDE)  # 5 mm off the ends of S
# with bilinear quadrilaterals contact laws act at the nodes of S, meshed frictional layers at their quadrature points
at_once, to_and_fro = (partial(pressed, path=path, element="Q1") for path in (bands.DIRECT_PATH, RETURN_PATH))


def phase_sweep(case: str, label: str) -> Sweep:
    """Return a `Sweep` of the study for a layer of the law `NonMonotone`, whose material changes phase under the loads.

    Args:
        case: key of `phases.CASES`, which has the law and the amplitudes of shear and pull.
        label: text that distinguishes the sweep from other sweeps of its law.
    """
    law, shear, pull = phases.CASES[case]
    problem = partial(phases.blocks, shear=shear, pull=pull)
    return fine_sweep(layer_fn(law), label, problem, cells_through=2, drawn=None,
        along_fn=phases.phases_along)


def wrong_law_sweep(case: str, label: str, law: TractionLaw, floors: ErrorFloors) -> Sweep:
    """Return a `Sweep` that compares a meshed layer with phases to a wrong interface law, to show its error.

    Args:
        case: key of `phases.CASES`, which has the law of the meshed layer and the amplitudes of the loads.
        label: text that names the sweep in pictures.
        law: the wrong law.
        floors: "traction" or "jump" -> smallest and largest relative error that is expected of it.
    """
    return replace(phase_sweep(case, label), wrong_law=law, floors=floors, orders=None, along_fn=None)


SWEEPS: dict[str, Sweep] = {
    "elastic": static_sweep(layer_fn(FOURIER_LAYER)),
    "extended": static_sweep(layer_fn(FOURIER_LAYER), bodies="extended"),
    "tapered": static_sweep(layer_fn(FOURIER_LAYER, profile=lambda x: 0.5 + x[0]), bodies="extended", orders=(0.9, 1.1)),
    "order1": order_1_sweep(layer_fn(FOURIER_LAYER, order=1), layer_variants={"_order0": layer_fn(FOURIER_LAYER)},
        extras_fn=reaction_error),
    "order1_stack": order_1_sweep(layer_fn(SUBLAYERS, order=1), layer_variants=STACK_VARIANTS),
    "hard_layer": hard_sweep(layer_fn(HARD_LAWS["hard_layer"], None, order=1), "harder than the bodies"),
    "hard_layer softer": hard_sweep(layer_fn(HARD_LAWS["hard_layer softer"], None, order=1), "softer than the bodies"),
    "rubber": rubber_sweep(layer_fn(Rubber.shear(40.0, 0.3), order=1), "nu = 0.3"),
    "rubber harder": rubber_sweep(layer_fn(Rubber.shear(40.0, 0.45), order=1), "nu = 0.45"),
    "rubber almost": rubber_sweep(layer_fn(Rubber.shear(40.0, 0.499), order=1), "nu = 0.499"),
    "rubber incompressible": rubber_sweep(layer_fn(Incompressible(40.0), order=1), "nu = 0.5"),
    "ring": glued_sweep(layer_fn(problems.GLUE, problems.GLUE_EPS), "order 0", orders=(0.9, 1.1)),
    "ring order1": glued_sweep(layer_fn(problems.GLUE, problems.GLUE_EPS, order=1), "order 1", orders=(1.8, 2.2),
        drawn=None),
    "fibre": glued_sweep(layer_fn(problems.COATING), problem=problems.coated_fibre, h=(0.05, 0.1),
        eps=(0.08, 0.04, 0.02, 0.01), orders=(0.9, 1.1), unit="R"),
    "tubes": glued_sweep(layer_fn(problems.TUBE_GLUE, problems.TUBE_GLUE_EPS), "inner pressure", orders=(0.93, 1.1),
        problem=partial(problems.tubes, loads=problems.PRESSURE_LOADS), drawn=None),
    "tubes push": glued_sweep(layer_fn(problems.TUBE_GLUE, problems.TUBE_GLUE_EPS), "shaft pushed", orders=(0.9, 1.25),
        problem=partial(problems.tubes, loads=problems.PUSH_LOADS),
        where=lambda x: abs(x[1] + problems.TUBE_LENGTH / 2) < 0.3 * problems.TUBE_LENGTH),  # off their ends
    "own_mesh": Sweep(layer_fn(problems.JOINT, problems.JOINT_EPS), problem=problems.arch, orders=(0.9, 1.1), unit="m",
        h=("P2", "P1"), eps=(0.04, 0.02, 0.01, 0.005), bodies="extended", where=problems.is_inside_joints, drawn=1),
    "butt_joint": Sweep(layer_fn(problems.GLUE, problems.GLUE_EPS), problem=problems.rods, h=((4.0, 2.5), (6.0, 4.0)),
        eps=EPS_MM, unit="mm", orders=(0.9, None), where=lambda x: np.hypot(x[0], x[2]) < 0.75 * problems.ROD_RADIUS),
    "kelvin_voigt": Sweep(layer_fn(KELVIN_VOIGT), times=TENTHS),
    "maxwell": Sweep(layer_fn(MAXWELL), "t2 = 1.0", times=FIFTHS),
    "maxwell t1": Sweep(layer_fn(Maxwell(*MODULI, t1=0.7)), "t2 = t1", times=FIFTHS),
    "norton": norton_sweep(layer_fn(NORTON), "p = 1.5"),
    "norton p3": norton_sweep(layer_fn(replace(NORTON, eta=2000.0, p=3.0)), "p = 3", check=check_spectral),
    "stack": Sweep(layer_fn(Stack((0.5, MAXWELL), (0.5, KELVIN_VOIGT))), "Maxwell, Kelvin-Voigt", eps=halves(4),
        times=FIFTHS),
    "stack norton": Sweep(layer_fn(Stack((0.5, FOURIER_LAYER), (0.5, NORTON))), "elastic, Norton", eps=halves(4),
        times=TWENTIETHS),
    # for eps > 1/32 the next term still affects the orders
    "incompressible": Sweep(layer_fn(Incompressible(40.0)), eps=halves(5), extras_fn=normal_jumps, check=check_normal_jump),
    "monodirectional": slip_sweep(layer_fn(SLIPPING), "bilateral"),
    "monodirectional unilateral": slip_sweep(layer_fn(OPENING_LAW), "unilateral, h = 0.01", problem=pulled),
    "monodirectional stack": slip_sweep(layer_fn(Stack((0.4, LinearElastic(90.0, 30.0)), (0.6, SLIPPING))),
        "elastic, bilateral"),
    "monodirectional pulled": slip_sweep(layer_fn(replace(SLIPPING, elastic_fraction=FRACTION)), "pulled, h = 0.01",
        problem=pulled),
    "monodirectional pulled_less": slip_sweep(layer_fn(replace(SLIPPING, elastic_fraction=LESS)), "pulled, h = 1e-4",
        problem=pulled, orders=None, check=check_smaller_fraction),
    "mohr_coulomb": yield_sweep(layer_fn(MORTAR_LAW), "psi = 0"),
    "mohr_coulomb dilatant": yield_sweep(layer_fn(replace(MORTAR_LAW, dilatancy_angle=10.0)), "psi = 10°"),
    "mohr_coulomb coulomb": yield_sweep(layer_fn(MORTAR_LAW), "tan(Omega) on S", orders=None, wrong_law=COULOMB,
        floors=FLOOR),
    "mohr_coulomb metal": yield_sweep(layer_fn(MORTAR_LAW), "bodies yield", problem=metal_blocks, times=SHEAR_TIMES[:4],
        quick_steps=slice(None)),
    "friction": rub_sweep("at once", at_once, wrong_law=bands.HOLONOMIC),
    "friction history": rub_sweep("to and fro", to_and_fro, times=PATH_TIMES, wrong_law=bands.INCREMENTAL,
        check=bands.check_zones),
    "friction cells": fine_sweep(layer_fn(bands.REGULARIZED_LAW), "4 cells, h = 1e-5", at_once, h=(1 / 64, 1 / 64),
        orders=(0.7, 1.3), wrong_law=bands.HOLONOMIC, slow=True),
    "friction sine": fine_sweep(layer_fn(bands.BAND_LAW), "f = sin(Omega)", at_once, h=(1 / 64, 1 / 32), orders=None,
        cells_through=1, wrong_law=bands.SINE_LAW, check=bands.check_sine_error),
    "non_monotone": phase_sweep("", "expands obliquely"),
    "non_monotone across": phase_sweep("across", "expands across S"),
    "non_monotone along": phase_sweep("along", "shears along S"),
    "non_monotone unrelaxed": fine_sweep(layer_fn(phases.PURE_LAW), "expands obliquely, pure phases", h=(1 / 8, 1 / 8),
        cells_through=2, problem=partial(phases.blocks, shear=0.04, pull=0.03, moved=True), times=(0.25, 0.5, 0.75, 1.0),
        quick_steps=slice(None), along_fn=phases.phases_along),
    "non_monotone printed": wrong_law_sweep("", "lambda + mu on S", phases.PRINTED_LAW, PRINTED_FLOOR),
    "non_monotone one_branch": wrong_law_sweep("", "no phase -1 on S", phases.ONE_BRANCH_LAW, ONE_BRANCH_FLOOR),
    "non_monotone across small_gain": wrong_law_sweep("across", "across S, G across", phases.SMALL_GAIN_LAW, GAIN_FLOOR),
    "conduction": heat_sweep(layer_fn(Conduction(1.0), order=1), "k ~ eps", orders=(3.9, 4.1), check=check_ratios,
        layer_variants={"_order0": layer_fn(Conduction(1.0))}),
    "conduction fixed": heat_sweep(layer_fn(Conduction(3.0), None, order=1), "k = 3", orders=(2.8, 3.1),
        layer_variants={"_order0": layer_fn(Conduction(3.0), None)}),
    "conduction foil": heat_sweep(foil, "k ~ 1/eps", orders=(1.9, 2.1), layer_variants={"_order0": partial(foil, order=0)}),
    "bar": bar_sweep(layer_fn(fig3.glue_law(0.02)), "h = 0.02"),
    "bar less_elastic": bar_sweep(layer_fn(fig3.glue_law(0.01)), "h = 0.01", slow=True),
    "bar monodirectional": bar_sweep(layer_fn(BAR_LAW), "monodirectional, h = 0.01", slow=True),
}
LAWS = tuple(dict.fromkeys(name.split()[0] for name in SWEEPS))
BY_ORDER = {f"{name}, order {k}": f"{key}{'' if k else '_order0'}" for k in (0, 1) for name, key in ERROR_COLUMNS.items()}
DRAWN_ERRORS = {  # law -> label and column of each error, reference order
    "order1": (BY_ORDER, 2.0),
    "order1_stack": (BY_ORDER | {"jump, mirrored": "error_jump_mirrored"}, 2.0),
    "hard_layer": ({"traction": "error_reaction"}, 3.0),
    "rubber": ({"jump": "error_jump"}, 2.0),
    "conduction": ({"flux, order 1": "error_flux", "flux, order 0": "error_flux_order0"}, 2.0),
    "incompressible": (ERROR_COLUMNS | {"[u_N]/[u] of the meshed layer": "normal_jump_full"}, 1.0),
}
SEPARATE_LAWS = ("monodirectional", "friction", "non_monotone")  # laws with separate pictures of tractions and jumps


def run(
    record: Record, *, law: Literal[
        "all", "elastic", "extended", "tapered", "order1", "order1_stack", "hard_layer", "rubber", "ring", "fibre", "tubes",
        "own_mesh", "butt_joint", "kelvin_voigt", "maxwell", "norton", "stack", "incompressible", "monodirectional",
        "mohr_coulomb", "friction", "non_monotone", "conduction", "bar",
    ] = "all", eps: Sequence[float] = (), quick: bool = False,
) -> None:
    """Compare meshed layers with their interface laws for decreasing thickness, and check the rates of convergence.

    Args:
        record: record of the run. It writes table_LAW.csv for the first layer with a law, table_LAW_OTHER.csv for other
            ones.
        law: law whose layers are compared, or all.
        eps: thicknesses, in place of those chosen for each layer.
        quick: coarser meshes, fewer steps and pictures, without the longest rows.
    """
    tables: Tables = {}
    for name, sweep in SWEEPS.items():
        its_law = name.split()[0]
        if law not in ("all", its_law) or (quick and sweep.slow):
            continue
        tables[name] = sweep.compare_all(record, name, eps or sweep.eps, quick=quick, pictured=name == its_law or not quick)
        check_floors(record, name, tables[name], tables[name.rpartition(" ")[0] or name], sweep.floors)
        if sweep.check:
            sweep.check(record, tables)
# fmt: on


def draw(record: Record) -> None:
    """Draw the errors of the interface laws over the thickness.

    They are read from the folder of `record`; laws without a table there are left out.
    """
    for law in LAWS:
        names = {s.label: name for name, s in SWEEPS.items() if name.split()[0] == law and record.has(table_file(name))}
        if not names:
            continue
        unit, (errors, order) = SWEEPS[law].unit, DRAWN_ERRORS.get(law, (ERROR_COLUMNS, 1.0))
        title = f"law on S against meshed layer: {law.replace('_', ' ')}{f', eps in {unit}' if unit else ''}"
        tables = {label: record.path(table_file(name)) for label, name in [*names.items()][: len(COLOURS)]}
        pictures = {f"rates_{law}.svg": (title, errors)}
        if law in SEPARATE_LAWS:
            files = {"traction": f"rates_{law}.svg", "jump": f"rates_{law}_jump.svg"}
            pictures = {files[error]: (f"{title}: {error}", {error: column}) for error, column in errors.items()}
        for file, (text, columns) in pictures.items():
            plotting.rates(tables, save=record.path(file), title=text, errors=columns, reference=order)
        if law == "conduction":
            by_eps = record.load("table_conduction_ratios.csv").split("eps").items()
            panels = {
                f"eps = 1/{1 / eps:.0f}": {name: (t["ratio"], t[name]) for name in RATIO_LAWS} for eps, t in by_eps
            }
            look = {"log": "xy", "styles": "o-", "save": record.path("rates_conduction_ratios.svg")}
            plotting.curves(panels, "k of the layer over k of the blocks", "relative error of the compliance", **look)
        if along := {label: name for label, name in names.items() if SWEEPS[name].along_fn}:
            draw_along(record, along, f"along_{law}")
