"""Vibrations of bonded plates: damping layers and laminated glass against closed forms, and a cantilever."""

from __future__ import annotations

import math

import numpy as np

from forms import LinearElastic
from geometry import sandwich
from thinlayer import Inertia, Probe, Structure, Table, ThinLayer, harmonic, modes, plotting
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.discretisation.supports import Support
from thinlayer.running.record import Record
from thinlayer.solving.harmonic import HarmonicResponse

STEEL = (210e3, 0.3, 7.8e-9)  # MPa, Poisson's ratio, t/mm^3
GLASS = (70e3, 0.23, 2.5e-9)
CORE_NU, CORE_DENSITY, CORE_LOSS = 0.49, 1.1e-9, 0.6
PLATES, EPS, LENGTH = (1.5, 0.8), 0.2, 60.0  # mm, of the damped beam
RESPONSE_MODULI, HERTZ = (0.5, 20.0), (100.0, 8000.0)  # MPa; first and last frequency of responses
PANES, FOIL, SPAN = (6.0, 6.0), 0.76, 1000.0  # mm, of the laminated glass
CORE_MODULI = (0.3, 1.0, 3.0, 10.0, 30.0, 60.0, 100.0, 300.0, 1000.0)  # MPa, in shear


def run(record: Record, *, quick: bool = False) -> None:
    """Compute modes of bonded beams with laws on S, and compare them with closed forms and meshed layers.

    damper.csv has the loss factor of a simply supported beam of two steel plates over the shear modulus of the core,
    from modes of half the beam, and by the formula of Ross, Kerwin and Ungar. glass.csv has the lowest frequency of
    laminated glass and that of its effective thickness. cantilever.csv has the frequencies of a bonded cantilever with
    laws of order 0 and 1, relative to a meshed layer. response.csv has the deflection of the tip of a damped cantilever
    under a force there, and resonances.csv its resonances.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: five moduli of the core, not nine, and fewer frequencies.
    """
    moduli = CORE_MODULI[::2] if quick else CORE_MODULI
    damper, glass, cantilever = (record.new_table(f"{name}.csv") for name in ("damper", "glass", "cantilever"))
    for mu in moduli:
        omega, loss = modes(half_beam(STEEL, PLATES, EPS, LENGTH, mu, h=1.0), 1).loss(S=CORE_LOSS)
        square = sandwich_formula(STEEL, PLATES, EPS, LENGTH, mu * (1 + 1j * CORE_LOSS))
        damper.append({"mu": mu, "loss": loss[0], "formula": square.imag / square.real, "omega": omega[0]})
        hertz = modes(half_beam(GLASS, PANES, FOIL, SPAN, mu, h=6.0), 1).hertz[0]
        formula = math.sqrt(sandwich_formula(GLASS, PANES, FOIL, SPAN, mu).real) / (2 * math.pi)
        glass.append({"mu": mu, "hertz": hertz, "formula": formula})
    for eps in (0.8, 0.2):
        rows = {name: modes(model, 3).omega for name, model in cantilevers(eps).items()}
        cantilever.extend(
            {"eps": eps, "law": name, "mode": k, "error": omega / exact - 1}
            for name, omegas in rows.items()
            if name != "meshed"
            for k, (omega, exact) in enumerate(zip(omegas, rows["meshed"], strict=True), 1)
        )
    _check(record, damper, glass, cantilever)
    _respond(record, 40 if quick else 160)


def _respond(record: Record, n: int) -> None:
    response, resonances = record.new_table("response.csv"), record.new_table("resonances.csv")
    joint = sandwich(LENGTH, *PLATES, 2.0, cell="quadrilateral", structured=True)
    mass = Inertia({"LOWER": STEEL[2], "UPPER": STEEL[2], "S": CORE_DENSITY})
    force = {"RIGHT/LOWER": (0.0, 0.01)}
    beam = Structure(joint, body=LinearElastic.young(*STEEL[:2]), supports={"LEFT": 0}, tractions=force, parts=[mass])

    def tip(state: State) -> float:
        return float(Probe(state).displacement((LENGTH, 0.0), side="lower")[1])

    for mu in RESPONSE_MODULI:
        model = beam.interface(ThinLayer(LinearElastic.shear(mu, CORE_NU), EPS, order=1))
        omega, loss = modes(model, 3).loss(S=CORE_LOSS)
        resonances.extend({"mu": mu, "omega": w, "loss": eta} for w, eta in zip(omega, loss, strict=True))
        half_power = omega[0] * np.sqrt([1 - loss[0], 1 + loss[0]])
        omegas = sorted([*2 * np.pi * np.geomspace(*HERTZ, n), *omega, *half_power])
        values = harmonic(model, omegas, {"tip": tip}, loss={"S": CORE_LOSS}).values["tip"]
        response.extend({"mu": mu, "omega": w, "re": u.real, "im": u.imag} for w, u in zip(omegas, values, strict=True))
        ratio = abs(values[np.isin(omegas, half_power)]).mean() / abs(values[omegas.index(omega[0])])
        record.check_near(f"core of {mu:g} MPa: deflection at half power over that at resonance", ratio, 0.5**0.5, 0.01)


