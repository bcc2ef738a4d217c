"""Figures 2 and 3: a steel bar on a Mohr-Coulomb layer; where it yields, and tangential traction over displacement.

The paper gives the loads as "(0.164, -0.0164) N/mm" and not the sides they act on. There are two readings; t_T/u_T is
the tangential traction over the tangential jump:

R1: 0.164 MPa along S on the left side, 0.0164 MPa onto S on the upper side, right side on rollers, as in Fig. 7. The
    shear is ten times the pressure: without cohesion the layer yields all along S, and t_T/u_T is small everywhere.
R4m: 0.164 MPa onto S on the upper side, 0.0164 MPa to the left on the right side, no support. The layer is pressed ten
    times more than sheared: it stays elastic, with t_T/u_T = mu, except near the left end. Fig. 3 shows this
    ("beginning of the plastification in the left part", the ratio "equal to the coefficient" mu on the right).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Unpack

import numpy as np

from forms import LinearElastic, MohrCoulomb
from geometry import block
from geometry.joint import Joint
from studies.problems import STEEL, StructureArguments
from thinlayer import Structure, Surface, Table, ThinLayer, march, plotting, solve
from thinlayer.discretisation.coefficient import LoadInput
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.running.record import Record
from thinlayer.system.progress import track

SIDE = 100.0  # mm
EPS = 1.0  # mm
GLUE = LinearElastic.young(E=30e3, nu=0.3)  # MPa
FRICTION_ANGLE = 30.0
ELASTIC_FRACTION = 0.02  # elastic fraction of both models where the meshed layer is compared
R_X, U_T_50 = 0.7760, 2.9706e-5  # N/mm and mm: loads R1 in one step, by an independent code
R_X_REFINED = 0.792  # N/mm: by the same code with the pressure first, then the shear in many steps
STEP_COUNTS = (1, 5, 20, 80)
R1_LABEL = "0.164 MPa along S, 0.0164 MPa onto it:\nyields all along S"
R4M_LABEL = "0.0164 MPa along S, 0.164 MPa onto it: yields at the left\n(free ends of the meshed layer: off the axes)"


@dataclass(frozen=True)
class Loads:
    """One of the two readings of the paper's loads, and how its results are drawn.

    Attributes:
        pressure: side of the bar that is pressed, and the traction there (MPa).
        shear: side of the bar at which the load along S acts, and the traction there (MPa).
        supports: side of the bar -> component -> prescribed displacement, mm.
        yield_text: where the layer should yield, as text in the picture.
        picture_scale: factor of the displacements in the picture of the layer's left end.
        stiffness_axis_limits: smallest and largest t_T/u_T on the axis of the picture, 10^3 N/mm^3. Ratios at the free
            ends of the meshed layer lie outside.
    """

    pressure: tuple[str, tuple[float, float]]
    shear: tuple[str, tuple[float, float]]
    supports: dict[str, dict[str, float]]
    yield_text: str
    picture_scale: float
    stiffness_axis_limits: tuple[float, float]

    @property
    def setup(self) -> StructureArguments:
        """Arguments of the bar's `Structure` under these loads: body, supports, tractions and finite element."""
        tractions = dict([self.pressure, self.shear])
        return {"body": STEEL, "supports": self.supports, "tractions": tractions, "element": "S2"}


LOAD_READINGS = {
    "R1": Loads(("TOP", (0.0, -0.0164)), ("LEFT", (0.164, 0.0)), {"RIGHT": {"x": 0.0}}, R1_LABEL, 1e4, (0.0, 12.5)),
    "R4m": Loads(("TOP", (0.0, -0.164)), ("RIGHT", (-0.0164, 0.0)), {}, R4M_LABEL, 3e4, (10.4, 12.0)),
}


