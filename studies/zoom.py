"""Inside a layer that is not meshed: stresses at its free ends from the interface law, corners' exponent and strength."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from forms import LinearElastic
from forms.ends.end_fields import Corner, EndFields
from studies.problems import free_blocks
from studies.sweeping import last_order
from thinlayer import Probe, State, Surface, ThinLayer, Zoom, plotting, solve
from thinlayer.output.plotting.curves import COLOURS
from thinlayer.running.record import Record
from thinlayer.system.progress import track

Array = npt.NDArray[np.float64]
# Poisson's ratio; E of the bodies over mu, see EPS
CASES = ((0.3, 1000.0), (0.3, 100.0), (0.45, 1000.0), (0.45, 100.0))
EPS = (1 / 16, 1 / 32, 1 / 64)  # the moduli are those of the first one there, and proportional to eps
LAWS: dict[str, dict[str, Any]] = {"order 0": {"order": 0}, "order 1, free": {"order": 1, "edges": "free"}}
THROUGH = 32  # cells through the meshed layer
DISTANCES = np.array([0.05, 0.1, 0.2, 0.5, 1, 1.5, 2, 3, 5, 10])  # of the places compared from an end, over eps
HEIGHTS = np.array([-0.3, -0.15, 0.0, 0.15, 0.3])  # not nearer to corners, where the mesh is too coarse
AT_END = 3.0  # distance up to which places count as at the end
RADIUS = 0.3  # over eps, of the arc around a corner of the meshed layer from which its strength is taken
RATIOS = (0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.475, 0.49)
DRAWN = ("exponent", "H_N", "H_T", "shear")


def run(record: Record, *, quick: bool = False) -> None:
    """Compare stresses in a meshed layer between two blocks with those zoomed from interface laws.

    Args:
        record: where to write.
        quick: two thicknesses, one ratio of moduli for each of Poisson's, and fewer ratios in the table of corners.
    """
    _corners(record, RATIOS[3::3] if quick else RATIOS)
    for nu, ratio in CASES[::3] if quick else CASES:
        _errors(record, nu, ratio, EPS[:2] if quick else EPS)


def _corners(record: Record, ratios: Sequence[float]) -> None:
    """Write exponents and strengths of corners: for stresses along S and shear stresses on the end that are 1, eps = 1."""
    table = record.table("corners.csv")
    for nu in track(list(ratios), "zoom", "corner, nu = {:g}"):
        fields, corner = EndFields(nu), Corner(nu)
        H_N, H_T, *_ = fields.strengths
        r, lmbda = np.array([1e-5, 1e-4]), 2 * nu / (1 - 2 * nu)
        near = fields.stresses(r, np.full(2, -0.5))  # on the lower face, near the corner
        M = (lmbda + 2) / lmbda  # of the normal traction far away, where s_11 = 1
        fitted_N = (near[0, :, 1] + M) * r ** (1 - corner.exponent)
        fitted_T = near[1, :, 1] * r ** (1 - corner.exponent)
        error = max(abs(fitted_N[0] / H_N - 1), abs(fitted_T[0] / H_T - 1))
        row = {"nu": nu, "exponent": corner.exponent, "H_N": H_N, "H_T": H_T, "shear": corner.shear}
        table.append(row | {"from_traction": error})
    well = table["nu"] >= 0.15  # below, the exponents of the next fields are near that of the singular one
    record.check("largest difference of H from the traction on the face", table["from_traction"][well].max(), high=2e-3)


def _errors(record: Record, nu: float, ratio: float, thicknesses: Sequence[float]) -> None:
    """Write the errors of zoomed stresses and strengths for one material."""
    table = record.table(f"errors_{nu:g}_{ratio:g}.csv")
    law = LinearElastic.shear(100.0 / ratio, nu)
    for eps in track(list(thicknesses), "zoom", f"nu = {nu:g}, E/mu = {ratio:g}, eps = {{:g}}"):
        blocks = free_blocks(eps / THROUGH)
        full = record.solved(solve(blocks.full(ThinLayer(law, eps, at=EPS[0]), cells_through=THROUGH)))
        row: dict[str, Any] = {"eps": eps, "M/E": (law.lmbda + 2 * law.mu) * eps / EPS[0] / 100.0}
        for name, chosen in LAWS.items():
            zoom = Zoom(record.solved(solve(blocks.interface(ThinLayer(law, eps, at=EPS[0], **chosen)))))
            row |= {f"{key} {name}": value for key, value in _compared(zoom, full).items()}
        table.append(row)
        if eps == thicknesses[-1] and (nu, ratio) == CASES[-1]:
            for component in ("N", "T"):
                plotting.zoomed(zoom, full, end=1, component=component, save=record.path(f"end_{component}.png"))
    for key, low in (("end", 1.0), ("inside", 1.2)):
        order = last_order(table, f"{key} order 1, free")
        record.check(f"order of the error, {key}, nu = {nu:g}, E/mu = {ratio:g}", order, low=low)
    for key, high in (("end", 0.05), ("H", 0.08)):
        error = table[f"{key} order 1, free"][-1]
        record.check(f"error, {key}, nu = {nu:g}, E/mu = {ratio:g}", error, high=high)


def _compared(zoom: Zoom, full: State) -> dict[str, float]:
    """Relative errors of stresses at the ends and inside, root mean squares over the places, and of H, the largest."""
    probe, eps, found, strengths = Probe(full), zoom.eps, [], []
    for number, end in enumerate(zoom.ends):
        d, y = (one.ravel() for one in np.meshgrid(DISTANCES[DISTANCES * eps <= 0.5], HEIGHTS))
        x = end.x - d[:, None] * eps * end.m
        known = probe.stress(Surface(full.model, zoom.seam).in_layer(x, y))
        found.append((d, known, zoom.stress(x, y) - known))
        strengths += [(end.lower[0], _meshed(zoom, probe, number, -1)), (end.upper[0], _meshed(zoom, probe, number, 1))]
    distance, known, error = (np.concatenate(one) for one in zip(*found, strict=True))
    near = distance <= AT_END
    parts = {"end": near, "inside": ~near}
    errors = {name: float(np.sqrt(np.mean(error[at] ** 2) / np.mean(known[at] ** 2))) for name, at in parts.items()}
    zoomed, meshed = np.array(strengths).T
    return errors | {"H": float(np.abs(zoomed - meshed).max() / np.abs(meshed).max())}


def _meshed(zoom: Zoom, probe: Probe, number: int, side: int) -> float:
    """H at a corner of the meshed layer, on the lower (-1) or on the upper (1) face, by reciprocity on an arc."""
    end, axes, (lmbda, mu) = zoom.ends[number], zoom.axes_of_end(number), zoom.law.elastic_moduli()
    corner, eps, r = Corner(lmbda / (lmbda + mu) / 2), zoom.eps, RADIUS * zoom.eps
    axes = axes * np.array([[1.0], [-side]])  # away from the end, and into the layer
    at = np.vstack([corner.arc(RADIUS), [[0.0, 0.0], [RADIUS, 0.0]]])
    places = Surface(probe.state.model, zoom.seam).in_layer(end.x - at[:, :1] * eps * end.m, side * (0.5 - at[:, 1]))
    u, stress = probe.displacement(places) @ axes[:, :2].T, probe.stress(places[:-2])
    turn = (u[-1, 1] - u[-2, 1]) / r  # of the face, with its body
    u = u[:-2] - u[-2] - turn * eps * np.stack([-at[:-2, 1], at[:-2, 0]], axis=1)
    in_axes = np.einsum("ai,nij,bj->nab", axes, stress, axes)
    return corner.strength(r, u * mu, np.stack([in_axes[:, 0, 0], in_axes[:, 1, 1], in_axes[:, 0, 1]], axis=1))


def draw(record: Record) -> None:
    """Draw errors against the thickness, and exponents and strengths of corners against nu."""
    parts = {}
    names = [f"{key}{law}" for law in LAWS for key in ("end ", "inside ", "H ")]
    for nu, ratio in CASES:
        if record.has(file := f"errors_{nu:g}_{ratio:g}.csv"):
            table = record.load(file)
            parts[f"nu = {nu:g}, E/mu = {ratio:g}"] = {name: (table["eps"], table[name]) for name in names}
    plotting.panels(
        parts,
        "eps",
        "relative error",
        styles={name: "o--" if "order 0" in name else "o-" for name in names},
        colours=dict(zip(names, 2 * COLOURS[:3], strict=True)),
        yscale="log",
        columns=2,
        save=record.path("errors.png"),
    )
    table = record.load("corners.csv")
    plotting.panels(
        {name: {"half strip": (table["nu"], table[name])} for name in DRAWN},
        "Poisson's ratio",
        styles={"half strip": "o-"},
        ylim={"H_N": (0.0, 4.0), "H_T": (0.0, 2.5)},
        columns=2,
        save=record.path("corners.png"),
    )
