"""Structures that several studies solve, given by joint and arguments of `Structure`; exact solution of one."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypedDict, Unpack

import numpy as np
import ufl
from scipy.linalg import expm

from forms import BulkLaw, Conduction, LinearElastic, MohrCoulomb
from forms.base import Array
from forms.tensors import Expr
from geometry import block, disc, fibre, read, ring, sandwich
from geometry.joint import Joint, Profile
from geometry.shapes.sizing import GridArgs
from geometry.topology import BoolArray
from thinlayer import Structure, Surface, ThinLayer, examples, piecewise
from thinlayer.discretisation.coefficient import LoadInput, Value
from thinlayer.discretisation.forces import BodyForce
from thinlayer.discretisation.part_definition import PartDefinition
from thinlayer.discretisation.state import State
from thinlayer.discretisation.supports import Place, Support, SupportsByPlace

FOURIER_BODY = LinearElastic.young(E=100.0, nu=0.3)
FOURIER_LAYER = LinearElastic(lmbda=60.0, mu=40.0)
MORTAR_LAW = MohrCoulomb(60.0, 40.0, cohesion=0.05, friction_angle=30.0, elastic_fraction=0.02)  # for `sheared`
BAR_LAW = LinearElastic.young(E=130e3, nu=0.2)  # MPa, section 8.2 of the paper
SUPPORTS: dict[Place, Support] = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}  # clamped below, on rollers
CHI = np.array([[0.0, 0.3], [0.3, 1.0]])  # a layer changes phase as it opens and is sheared
SNAP_LAW_ARGS = (1.0, 1.0, 1.2, 0.9, CHI)  # lmbda, mu, alpha, transformation energy and chi of a layer that snaps
MAX_SHEAR = 5.0  # largest shear on the upper side in `sheared`, over the pressure there


class StructureArguments(TypedDict, total=False):
    """Keyword arguments of `Structure` for a study's problem; the joint is passed separately."""

    body: BulkLaw | Mapping[str, BulkLaw]
    supports: SupportsByPlace
    tractions: Mapping[str, LoadInput]
    fluxes: Mapping[str, Value]
    body_force: BodyForce
    plane: str
    element: str
    parts: Sequence[PartDefinition]
    eigenstrain: Mapping[str, float]


Problem = tuple[Joint, StructureArguments]
Heights = tuple[float, float]  # of the lower and the upper block
LayerOfThickness = Callable[[float], ThinLayer]
LoadPath = Mapping[float, tuple[float, float, float]]  # time -> p, r and q of `pressed`, linear in between


def layer_fn(law: BulkLaw, at: float | None = 1.0, order: int = 0, profile: Profile | None = None) -> LayerOfThickness:
    """Return a function that makes a layer of a given thickness.

    Args:
        law: law of the layer.
        at: thickness at which the law's parameters hold; the layer's parameters are proportional to its thickness.
            None: parameters do not depend on the thickness.
        order: order of the interface law, 0 or 1.
        profile: function of the place by which the given thickness is multiplied; None: the thickness is uniform.
    """
    return partial(ThinLayer, law, at=at, order=order, profile=profile)


def between_rollers(
    h: float, top: LoadInput, *, width: float = 1.0, cell: str = "quadrilateral", **more: Unpack[StructureArguments]
) -> Problem:
    """Two blocks, 0.5 high, under a traction on top; the lower side is clamped, the lateral sides are on rollers.

    The lateral sides of the layer are on rollers, too, so that nothing is singular at the ends of S. Lengths and stresses
    have no units. The bodies have E = 100 and nu = 0.3.

    Args:
        h: cell size; the mesh is a grid.
        top: the traction.
        width: width of the blocks.
        cell: "triangle" or "quadrilateral".
        more: further arguments of `Structure`, or others in place of those above.

    Returns:
        The joint, and the arguments of its `Structure`.
    """
    setup: StructureArguments = {"body": FOURIER_BODY, "supports": SUPPORTS, "tractions": {"TOP": top}}
    return sandwich(width, 0.5, 0.5, h, cell=cell, structured=True), setup | more