def _check(record: Record, damper: Table, glass: Table, cantilever: Table) -> None:
    peak = damper["formula"].argmax()
    record.check_near(
        "largest loss factor over that of the formula", damper["loss"][peak] / damper["formula"][peak], 1, 0.01
    )
    distance = max(abs(damper["mu"][damper["loss"].argmax()] / damper["mu"][peak] - 1), 0.0)
    record.check("core with the largest loss: relative distance from the formula's", distance, high=0.0)
    distance = abs(glass["hertz"] / glass["formula"] - 1).max()
    record.check("laminated glass: largest relative distance from the effective thickness", distance, high=0.01)
    at_first = {law: (rows["mode"] == 1) & (rows["eps"] == EPS) for law, rows in cantilever.split("law").items()}
    first = {law: float(cantilever.split("law")[law]["error"][at][0]) for law, at in at_first.items()}
    record.check_near("cantilever, order 0: error of the first frequency", first["order 0"], -0.0138, 0.05)
    record.check("cantilever, order 1: error of the first frequency", abs(first["order 1"]), high=5e-5)


def half_beam(
    plate: tuple[float, float, float], heights: tuple[float, float], eps: float, length: float, mu: float, h: float
) -> Model:
    """Make half of a simply supported beam of two plates, with a core of the shear modulus `mu` as a law of order 1.

    The plates are in plane strain; `h` is the length of cells.
    """
    E, nu, rho = plate
    joint = sandwich(length / 2, *heights, h, cell="quadrilateral", structured=True)
    mass = Inertia({"LOWER": rho, "UPPER": rho, "S": CORE_DENSITY})
    supports: dict[str, Support] = {"LEFT": {"y": 0.0}, "RIGHT": {"x": 0.0}}
    structure = Structure(joint, body=LinearElastic.young(E, nu), supports={**supports}, parts=[mass])
    return structure.interface(ThinLayer(LinearElastic.shear(mu, CORE_NU), eps, order=1))


def sandwich_formula(
    plate: tuple[float, float, float], heights: tuple[float, float], eps: float, length: float, mu: complex
) -> complex:
    """Return omega^2 of the first mode of a simply supported beam by Ross, Kerwin and Ungar (1959).

    Plates bend and stretch, the core shears. With a real modulus it is the frequency of the effective thickness of
    laminated glass.
    """
    E, nu, rho = plate
    k, (a, b) = math.pi / length, (E / (1 - nu**2) * height for height in heights)
    bending = (a * heights[0] ** 2 + b * heights[1] ** 2) / 12
    lever = eps + sum(heights) / 2
    shear = mu / eps * (1 / a + 1 / b)
    composite = lever**2 * a * b / (a + b) * shear / (shear + k**2)
    return k**4 * (bending + composite) / (rho * sum(heights) + CORE_DENSITY * eps)


def cantilevers(eps: float) -> dict[str, Model]:
    """Make a bonded cantilever with a soft adhesive: "meshed", and with laws of order 0 and 1."""
    joint = sandwich(60.0, 2.0, 2.0, 2 / 3, cell="quadrilateral", structured=True)
    mass = Inertia({"LOWER": STEEL[2], "UPPER": STEEL[2], "S": 1.2e-9})
    plates = Structure(joint, body=LinearElastic.young(*STEEL[:2]), supports={"LEFT": 0}, parts=[mass])
    glue = LinearElastic.young(E=5.0, nu=0.3)
    laws: dict[str, Model] = {f"order {k}": plates.interface(ThinLayer(glue, eps, order=k)) for k in (0, 1)}
    return {"meshed": plates.full(ThinLayer(glue, eps)), **laws}


def draw(record: Record) -> None:
    """Draw the loss factor over the modulus of the core, and responses with two cores."""
    table, mu = record.load("damper.csv"), np.geomspace(CORE_MODULI[0], CORE_MODULI[-1], 200)
    squares = np.array([sandwich_formula(STEEL, PLATES, EPS, LENGTH, m * (1 + 1j * CORE_LOSS)) for m in mu])
    lines = {
        "law on S, order 1": (table["mu"], table["loss"]),
        "Ross, Kerwin, Ungar": (mu, squares.imag / squares.real),
    }
    labels, title = (
        ("shear modulus of the core (MPa)", "loss factor of the first mode"),
        "steel plates with a lossy core",
    )
    plotting.curves(lines, *labels, title=title, styles=("o", "-"), log="x", save=record.path("vibrations.svg"))
    names = {mu: f"core of {float(mu):g} MPa" for mu in record.load("response.csv").split("mu")}
    tables = {name: record.load(f"{name}.csv").split("mu") for name in ("response", "resonances")}
    responses = {
        names[mu]: HarmonicResponse(rows["omega"], {"tip": rows["re"] + 1j * rows["im"]})
        for mu, rows in tables["response"].items()
    }
    resonances = {names[mu]: (rows["omega"], rows["loss"]) for mu, rows in tables["resonances"].items()}
    plotting.response(
        responses,
        "tip",
        "frequency (Hz)",
        "deflection of the tip (mm)",
        resonances=resonances,
        log="x",
        title="steel cantilever with a lossy core",
        save=record.path("vibrations_response.svg"),
    )