def run(record: Record, *, loads: Literal["both", "R1", "R4m"] = "both", quick: bool = False) -> None:
    """Solve the bar of Fig. 2 with the interface law and with the layer meshed.

    The loads are applied in one step, for reading R1 also in many steps. Without cohesion the free end of a meshed
    layer has no strength: an elastic fraction h makes the problem well posed. The interface law is well posed without
    an elastic fraction; it is solved for both values, h = 0 and that of the meshed layer.

    Args:
        record: record of the run, with its folder, tables and checks.
        loads: reading of the paper's loads, "R1", "R4m" or "both".
        quick: coarser meshes.
    """
    fine, coarse, coarsest = (4.0, 2.0, 0.05), (6.0, 3.0, 0.1), (8.0, 4.0, 0.4)
    readings = LOAD_READINGS if loads == "both" else {loads: LOAD_READINGS[loads]}
    table = record.new_table("table.csv")
    for name, reading in readings.items():
        bar = YieldingBar(record, name, reading, coarse if quick else fine)
        states = {f"interface law, h = {h:g}": bar.solved(Structure.interface, h) for h in (0.0, ELASTIC_FRACTION)}
        states[f"meshed layer, h = {ELASTIC_FRACTION:g}"] = bar.solved(Structure.full, ELASTIC_FRACTION)
        for label, state in states.items():
            table.extend({"loads": name, "model": label} | row for row in bar.profile_table(state))
        bar.check(states)
        title, picture = f"left end of a Mohr-Coulomb layer, {reading.yield_text}", record.path(f"layer_end_{name}.png")
        view = plotting.View(scale=reading.picture_scale, unit="mm", zoom=(-2.0, 6.0, -1.6, 4.0))
        plotting.deformed(dict([*states.items()][1:]), view, save=picture, title=title)
    if "R1" in readings:
        bar = YieldingBar(record, "R1", LOAD_READINGS["R1"], coarsest if quick else coarse)
        check_step_refinement(record, bar, STEP_COUNTS[: 3 if quick else None])


def glue_law(h: float) -> MohrCoulomb:
    """Return the Mohr-Coulomb law of the glue of Fig. 2; `h` is its elastic fraction."""
    return MohrCoulomb(GLUE.lmbda, GLUE.mu, cohesion=0.0, friction_angle=FRICTION_ANGLE, elastic_fraction=h)


def bar_joint(sizes: tuple[float, float, float]) -> Joint:
    """Return the joint of the bar of Fig. 2, a square on a rigid base.

    `sizes` are the sizes of cells inside the bar, at S and at the ends of S, mm.
    """
    return block(SIDE, SIDE, sizes[0], h_S=sizes[1], h_ends=sizes[2], cell="quadrilateral")


class YieldingBar:
    """The bar of Fig. 2 under one of two readings of the paper's loads.

    Args:
        record: record of the run, which receives reports and checks.
        name: name of the reading, "R1" or "R4m".
        loads: loads and supports by this reading.
        sizes: sizes of cells inside the bar, at S and at the ends of S, mm.
    """

    def __init__(self, record: Record, name: str, loads: Loads, sizes: tuple[float, float, float]) -> None:
        self.record, self.name, self.loads = record, name, loads
        self.joint = bar_joint(sizes)
        self.surface = Surface(self.model(Structure.interface, 0.0))

    def model(self, make_model: Callable[..., Model], h: float, **changed: Unpack[StructureArguments]) -> Model:
        """Make the interface or the full model of the bar.

        Args:
            make_model: `Structure.interface` or `Structure.full`.
            h: elastic fraction of the layer.
            changed: arguments of `Structure` that replace those of `Loads.setup`.
        """
        return make_model(Structure(self.joint, **self.loads.setup | changed), ThinLayer(glue_law(h), EPS))

    def solved(self, make_model: Callable[..., Model], h: float) -> State:
        """Solve the interface or the full model under all loads in one step.

        `make_model` is `Structure.interface` or `Structure.full`, `h` the elastic fraction of the layer.
        """
        return self.record.add_report(solve(self.model(make_model, h)))

    def step_shear(self, steps: int) -> State:
        """Solve the interface model for a constant pressure and a shear that grows in equal steps.

        `steps` is the number of steps. The law has no elastic fraction. The state at the end is returned.
        """
        side, (x_part, y_part) = self.loads.shear
        tractions: dict[str, LoadInput] = {**dict([self.loads.pressure]), side: lambda x, t: (t * x_part, t * y_part)}
        times = [float(t) for t in np.linspace(0, 1, steps + 1)[1:]]
        return march(self.model(Structure.interface, 0.0, tractions=tractions), times, keep="last").last

    def profile_table(self, state: State) -> Table:
        """Return a table of jump, traction and their tangential ratio at the nodes along S in `state`.

        Its columns are "h" (the elastic fraction), "x_mm", "u_T_mm", "u_N_mm", "t_T_MPa", "t_N_MPa" and "ratio",
        t_T/u_T in N/mm^3. Where |u_T| is below a tenth of its largest value, "ratio" is empty.
        """
        (law,), surface = (layer.law for layer in state.model.layers.values()), self.surface
        x, u = surface.profile(surface.frame(surface.jump(state)))
        t = surface.profile(surface.frame(surface.traction(state)))[1]
        is_moving = np.abs(u[:, 0]) > 0.1 * np.abs(u[:, 0]).max()
        ratio = [float(t[k, 0] / u[k, 0]) if is_moving[k] else None for k in range(len(x))]
        columns = {"h": law.parameters()["elastic_fraction"], "x_mm": x[:, 0], "u_T_mm": u[:, 0], "u_N_mm": u[:, 1]}
        return Table.of(columns | {"t_T_MPa": t[:, 0], "t_N_MPa": t[:, 1], "ratio": ratio})

    def shear_force(self, state: State) -> float:
        """Return the integral over S of the tangential traction in `state`, N/mm."""
        return self.surface.integral(self.surface.frame(self.surface.traction(state))[0])

    def check(self, states: dict[str, State]) -> None:
        """Check results of the interface law: for R1 against those of an independent code, for R4m against Fig. 3.

        In Fig. 3 the layer stays elastic away from its left end, so that t_T/u_T is its shear modulus over its
        thickness there.

        Args:
            states: label of a model -> its state; the first one is of the interface law without elastic fraction.
        """
        record, mu, state = self.record, GLUE.mu / EPS, next(iter(states.values()))
        record.results[f"{self.name}: shear force on S, N/mm"] = {k: self.shear_force(s) for k, s in states.items()}
        record.check(f"{self.name}: Newton steps of the interface law, one load step", state.report.iterations, high=7)
        profile = self.profile_table(state)
        x, u, ratio = (profile[name] for name in ("x_mm", "u_T_mm", "ratio"))
        if self.name == "R1":
            error = self.shear_force(state) / R_X - 1
            record.check("R1: relative error of the shear force on S, one load step", abs(error), high=2e-4)
            error = float(np.interp(SIDE / 2, x, u)) / U_T_50 - 1
            record.check("R1: relative error of u_T at 50 mm, one load step", abs(error), high=1e-4)
            record.check("R1: largest t_T/u_T over mu", np.nanmax(ratio) / mu, high=0.5)
            return
        elastic_error = np.nanmax(np.abs(ratio / mu - 1)[(x > 20) & (x < 90)])
        record.check("R4m: |t_T/u_T / mu - 1| between 20 and 90 mm", elastic_error, high=1e-6)
        record.check_near("R4m: t_T/u_T at 50 mm, N/mm^3", float(np.interp(SIDE / 2, x, ratio)), mu, 1e-6)
        record.check("R4m: smallest t_T/u_T over mu", np.nanmin(ratio) / mu, high=0.99)