def fourier(h: float, *, cell: str = "triangle") -> Problem:
    """Two blocks, 1 wide and 0.5 high, under a traction with one half-wave; its solution is a single Fourier mode.

    The lower side is clamped, the lateral sides (the layer's too) are on rollers. The upper side carries the traction
    (sin(pi x)/2, cos(pi x)). Lengths and stresses have no units. The bodies have E = 100 and nu = 0.3.

    Args:
        h: cell size; the mesh is a grid.
        cell: "triangle" or "quadrilateral".

    Returns:
        The joint, and the arguments of its `Structure`.
    """
    return between_rollers(h, lambda x, t: (0.5 * ufl.sin(ufl.pi * x[0]), ufl.cos(ufl.pi * x[0])), cell=cell)


def conducting(h: float) -> Problem:
    """Two blocks, 1 wide and 0.5 high, that conduct heat: the flux cos(pi x) enters on top, the bottom is held at 0.

    The solution is a single Fourier mode. The blocks have the conductivity 1; there are no units.

    Args:
        h: cell size; the mesh is a grid.

    Returns:
        The joint, and the arguments of its `Structure`.
    """
    setup: StructureArguments = {"body": Conduction(1.0), "supports": {"BOTTOM": 0}}
    setup |= {"fluxes": {"TOP": lambda x, t: ufl.cos(ufl.pi * x[0])}}
    return sandwich(1.0, 0.5, 0.5, h, cell="quadrilateral", structured=True), setup


@dataclass(frozen=True)
class WaveSolution:
    """Exact solution in plane strain of two blocks with a layer between them under sinusoidal tractions.

    The lower side is clamped. Displacements are (u_x(y) sin(k x), u_y(y) cos(k x)). Tractions on planes of constant y
    are (t_x(y) sin(k x), t_y(y) cos(k x)), and so is the load on top.

    Attributes:
        k: wave number; a half-wave is pi/k long.
        height: height of each block, without the layer.
        moduli: Lamé's moduli lmbda and mu of the blocks.
        load: amplitudes t_x and t_y of the traction on top.
    """

    k: float
    height: float
    moduli: tuple[float, float]
    load: tuple[float, float]

    def transfer_matrix(self, lmbda: float, mu: float, thickness: float) -> Array:
        """Return the transfer matrix (4, 4) of an isotropic layer.

        It maps the amplitudes of displacement and traction (u_x, u_y, t_x, t_y) at the lower face to those at the upper
        face.

        Args:
            lmbda, mu: Lamé's moduli of the layer; lmbda may be infinite.
            thickness: thickness of the layer; a block is also such a layer.
        """
        k, M = self.k, lmbda + 2 * mu
        ratio, modulus = (1.0, 4 * mu) if math.isinf(lmbda) else (lmbda / M, 4 * mu * (lmbda + mu) / M)
        generator = [[0, k, 1 / mu, 0], [-ratio * k, 0, 0, 1 / M], [modulus * k**2, 0, 0, ratio * k], [0, 0, -k, 0]]
        return np.asarray(expm(np.array(generator) * thickness))

    def solve_amplitudes(self, lmbda: float, mu: float, eps: float) -> tuple[Array, Array, float]:
        """Solve with a layer of Lamé's moduli `lmbda` and `mu` and the thickness `eps` between the blocks.

        Returns:
            Amplitudes (2,) of the layer's mean traction, amplitudes (2,) of its jump, and the work of the load over a
            half-wave of length 1.
        """
        body, layer = self.transfer_matrix(*self.moduli, self.height), self.transfer_matrix(lmbda, mu, eps)
        lower = body @ np.append(np.zeros(2), np.linalg.solve((body @ layer @ body)[2:, 2:], self.load))
        upper = layer @ lower
        return (upper + lower)[2:] / 2, (upper - lower)[:2], float(self.load @ (body @ upper)[:2]) / 2


