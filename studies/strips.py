"""Two bonded strips of unequal thermal expansion are cooled: shear lag and bending, against closed forms.

Strips are in plane strain: their axial modulus is E/(1 - nu^2), their free expansion (1 + nu) alpha dT.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from forms import LinearElastic
from forms.base import Array
from geometry import sandwich
from studies.sweeping import Curves
from thinlayer import Structure, Surface, Table, ThermalExpansion, ThinLayer, plotting, solve
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.discretisation.supports import Place, Support
from thinlayer.output.plotting.curves import COLOURS
from thinlayer.running.record import Record

NU = 0.3
ALPHA = {"LOWER": 23e-6, "UPPER": 12e-6}  # 1/K, of aluminium below and steel above
YOUNG_MODULI = {"LOWER": 70e3, "UPPER": 210e3}  # MPa
HEIGHTS = {"LOWER": 3.0, "UPPER": 2.0}  # mm
TEMPERATURE_CHANGE = -80.0  # K
HALF_LENGTH = 200.0  # mm, half of the strips: the left end is the middle
EPS = 0.05  # mm
LAG_MODULI = (0.5, 2.0)  # MPa, shear moduli of the soft layers of the shear lag
BENDING_MODULI = (0.03, 0.1, 0.3, 1.0, 10.0, 100.0)  # MPa, shear moduli of the layers between the bending strips
COMPARED_SHARE = 0.95  # share of the half length in which shear stresses are compared


def run(record: Record, *, quick: bool = False) -> None:
    """Solve two strips that are held flat (shear lag) or free to bend, with the layer meshed and as an interface law.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: coarser meshes.
    """
    check_shear_lag(record, 5.0 if quick else 2.5)
    check_bending(record, 5.0 if quick else 2.5)


# ---------------------------------------------------------------- strips
def strip_models(h: float, mu: float, supports: Mapping[Place, Support]) -> dict[str, Model]:
    """Make models of the right halves of two cooled strips with a layer between them.

    Args:
        h: cell size, mm.
        mu: shear modulus of the layer, MPa.
        supports: supports in addition to the symmetry at the left end.

    Returns:
        "meshed layer" and "interface law" -> model.
    """
    joint = sandwich(HALF_LENGTH, HEIGHTS["LOWER"], HEIGHTS["UPPER"], h, cell="quadrilateral", structured=True)
    eigenstrains = {name: ThermalExpansion(alpha, TEMPERATURE_CHANGE) for name, alpha in ALPHA.items()}
    bodies = {name: LinearElastic.young(E, NU) for name, E in YOUNG_MODULI.items()}
    structure = Structure(joint, body=bodies, supports={"LEFT": {"x": 0.0}, **supports}, eigenstrain=eigenstrains)
    layer = ThinLayer(LinearElastic.shear(mu, 0.4), EPS)
    return {"meshed layer": structure.full(layer), "interface law": structure.interface(layer)}


def free_strain_difference() -> float:
    """Return the free thermal strain of the upper strip minus that of the lower strip, in plane strain."""
    return (1 + NU) * (ALPHA["UPPER"] - ALPHA["LOWER"]) * TEMPERATURE_CHANGE


def compliances(eps: float = 0.0) -> tuple[float, float]:
    """Return the two compliances of the strips that determine shear stress and curvature, mm/N.

    Opposite axial forces of unit size at the inner sides of the strips change the difference of the axial strains
    there. The first number is the change by stretching, the sum of 1/(E h) of both strips with the moduli of plane
    strain. The second number is the change by bending.

    Args:
        eps: distance of the strips, mm, which adds to the lever arm of the forces.
    """
    plane_moduli = {name: E / (1 - NU**2) for name, E in YOUNG_MODULI.items()}
    stretch = sum(1 / (plane_moduli[name] * h) for name, h in HEIGHTS.items())
    return stretch, lever_arm(eps) ** 2 / sum(plane_moduli[name] * h**3 / 12 for name, h in HEIGHTS.items())


def lever_arm(eps: float = 0.0) -> float:
    """Return the distance between the mid-planes of the strips, mm; `eps` (mm) is the distance of the strips."""
    return sum(HEIGHTS.values()) / 2 + eps


def lag_stress(mu: float, x: npt.NDArray[np.floating]) -> Array:
    """Closed form of the shear stress on S of strips that do not bend (Volkersen), MPa.

    `mu` is the shear modulus of the layer, MPa, `x` the distances (n,) from the middle of the strips, mm.
    """
    B = np.sqrt(mu / EPS * compliances()[0])
    return np.asarray(mu * free_strain_difference() * np.sinh(B * x) / (EPS * B * np.cosh(B * HALF_LENGTH)))


def check_shear_lag(record: Record, h: float) -> None:
    """Solve strips between smooth rigid plates, which keep them flat, and check the shear stress on S.

    `h` is the cell size, mm. `record` writes the stresses to shear_lag.csv.
    """
    table = record.new_table("shear_lag.csv")
    for mu in LAG_MODULI:
        models = strip_models(h, mu, {"BOTTOM": {"y": 0.0}, "TOP": {"y": 0.0}})
        surface = Surface(models["interface law"])
        for name, model in models.items():
            nodes, t = surface.profile(surface.traction(record.add_report(solve(model))))
            x, tau, exact = nodes[:, 0], t[:, 0], lag_stress(mu, nodes[:, 0])
            table.extend(Table.of({"model": name, "mu": mu, "x": x, "tau": tau, "closed_form": exact}))
            at = (x > 0.1 * HALF_LENGTH) & (x < COMPARED_SHARE * HALF_LENGTH)  # exact is 0 at x = 0
            what = f"mu = {mu:g} MPa, {name}: largest relative error inside"
            error, wrong_error = (np.abs(tau[at] / stress[at] - 1).max() for stress in (exact, lag_stress(1.2 * mu, x)))
            record.check(f"shear lag, {what}", error, high=0.02)
            record.check(f"shear lag of 1.2 mu, {what}", wrong_error, low=0.02)


def bonded_curvature(eps: float = 0.0) -> float:
    """Return the curvature of two rigidly bonded strips (Timoshenko 1925), 1/mm.

    `eps` is the distance of the strips, mm, as if a rigid layer joined them.
    """
    stretch, bend = compliances(eps)
    return float(-free_strain_difference() * bend / lever_arm(eps) / (stretch + bend))


def suhir(mu: float, eps: float = 0.0) -> float:
    """Return the curvature in the middle of two strips with a soft layer between them (Suhir 1986), 1/mm.

    Axial forces build up over the shear-lag length from the ends.

    Args:
        mu: shear modulus of the layer, MPa.
        eps: distance of the strips, mm, by which the lever arm of axial forces grows; the stiffness of the layer is
            that of the thickness `EPS`.
    """
    k = np.sqrt(mu / EPS * sum(compliances(eps)))
    return float(bonded_curvature(eps) * (1 - 1 / np.cosh(min(k * HALF_LENGTH, 700.0))))


def curvature(surface: Surface, state: State) -> float:
    """Return the curvature of the strips near their middle in `state`, 1/mm.

    A parabola is fitted to the means of the displacements of both sides of `surface`, the surface S.
    """
    x, v = surface.profile(surface.displacements(state).mean(axis=0))
    is_near_middle = x[:, 0] < 0.1 * HALF_LENGTH
    return float(2 * np.polyfit(x[is_near_middle, 0] ** 2, v[is_near_middle, 1], 1)[0])


def check_bending(record: Record, h: float) -> None:
    """Solve strips that are free to bend, for increasing stiffnesses of the layer, and check their curvature.

    `h` is the cell size, mm. `record` writes the curvatures to bending.csv.
    """
    table = record.new_table("bending.csv")
    gaps = {"meshed layer": EPS, "interface law": 0.0}  # the interface law neglects the thickness in the lever arm
    for mu in BENDING_MODULI:
        models = strip_models(h, mu, {(0.0, -HEIGHTS["LOWER"]): {"y": 0.0}})
        surface = Surface(models["interface law"])
        curvatures = {name: curvature(surface, record.add_report(solve(model))) for name, model in models.items()}
        table.append({"mu": mu, **curvatures, **{f"{name}, closed form": suhir(mu, eps) for name, eps in gaps.items()}})
    for name in gaps:
        ratios, stiffest = table[name] / table[f"{name}, closed form"], table[name][-1] / bonded_curvature()
        record.check(f"curvature with a shear lag, {name}: largest relative error", abs(ratios - 1).max(), high=0.02)
        record.check_near(f"curvature of the stiffest layer over Timoshenko's, {name}", stiffest, 1.0, 0.02)


# ---------------------------------------------------------------- pictures
def draw(record: Record) -> None:
    """Draw the shear stress of flat strips along S, and the curvature of bending strips over the layer's modulus.

    The values are read from shear_lag.csv and bending.csv in the folder of `record`.
    """
    lines, grid = Curves(), np.linspace(0, HALF_LENGTH, 200)
    for mu, mu_table in record.load("shear_lag.csv").split("mu").items():
        for name, part in mu_table.split("model").items():
            lines[f"{name}, G = {mu:g} MPa"] = part["x"][::4], part["tau"][::4]
        lines[f"closed form, G = {mu:g} MPa"] = grid, lag_stress(mu, grid)
    title, save = "two strips of unequal expansion, cooled by 80 K, held flat", record.path("shear_lag.svg")
    look = {"styles": ("s", ".", "-", "s", ".", "--"), "colours": [colour for colour in COLOURS[:2] for _ in range(3)]}
    plotting.curves(lines, "x from the middle (mm)", "shear stress on S (MPa)", title=title, save=save, **look)
    table, grid = record.load("bending.csv"), np.geomspace(min(BENDING_MODULI), max(BENDING_MODULI), 200)
    lines = {name: (table["mu"], 1e3 * table[name]) for name in ("meshed layer", "interface law")}
    lines["closed form"] = grid, np.array([1e3 * suhir(float(mu)) for mu in grid])
    lines["bonded (Timoshenko)"] = grid, np.full(len(grid), 1e3 * bonded_curvature())
    title, save = "two strips of unequal expansion, cooled by 80 K, free to bend", record.path("bending.svg")
    xlabel, styles = "shear modulus G of the layer (MPa)", ("s", "o", "-", ":")
    plotting.curves(lines, xlabel, "curvature (1/m)", title=title, styles=styles, log="x", save=save)