def check_step_refinement(record: Record, bar: YieldingBar, counts: Sequence[int]) -> None:
    """Compute the shear force on S for a constant pressure and a shear that grows in more and more steps.

    The numbers of steps and the forces are written to steps.csv, and the last force is checked. The force depends on
    the path of loads more than on the mesh.

    Args:
        record: record of the run, which receives table and check.
        bar: the bar under the reading R1 of the loads.
        counts: increasing numbers of steps.
    """
    forces = {steps: bar.shear_force(bar.step_shear(steps)) for steps in track(counts, "fig3_mohr_coulomb", "{} steps")}
    last_force = forces[counts[-1]]
    errors = [{"size": 1 / steps, "error": abs(forces[steps] - last_force)} for steps in counts[:-1]]
    orders = [*Table(errors).orders("error", of="size"), None]
    record.write("steps.csv", Table.of({"steps": counts, "shear_force": [*forces.values()], "order": orders}))
    record.check("R1: shear force on S in many steps", last_force, low=R_X_REFINED - 1e-3, high=R_X_REFINED + 1e-3)


def draw(record: Record) -> None:
    """Draw tangential traction over tangential jump along S for both readings of the loads.

    The values are read from table.csv in the folder of `record`.
    """
    panels, ranges = {}, {}
    for name, loads_table in record.load("table.csv").split("loads").items():
        title = f"{name}: {LOAD_READINGS[name].yield_text}"
        lines = {model: (part["x_mm"], part["ratio"] / 1e3) for model, part in loads_table.split("model").items()}
        lines[f"elastic, mu/eps = {GLUE.mu / EPS / 1e3:.2f}"] = (np.array([0.0, SIDE]), np.full(2, GLUE.mu / EPS / 1e3))
        panels[title], ranges[title] = lines, LOAD_READINGS[name].stiffness_axis_limits
    title = "Mohr-Coulomb layer, eps = 1 mm, C = 0, Omega = 30°, elastic fraction h: two readings of the loads"
    options = {"title": title, "ylim": ranges, "save": record.path("ratio.svg")}
    plotting.curves(panels, "x (mm); gaps: |u_T| below a tenth of its largest", "t_T / u_T (10^3 N/mm³)", **options)