def top_loaded(joint: Joint, top: LoadInput, **more: Unpack[StructureArguments]) -> Structure:
    """Make a structure under a traction on top, clamped below, whose bodies have E = 100 and nu = 0.3.

    Args:
        joint: joint with the facet sets "BOTTOM" and "TOP".
        top: traction on top.
        more: further arguments of `Structure`. If `body`, `supports` or `tractions` is among them, it replaces the one
            above.
    """
    setup: StructureArguments = {"body": FOURIER_BODY, "supports": {"BOTTOM": 0.0}, "tractions": {"TOP": top}}
    return Structure(joint, **setup | more)


def free_blocks(
    h_ends: float,
    load: LoadInput = (0.3, -1.0),
    heights: Heights = (0.5, 0.5),
    *,
    h_S: float = 1 / 32,
    **more: Unpack[StructureArguments],
) -> Structure:
    """Make a structure of two blocks, 1 wide, with free sides, clamped below, under a traction on top (`top_loaded`).

    Args:
        h_ends: cell size at the ends of S.
        load: traction on top.
        heights: heights of the lower and the upper block.
        h_S: cell size on S.
        more: further arguments of `Structure`. If `body`, `supports` or `tractions` is among them, it replaces that of
            `top_loaded`.
    """
    return top_loaded(sandwich(1.0, *heights, h=1 / 8, h_S=h_S, h_ends=h_ends, cell="quadrilateral"), load, **more)


def pressed(h: float, path: LoadPath, **more: Unpack[StructureArguments]) -> Problem:
    """Two blocks, 2 wide and 0.5 high, pressed together more at one end than at the other, and sheared.

    The lower side is clamped. The lateral sides (the layer's too) are on rollers, so that nothing is singular at the
    ends of S. The upper side carries the traction (q sin(pi x/2), -p - r cos(pi x/2)). Lengths and stresses have no
    units. The bodies have E = 100 and nu = 0.3. With a layer of the law `FOURIER_LAYER` the pressure on S is p + (0.88
    r - 0.36 q) cos(pi x/2). The shear traction is (0.13 r + 0.08 q) sin(pi x/2).

    Args:
        h: cell size; the mesh is a grid of squares.
        path: time -> coefficients p, r and q of the traction; they are linear in time between these times.
        more: further arguments of `Structure`.

    Returns:
        The joint, and the arguments of its `Structure`.
    """
    loads = piecewise(path)

    def top(x: Expr, t: Expr) -> tuple[Expr, Expr]:
        p, r, q = loads(x, t)
        return q * ufl.sin(ufl.pi * x[0] / 2), -p - r * ufl.cos(ufl.pi * x[0] / 2)

    return between_rollers(h, top, width=2.0, **more)


def sheared(h: float, **more: Unpack[StructureArguments]) -> Problem:
    """The blocks of `fourier` under a pressure, with a shear that grows until t = 1 and then decreases.

    Args:
        h: cell size, a length without unit.
        more: further arguments of `Structure`, or others in place of those of `fourier`.

    Returns:
        The joint, and the arguments of its `Structure`.
    """

    def load(x: Expr, t: Expr) -> tuple[Expr, Expr]:
        shear = MAX_SHEAR * ufl.conditional(ufl.lt(t, 1), t, 2 - t)
        return shear * ufl.sin(ufl.pi * x[0]), -1 + 0.3 * ufl.cos(ufl.pi * x[0])

    return between_rollers(h, load, **more)


