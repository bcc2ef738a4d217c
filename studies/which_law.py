"""Which law to choose: errors of orders 0 and 1 and of Rubber over thickness, Poisson's ratio and bodies' stiffness."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import ufl
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

from forms import Incompressible, LinearElastic, Rubber
from forms.base import Array
from geometry.parallel import default_comm
from geometry.topology import IntArray
from studies.problems import FOURIER_BODY, WaveSolution, between_rollers, free_blocks
from studies.sweeping import difference
from thinlayer import RangeWarning, Structure, Surface, Table, ThinLayer, solve
from thinlayer.discretisation.state import State
from thinlayer.output.plotting.curves import as_fraction
from thinlayer.output.plotting.picture import finish_picture, make_panels
from thinlayer.running.record import Record
from thinlayer.system.progress import track

EPS = (1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4)  # over the half-wave of the load, or over the width of S; these are 1
NUS = (0.0, 0.2, 0.3, 0.4, 0.45, 0.48, 0.49, 0.499, 0.4999, 0.5)
QUICK_NUS = (0.3, 0.45, 0.49, 0.499, 0.5)
E_BODY = 100.0
CONTRASTS = (10, 200, 200_000)  # Young's modulus of the bodies over the shear modulus of the layer
LAW_NAMES = ("order_0", "order_1", "edges", "rubber", "rubber_edges")
CORRECTED_LAWS = {"order_1": "edges", "rubber": "rubber_edges"}  # law -> the same law, corrected at free ends
MAP_LABELS = {"0: order 0": "order_0", "1: LinearElastic, order 1": "order_1", "R: Rubber, order 1": "rubber"}
MAP_TEXTS, MAP_COLOURS = (*MAP_LABELS, "m: meshed layer"), ("#5e9bc8", "#b7dfc0", "#fff7b0", "#f8b26a")
FONT_SIZE = 8  # of maps, points: 6 in print, where two columns fill 170 mm
CELL_INCHES, MARGIN_INCHES, LEGEND_INCHES = np.array([0.37, 0.25]), np.array([0.45, 0.35]), 1.4  # sizes of maps
QUANTITIES = ("traction", "jump", "compliance")
ALLOWED_ERRORS = (0.01, 0.05)  # errors for which the cheapest law is drawn
WARNED_ERROR = 0.1  # error of order 1 from which on a warning is required
LOAD = 1e-6  # stress: far below the moduli of the layers, so that warnings come from the laws, not from the loads
INNER_HALF_WIDTH = 0.25  # free ends: errors are measured up to this distance from the middle of S
SET_UP_TITLES = {"rollers": "between rollers, under one half-wave", "free": "free ends, inner half of S"}

ErrorFunction = Callable[[State], tuple[float, ...]]


def run(record: Record, *, quick: bool = False) -> None:
    """Measure the errors of interface laws for blocks between rollers and for blocks with free ends.

    Between rollers the reference is an exact solution, at free ends a meshed layer.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: three thicknesses and five Poisson's ratios, a coarser mesh.
    """
    table = record.new_table("table.csv")
    for name, set_up in (("rollers", Rollers(1 / 16 if quick else 1 / 32)), ("free", FreeEnds(quick))):
        cases = [(c, nu, e) for c in CONTRASTS for nu in (QUICK_NUS if quick else NUS) for e in EPS[:: 1 + quick]]
        for contrast, nu, eps in track(cases, name, "E/mu, nu, eps = {}"):
            row = {"sides": name, "E/mu": contrast, "nu": nu, "eps": eps}
            table.append(row | _error_row(record, set_up, E_BODY / contrast, nu, eps))
        _check(record, name, table.split("sides")[name])


def _error_row(record: Record, set_up: Rollers | FreeEnds, mu: float, nu: float, eps: float) -> dict[str, float | None]:
    """Measure the errors of all interface laws for one layer, and record which laws give a warning.

    Args:
        record: record of the run, which keeps the solver's reports.
        set_up: the blocks.
        mu: shear modulus of the layer.
        nu: Poisson's ratio of the layer.
        eps: thickness of the layer.

    Returns:
        Table row with the relative errors "traction_LAW", "jump_LAW" and "compliance_LAW", and "warned_LAW", 1 or 0. A
        law without this material has None.
    """
    lmbda = 2 * nu / (1 - 2 * nu) * mu if nu < 0.5 else math.inf
    errors_of, structure = set_up.error_function(record, lmbda, mu, eps), set_up.structure(eps)
    columns = [f"{quantity}_{law}" for law in LAW_NAMES for quantity in QUANTITIES]
    row: dict[str, float | None] = dict.fromkeys([*columns, *(f"warned_{law}" for law in LAW_NAMES)])
    for law, layer in set_up.layers(lmbda, mu, eps).items():
        with warnings.catch_warnings(record=True, action="always") as caught_warnings:
            state = record.add_report(solve(structure.interface(layer)))
        warned = any(issubclass(warning.category, RangeWarning) for warning in caught_warnings)
        row[f"warned_{law}"] = float(default_comm().bcast(warned))  # rank 0 warns
        row |= {f"{quantity}_{law}": error for quantity, error in zip(QUANTITIES, errors_of(state), strict=True)}
    return row


def _layers(lmbda: float, mu: float, eps: float) -> dict[str, ThinLayer]:
    """Return the layers of all laws that accept a material, without correction at free ends, by the names of the laws.

    Order 1 of `LinearElastic` is left out at nu = 1/2, `Rubber` at nu = 0.

    Args:
        lmbda, mu: Lamé's moduli of the layer; lmbda is infinite at nu = 1/2.
        eps: thickness of the layer.
    """
    rubber_law, order_1 = _rubber_law(lmbda, mu), partial(ThinLayer, eps=eps, order=1, edges="plain")
    if math.isinf(lmbda):
        return {"order_0": ThinLayer(rubber_law, eps), "rubber": order_1(rubber_law)}
    elastic = LinearElastic(lmbda, mu)
    layers = {"order_0": ThinLayer(elastic, eps), "order_1": order_1(elastic)}
    return layers | ({"rubber": order_1(rubber_law)} if lmbda else {})


def _rubber_law(lmbda: float, mu: float) -> Rubber | Incompressible | LinearElastic:
    """Return a law of an isotropic material whose meshed layer does not lock: `Rubber`, or its limits.

    The limits are `Incompressible` for an infinite `lmbda`, and `LinearElastic` for `lmbda` = 0. `mu` is the shear
    modulus.
    """
    return Incompressible(mu) if math.isinf(lmbda) else Rubber(lmbda, mu) if lmbda else LinearElastic(lmbda, mu)


class Rollers:
    """Blocks of height 1/2 between rollers, under one half-wave of length 1, with exact solutions.

    The solutions are those of `WaveSolution`.

    Args:
        h: cell size.

    Attributes:
        layers: function that returns the layers of all laws that accept a material; there are no free ends to correct.
    """

    layers = staticmethod(_layers)

    def __init__(self, h: float) -> None:
        s, c = (lambda x, f=f: LOAD * f(ufl.pi * x[0]) for f in (ufl.sin, ufl.cos))
        joint, setup = between_rollers(h, lambda x, t: (0.5 * s(x), c(x)))
        self._structure = Structure(joint, **setup)
        self._wave = WaveSolution(math.pi, 0.5, (FOURIER_BODY.lmbda, FOURIER_BODY.mu), (0.5 * LOAD, LOAD))

    def structure(self, eps: float) -> Structure:
        """Return the structure of the blocks, which is the same for all thicknesses `eps`."""
        return self._structure

    def error_function(self, record: Record, lmbda: float, mu: float, eps: float) -> ErrorFunction:
        """Return a function that compares a state of an interface model with the exact solution.

        The function returns the relative errors of the amplitudes of traction and jump on S, and of the compliance.

        Args:
            record: record of the run; it is not used.
            lmbda, mu: Lamé's moduli of the layer.
            eps: thickness of the layer.
        """
        *exact_amplitudes, exact_work = self._wave.solve_amplitudes(lmbda, mu, eps)

        def errors(state: State) -> tuple[float, ...]:
            surface = Surface(state.model)
            x = surface.x[0]
            mode_shapes, relative_errors = (np.sin(np.pi * x), np.cos(np.pi * x)), []
            for field, exact in zip((surface.reaction(state), surface.jump(state)), exact_amplitudes, strict=True):
                amplitudes = [2 * surface.integral(field[k] * mode_shapes[k]) for k in range(2)]
                relative_errors.append(float(np.linalg.norm(amplitudes - exact) / np.linalg.norm(exact)))
            return (*relative_errors, abs(state.energies()["loads"] / exact_work - 1))

        return errors


class FreeEnds:
    """Blocks of height 1/2 and width 1 with free sides, pressed and sheared; the references are meshed layers.

    Args:
        quick: whether the meshes are coarser.
    """

    def __init__(self, quick: bool) -> None:
        self._cells, self._structures = (16, 10, 2) if quick else (32, 15, 4), dict[float, Structure]()

    def structure(self, eps: float) -> Structure:
        """Return the structure of the blocks, with cells at the ends of S that are smaller than the thickness `eps`."""
        along, ends, _ = self._cells
        if eps not in self._structures:
            self._structures[eps] = free_blocks(min(eps, 1 / 8) / ends, (0.3 * LOAD, -LOAD), h_S=1 / along)
        return self._structures[eps]

    def layers(self, lmbda: float, mu: float, eps: float) -> dict[str, ThinLayer]:
        """Return the layers of all laws that accept a material, by the names of the laws.

        Laws of order 1 are also among them with a correction at free ends, if Poisson's ratio and the bodies' stiffness
        allow it. `lmbda` and `mu` are Lamé's moduli of the layer, `eps` its thickness.
        """
        layers = _layers(lmbda, mu, eps)
        corrected = {name: replace(layers[law], edges=None) for law, name in CORRECTED_LAWS.items() if law in layers}
        legal = {name: self.structure(eps).interface(layer).free_ends("S") is None for name, layer in corrected.items()}
        return layers | {name: layer for name, layer in corrected.items() if legal[name]}

    def error_function(self, record: Record, lmbda: float, mu: float, eps: float) -> ErrorFunction:
        """Solve with the layer meshed, and return a function that compares other states with this solution.

        The function takes a state of an interface model. It returns the relative errors of traction and jump (in L2
        norms on the inner half of S), and of the compliance.

        Args:
            record: record of the run, which keeps the solver's report.
            lmbda, mu: Lamé's moduli of the layer.
            eps: thickness of the layer.
        """
        layer = ThinLayer(_rubber_law(lmbda, mu), eps)
        full = record.add_report(solve(self.structure(eps).full(layer, cells_through=self._cells[2])))
        full_work = full.energies()["loads"]

        def errors(state: State) -> tuple[float, ...]:
            surface = Surface(state.model)
            is_inner = abs(surface.x[0] - 0.5) < INNER_HALF_WIDTH
            s_errors = (difference(surface, field, state, full, is_inner) for field in (Surface.reaction, Surface.jump))
            return (*s_errors, abs(state.energies()["loads"] / full_work - 1))

        return errors


def _larger_errors(table: Table, law: str) -> Array:
    """Return for each row of `table` the larger one of the errors of traction and jump, (rows,).

    `law` is the name of the law in `LAW_NAMES`.
    """
    return np.maximum(table[f"traction_{law}"], table[f"jump_{law}"])


def _check(record: Record, name: str, table: Table) -> None:
    """Check the convergence of `Rubber`, and that `LinearElastic` of order 1 warns of errors above 10 %.

    The error of `Rubber` is O(eps^2) between rollers and O(eps) at free ends.

    Args:
        record: record of the run, which receives the checks.
        name: "rollers" or "free" (free ends).
        table: rows of `_error_row` for these blocks.
    """
    eps, errors = table["eps"], _larger_errors(table, "rubber")
    order, high, fine = (2, 2.0, eps > 0.03) if name == "rollers" else (1, 0.3, eps < 0.1)
    record.check(f"{name}: largest error of Rubber over eps^{order}", np.nanmax((errors / eps**order)[fine]), high=high)
    is_silent = (_larger_errors(table, "order_1") > WARNED_ERROR) & (table["warned_order_1"] == 0)
    record.check(f"{name}: errors of LinearElastic, order 1, above 10 % without a warning", is_silent.sum(), high=0)
    is_missed = (_larger_errors(table, "rubber") > WARNED_ERROR) & (eps < 0.2)
    record.check(f"{name}: errors of Rubber above 10 %, eps < 1/5", is_missed.sum(), high=0)


def draw(record: Record) -> None:
    """Draw maps of the cheapest law whose error is below 1 % and below 5 %, over thickness and Poisson's ratio.

    The values are read from table.csv in the folder of `record`.
    """
    for sides, table in record.load("table.csv").split("sides").items():
        nus, eps, parts = np.unique(table["nu"]), np.unique(table["eps"]), table.split("E/mu")
        cases = [(contrast, allowed) for contrast in parts for allowed in ALLOWED_ERRORS]
        width, height = CELL_INCHES * (len(nus), len(eps)) + MARGIN_INCHES
        shape = len(parts), len(ALLOWED_ERRORS)
        inches = width * shape[1], height * shape[0] + LEGEND_INCHES
        panels = make_panels(None, shape, len(cases), inches, sharex=True, sharey=True)
        for axes, (contrast, allowed) in zip(panels, cases, strict=True):
            cheapest = _cheapest_laws(parts[contrast], allowed).reshape(len(nus), -1)  # by ratio, then by thickness
            _draw_cells(axes, cheapest.T)
            axes.set_xticks(np.arange(len(nus)) + 0.5, [f"{nu:g}" for nu in nus], rotation=60)
            axes.set_yticks(np.arange(len(eps)) + 0.5, map(as_fraction, eps))
            axes.tick_params(length=0, labelsize=FONT_SIZE)
            axes.set(xlabel="Poisson's ratio nu of the layer", ylabel="eps/l")
            axes.set_title(f"E/mu = {contrast:,.0f}, errors below {allowed:.0%}", fontsize=FONT_SIZE + 1)
            axes.label_outer()
        patches = [Patch(color=colour, label=label) for colour, label in zip(MAP_COLOURS, MAP_TEXTS, strict=True)]
        title = f"the cheapest law that is exact enough: {SET_UP_TITLES[sides]}"
        finish_picture(panels, record.path(f"cheapest_{sides}.svg"), title, patches, len(patches))


def _draw_cells(axes: Axes, laws: IntArray) -> None:
    """Draw numbers of laws, (rows, columns) from the bottom, as cells with colours and letters."""
    axes.pcolormesh(laws, cmap=ListedColormap(MAP_COLOURS), vmin=0, vmax=len(MAP_TEXTS) - 1, edgecolors="white")
    for (i, j), law in np.ndenumerate(laws):
        axes.text(j + 0.5, i + 0.5, MAP_TEXTS[int(law)][0], ha="center", va="center", fontsize=FONT_SIZE)


def _cheapest_laws(table: Table, allowed: float) -> IntArray:
    """Return for each row of `table` the number (rows,) of the first law in `MAP_LABELS` with errors below `allowed`.

    If there is none, it is the number after the last law. Where a law can be corrected at free ends, its errors are
    those with the correction.
    """
    is_exact = []
    for law in MAP_LABELS.values():
        plain, corrected = (_larger_errors(table, name) for name in (law, CORRECTED_LAWS.get(law, law)))
        is_exact.append(np.where(np.isfinite(corrected), corrected, plain) < allowed)
    return np.argmax([*is_exact, np.ones(len(table), bool)], axis=0)