def sliding_bar(n: int, *, depth: bool = False, **cells: Unpack[GridArgs]) -> Problem:
    """The bar of Fig. 7, a square of 40 mm in plane strain, pushed along a rigid base AB by 100 MPa, onto it by 50 MPa.

    The right side cannot move along x, and its lower corner B is fixed. With `depth` the bar is a cube; its back side
    is on rollers, and no corner is fixed.

    Args:
        n: number of cells along each side; S has n + 1 nodes along x.
        depth: whether the bar is a cube in 3D.
        **cells: arguments of `geometry.block` on the type and arrangement of cells; the mesh is a grid unless
            `structured` is False.

    Returns:
        The joint, and the arguments of its `Structure`.
    """
    side = 40.0
    cells.setdefault("structured", True)
    joint = block(side, side, side / n, depth=side if depth else None, **cells)
    fixed: dict[Place, Support] = {"BACK": {"z": 0.0}} if depth else {(side, 0.0): 0.0}
    zeros = (0.0,) if depth else ()
    loads = {"LEFT": (100.0, 0.0, *zeros), "TOP": (0.0, -50.0, *zeros)}
    return joint, {"body": BAR_LAW, "supports": {"RIGHT": {"x": 0.0}, **fixed}, "tractions": loads, "element": "P1"}


# ---------------------------------------------------------------- joints as they are built, in mm or m, and MPa
young = LinearElastic.young
STEEL, ALUMINIUM, STONE = young(E=210e3, nu=0.3), young(E=70e3, nu=0.33), young(E=20e3, nu=0.2)
GLUE, GLUE_EPS = young(E=2e3, nu=0.4), 0.2  # 2 GPa where the layer is 0.2 mm thick
JOINT, JOINT_EPS = young(E=1e3, nu=0.2), 0.01  # 1 GPa where joints are 10 mm thick
FIBRE_RADIUS, RIM_RADIUS, STRETCH = 0.4, 1.0, 0.1  # the rim is stretched along x
GLASS, RESIN = young(E=5.0, nu=0.3), young(E=1.0, nu=0.2)
COATING = LinearElastic(lmbda=0.6, mu=0.7)  # of a fibre, at the thickness 1
TUBE_HUB = young(E=70e3, nu=0.34)
TUBE_GLUE, TUBE_GLUE_EPS = young(E=2e3, nu=0.3), 0.2  # 2 GPa where the layer is 0.2 mm thick
TUBE_RADII, TUBE_LENGTH = (6.0, 12.0, 18.0), 8.0  # mm: bore, S, rim
PLATE_SUPPORTS: dict[str, Support] = {"LEFT": {"y": 0.0}, "RIGHT": {"y": 0.0}}
PRESSURE_LOADS: StructureArguments = {"supports": PLATE_SUPPORTS, "tractions": {"BOTTOM": (50.0, 0.0)}}  # in the bore
PUSH_LOADS: StructureArguments = {"supports": {"RIGHT/UPPER": 0.0}, "tractions": {"LEFT/LOWER": (0.0, -40.0)}}  # shaft
HUB_RADII = (10.0, 15.0, 20.0)  # mm: inside of the shaft, S, outside of the hub
ROD_RADIUS, ROD_HEIGHT = 12.0, 10.0  # mm: of each cylinder
ROD_STRESS, ROD_BENDING = 20.0, 30.0  # MPa: mean, and at the edge
ARCH_WEIGHT = (0.0, -0.025)  # MN/m^3
ARCH_RADIUS, MIDDLE = 1.15, 0.1  # m: joints are measured over the middle two thirds of their length


def coated_fibre(h: float) -> Problem:
    """A fibre in a disc of resin whose rim is stretched along x; the thin layer is the coating.

    Args:
        h: cell size; lengths and stresses have no units.

    Returns:
        The joint, and the arguments of its `Structure`.
    """
    joint = fibre(FIBRE_RADIUS, RIM_RADIUS, h, cell="quadrilateral", degree=2)
    rim: Support = {"x": lambda x, t: STRETCH * x[0], "y": 0.0}
    return joint, {"body": {"FIBRE": GLASS, "MATRIX": RESIN}, "supports": {"OUTSIDE": rim}}


def tubes(h: float, loads: StructureArguments) -> Problem:
    """A tube glued into another tube, in an axisymmetric section.

    In the section x is the radius and y the axis. The facet set "BOTTOM" of the joint is the bore (the inner side
    of the inner tube), "LEFT" the upper end of both tubes, where y is largest.

    Args:
        h: cell size, mm.
        loads: supports and tractions.

    Returns:
        The joint, and the arguments of its `Structure`.
    """
    bore, on_S, rim = TUBE_RADII
    section = sandwich(TUBE_LENGTH, on_S - bore, rim - on_S, h, cell="quadrilateral", structured=True)
    bodies: StructureArguments = {"body": {"LOWER": STEEL, "UPPER": TUBE_HUB}, "plane": "axisymmetric"}
    return section.rotated(-np.pi / 2).moved((on_S, 0.0)), bodies | loads


def glued_hub(h: float) -> Problem:
    """A hollow shaft, fixed inside, glued into a hub that is pushed down on its upper half.

    Args:
        h: cell size, mm.

    Returns:
        The joint, and the arguments of its `Structure`.
    """
    tractions = {"OUTSIDE": lambda x, t: (0.0, -ufl.conditional(x[1] > 0, 10.0 * x[1] / HUB_RADII[2], 0.0))}
    joint, bodies = ring(*HUB_RADII, h=h, cell="quadrilateral", degree=2), {"INNER": STEEL, "OUTER": ALUMINIUM}
    return joint, {"body": bodies, "supports": {"INSIDE": 0.0}, "tractions": tractions}


def rods(sizes: tuple[float, float]) -> Problem:
    """Two cylinders, glued end to end, under tension and bending, in 3D.

    Args:
        sizes: sizes of cells inside and on S, mm.

    Returns:
        The joint, and the arguments of its `Structure`.
    """
    tractions = {"TOP": lambda x, t: (0.0, ROD_STRESS + ROD_BENDING * x[0] / ROD_RADIUS, 0.0)}
    joint = disc(ROD_RADIUS, ROD_HEIGHT, ROD_HEIGHT, sizes[0], h_S=sizes[1], cell="hexahedron", degree=2)
    return joint, {"body": STEEL, "supports": {"BOTTOM": 0.0}, "tractions": tractions}


def arch(element: str) -> Problem:
    """An arch of five stones, from a mesh file, under their weight and a load that is larger on the right half.

    The four joints between the stones are one seam.

    Args:
        element: finite element of the displacements, as "P2".

    Returns:
        The joint, and the arguments of its `Structure`.
    """
    tractions = {"EXTRADOS": lambda x, t: (0.0, ufl.conditional(x[0] > 0, -0.4, -0.1))}
    setup: StructureArguments = {"body": STONE, "tractions": tractions, "body_force": ARCH_WEIGHT, "element": element}
    setup["supports"] = {"SPRINGINGS": 0.0}
    return read(examples.arch(), S="JOINTS", lower="ODD STONES", upper="EVEN STONES"), setup


def is_inside_joints(x: Array) -> BoolArray:
    """Return a mask of the points in the middle two thirds of the arch's joints, away from their ends.

    `x` are coordinates of points of S, m, with the components on the first axis; the mask has the shape of x[0].
    """
    return np.asarray(abs(np.sqrt(x[0] ** 2 + x[1] ** 2) - ARCH_RADIUS) < MIDDLE)


def mean_on_side(state: State, name: str, f: Expr) -> float:
    """Return the mean in `state` of `f`, a UFL scalar on the mesh, over the facet set `name` of the outer boundary."""
    ds_side = state.model.ds(state.model.domain.values(name))
    return state.integral(f * ds_side) / state.integral(1.0 * ds_side)


def phases_on_s(state: State) -> tuple[Array, Array]:
    """Return the x (n,) of the midpoints of the n facets of S, in ascending order, and the layer's phases (n,) there.

    A phase is -1, 0 or 1, or between them in a mixture. `state` is a state of a model with one such layer.
    """
    surface = Surface(state.model)
    x, phase = surface.x[0].mean(axis=1), surface.phase(state)[:, 0]
    return np.sort(x), phase[np.argsort(x)]
