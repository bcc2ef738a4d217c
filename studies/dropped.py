"""Cases of the study `may_i_drop`: structures with thin layers, published for another program, or chosen here.

Authors of another program have published results for some of these cases, without all the data. The missing data are
chosen here: the layer's modulus and the load on unequal bodies with nu = 0.45, the load on the bearing, and the
coefficient of the law `CubicHardening`. Also chosen are the strength and hardening of the plastic layer, and the moduli
and heights of the box in 3D.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import pi
from typing import ClassVar

import numpy as np
import ufl

from forms import (
    Anisotropic,
    BulkLaw,
    KelvinVoigt,
    LinearElastic,
    Maxwell,
    MohrCoulomb,
    Norton,
    Rubber,
    Stack,
    VonMises,
)
from forms.elastic import lame_stress
from forms.law import Step
from forms.tensors import Expr
from forms.viscous import isotropic_energy
from geometry import block, faults, ring, sandwich
from studies.problems import (
    FOURIER_BODY,
    SUPPORTS,
    Heights,
    LayerOfThickness,
    fourier,
    free_blocks,
    layer_fn,
    top_loaded,
)
from thinlayer import (
    RangeWarning,
    RigidPlate,
    Springs,
    Structure,
    ThinLayer,
    goals,
)
from thinlayer.discretisation.coefficient import LoadInput
from thinlayer.discretisation.supports import Place, Support

THICK, THIN = 1 / 16, 1 / 64  # thicknesses
H_S, CELLS_AT_ENDS = 1 / 24, 8  # cell size on S; cells within a thickness at free ends
TILT_ANGLE = 0.5  # rad
WIDTH, DEPTH = 1.3, 0.8
CLAMPED: dict[Place, Support] = {"BOTTOM": 0.0}
young, shear = LinearElastic.young, LinearElastic.shear
STEEL, SOFT_BODY = young(E=1e4, nu=0.3), young(E=70.0, nu=0.3)


# ---------------------------------------------------------------- structures; `_`: the mesh suits any thickness
# fmt: off
def roller_blocks(_: float) -> Structure:
    """Make a structure of two blocks between rollers, under a traction with one half-wave.

    The argument, the layer's thickness, is not used, as the mesh suits all thicknesses.
    """
    joint, setup = fourier(1 / 16, cell="quadrilateral")
    return Structure(joint, **setup)


def box_3d(_: float) -> Structure:
    """Make a structure of two blocks in 3D between rollers on four sides, under wavy tractions on top.

    The tractions have half a wave along x and a full wave along z. The argument, the layer's thickness, is not used.
    """
    joint = sandwich(1.0, 0.5, 0.5, 1 / 8, depth=0.5, cell="hexahedron", structured=True)
    k1, k3, k = pi, 2 * pi, (pi**2 + (2 * pi) ** 2) ** 0.5

    def top(x: Expr, t: Expr) -> tuple[Expr, ...]:
        (s1, c1), (s3, c3) = ((ufl.sin(a * x[i]), ufl.cos(a * x[i])) for a, i in ((k1, 0), (k3, 2)))
        return 0.5 * k1 / k * s1 * c3, c1 * c3, 0.5 * k3 / k * c1 * s3

    return top_loaded(joint, top, supports=SUPPORTS | {"BACK": {"z": 0.0}, "FRONT": {"z": 0.0}})


def _h_ends(eps: float) -> float:
    return min(eps / CELLS_AT_ENDS, H_S)


def free_pair(
    eps: float, load: LoadInput = (0.3, -1.0), heights: Heights = (0.5, 0.5), *,
    lower: LinearElastic = FOURIER_BODY, upper: LinearElastic = FOURIER_BODY, plane: str = "strain",
) -> Structure:
    """Make a structure of two blocks, 1 wide, with free sides, clamped below, under a traction on top.

    Args:
        eps: thickness of the layer; cells at the free ends of S are 8 times smaller.
        load: the traction.
        heights: heights of the lower and the upper block.
        lower, upper: laws of the blocks.
        plane: "strain", "stress" or "axisymmetric".
    """
    return free_blocks(_h_ends(eps), load, heights, h_S=H_S, body={"LOWER": lower, "UPPER": upper}, plane=plane)


def displaced(eps: float) -> Structure:
    """Make a structure of two stiff blocks with free sides, the upper one pressed down by 0.01.

    The cells at the free ends of S are 8 times smaller than the layer's thickness `eps`.
    """
    return free_blocks(_h_ends(eps), h_S=H_S, body=STEEL, supports=CLAMPED | {"TOP": {"x": 0.0, "y": -0.01}}, tractions={})


def tilted_blocks(eps: float) -> Structure:
    """Make a structure of two blocks with free sides, rotated by 0.5 rad, under a traction that is not rotated.

    The blocks have unequal heights. The cells at the free ends of S are 8 times smaller than the layer's thickness
    `eps`.
    """
    joint = sandwich(1.0, 0.4, 0.7, 1 / 8, h_S=H_S, h_ends=_h_ends(eps), cell="quadrilateral")
    return top_loaded(joint.rotated(TILT_ANGLE), (-0.7, 0.4), body=young(E=150.0, nu=0.2))


def channel(_: float) -> Structure:
    """Make a structure of two unequal blocks between rollers, under a traction that is quadratic in x.

    The argument, the layer's thickness, is not used, as the mesh suits all thicknesses.
    """
    joint = sandwich(WIDTH, 0.4, 0.6, 1 / 16, cell="quadrilateral", structured=True)
    body = {"LOWER": young(E=120.0, nu=0.25), "UPPER": young(E=80.0, nu=0.35)}
    return top_loaded(joint, lambda x, t: (x[0] * (WIDTH - x[0]), x[0] ** 2 - 0.3), body=body, supports=SUPPORTS)


def rings(_: float) -> Structure:
    """Make a structure of a ring in another ring, fixed inside, and pushed down on the upper half of its outside.

    The argument, the layer's thickness, is not used, as the mesh suits all thicknesses.
    """
    joint = ring(1.0, 1.5, 2.2, 1 / 6, h_S=1 / 12, cell="quadrilateral", degree=2)
    body = {"INNER": young(E=200.0, nu=0.3), "OUTER": young(E=70.0, nu=0.33)}
    loads = {"OUTSIDE": lambda x, t: (0.0, -ufl.conditional(x[1] > 0, x[1], 0.0))}
    return Structure(joint, body=body, supports={"INSIDE": 0.0}, tractions=loads)


def block_on_base(eps: float) -> Structure:
    """Make a structure of a block with free sides, pressed and sheared on a rigid base.

    The cells at the free ends of S are 8 times smaller than the layer's thickness `eps`.
    """
    joint = block(1.0, 0.6, 1 / 8, h_S=H_S, h_ends=_h_ends(eps), cell="quadrilateral")
    return top_loaded(joint, lambda x, t: (0.4, -0.5 - x[0]), body=young(E=90.0, nu=0.2), supports={})


def stacked_tubes(_: float) -> Structure:
    """Make a structure of two tubes, one on top of the other, between smooth walls.

    It is an axisymmetric section from r = 0.4 to 1.4. The argument, the layer's thickness, is not used, as the mesh
    suits all thicknesses.
    """
    joint = sandwich(1.0, 0.5, 0.5, 1 / 12, cell="quadrilateral", structured=True).moved((0.4, 0.0))
    body = young(E=100.0, nu=0.25)
    return top_loaded(joint, lambda x, t: (0.0, 1 - x[0] ** 2), body=body, supports=SUPPORTS, plane="axisymmetric")


def stacked_discs(eps: float) -> Structure:
    """Make a structure of two discs, one on top of the other, pressed most at the axis.

    It is an axisymmetric section from r = 0 to 1. The cells at the free end of S are 8 times smaller than the layer's
    thickness `eps`.
    """
    return free_blocks(_h_ends(eps), lambda x, t: (0.0, x[0] ** 2 - 1), h_S=H_S, plane="axisymmetric")


def plated_blocks(eps: float) -> Structure:
    """Make a structure of two blocks with free sides: springs support the lower one, a rigid plate loads the upper one.

    The plate may rotate. The cells at the free ends of S are 8 times smaller than the layer's thickness `eps`.
    """
    parts = [Springs("BOTTOM", normal=300.0, tangential=200.0), RigidPlate("TOP", force=(0.3, -1.0), moment=0.1)]
    return free_blocks(_h_ends(eps), h_S=H_S, supports={}, tractions={}, parts=parts)


def two_seams(eps: float) -> Structure:
    """Make a structure of three blocks with free sides, on top of each other, with the seams "LOW" and "HIGH".

    The cells at the free ends of S are 8 times smaller than the thickness `eps` of the layer on "LOW".
    """
    cuts = {"LOW": ((-0.1, 0.4), (1.1, 0.4)), "HIGH": ((-0.1, 0.8), (1.1, 0.8))}
    return top_loaded(faults(1.0, 1.2, cuts, 1 / 8, h_S=H_S, h_ends=_h_ends(eps)), (0.3, -1.0))


def heated_blocks(eps: float) -> Structure:
    """Make a structure of two blocks with free sides, whose upper block has an isotropic eigenstrain of 0.01.

    The cells at the free ends of S are 8 times smaller than the layer's thickness `eps`.
    """
    body = {"LOWER": FOURIER_BODY, "UPPER": young(E=80.0, nu=0.2)}
    return free_blocks(_h_ends(eps), h_S=H_S, body=body, tractions={}, eigenstrain={"UPPER": 0.01})


def plate_corner(eps: float) -> Structure:
    """Make a structure of a quarter of two plates in 3D, pressed and sheared.

    Two free sides of the plates meet at a corner. The cells at the free ends of S are 3 times smaller than the layer's
    thickness `eps`.
    """
    joint = sandwich(1.0, 0.5, 0.5, 1 / 4, depth=DEPTH, h_S=1 / 6, h_ends=eps / 3, cell="hexahedron")
    supports = CLAMPED | {"LEFT": {"x": 0.0}, "BACK": {"z": 0.0}}
    return top_loaded(joint, lambda x, t: (0.2 * x[0], -1.0 + 0.5 * x[2], 0.1), supports=supports)


# ---------------------------------------------------------------- cases
@dataclass(frozen=True)
class DroppedCase:
    """A structure with thin layers, for which the study estimates the error of replacing the layers by interface laws.

    Attributes:
        name: name of the case: its group, a colon and a few words, as "free ends: thin bodies".
        make_structure: function of the thickness that returns the structure, with a mesh fine enough for such a layer.
        make_layers: function of the thickness that returns the layers; their interface laws have order 0.
        bodies: bodies of both models: "kept" (a meshed layer moves them apart) or "extended" (it is cut out of them).
        dt: length of the only time step, from rest; 0: a static solve.
        qois: goals (quantities of interest) whose change is estimated, in addition to traction and jump on S.
        is_3d: whether the structure is in 3D.
    """

    name: str
    make_structure: Callable[[float], Structure]
    make_layers: Callable[[float], ThinLayer | dict[str, ThinLayer]]
    bodies: str = "kept"
    dt: float = 0.0
    qois: tuple[goals.Goal, ...] = (goals.Compliance(),)
    is_3d: bool = False


def ignore_range_warnings() -> warnings.catch_warnings[None]:
    """Return a context manager that hides warnings about laws used outside their range of validity.

    The study hides them because it estimates just the errors of which they warn.
    """
    return warnings.catch_warnings(action="ignore", category=RangeWarning)


# ---------------------------------------------------------------- cases of another program
BEARING_LAW = Rubber.shear(0.01, 0.4999)  # moduli at any thickness
VISCOUS_LAW = Norton(lmbda=60.0, mu=40.0, eta=5.0, p=1.5)
TIME_STEP = 0.01


@dataclass(frozen=True)
class CubicHardening(BulkLaw):
    """Isotropic elastic law whose stress grows faster than the strain e: Hooke's stress plus c (e:e) e.

    Attributes:
        lmbda, mu: Lamé's moduli, a stress.
        c: coefficient of the additional stress, a stress.
    """

    lmbda: float
    mu: float
    c: float
    powers: ClassVar = {"lmbda": 1, "mu": 1, "c": 3}

    def stress(self, step: Step) -> Expr:
        """Return the stress (3, 3) at the strain `step.e` of a time step."""
        return lame_stress(self.lmbda, self.mu, step.e) + self.c * ufl.inner(step.e, step.e) * step.e

    def energy(self, step: Step) -> Expr:
        """Return the elastic energy per volume at the strain `step.e` of a time step."""
        return isotropic_energy(self.lmbda, self.mu, step.e) + self.c / 4 * ufl.inner(step.e, step.e) ** 2


def soft_layer_fn(mu: float, nu: float) -> LayerOfThickness:
    """Return a function from the thickness to an elastic layer whose moduli are proportional to the thickness.

    Args:
        mu: shear modulus divided by the thickness: the tangential stiffness of the interface law.
        nu: Poisson's ratio.
    """
    return layer_fn(LinearElastic.shear(mu, nu))


def published_cases() -> list[DroppedCase]:
    """Return each `DroppedCase` for which authors published results of another program that estimates such errors."""
    work, up, R, displacement = goals.Compliance(), (0.0, 1.0), Rubber.shear, goals.Displacement((0.3, 0.4), (0.6, 0.8))
    roller_case = partial(DroppedCase, make_structure=roller_blocks, qois=(work, goals.Displacement((0.3, 0.4), up)))
    end_case = partial(DroppedCase, make_structure=free_pair, qois=(work, displacement))
    unequal_case = partial(end_case, make_structure=partial(free_pair, load=(1.0, 0.0), lower=SOFT_BODY))
    steel_case = partial(end_case, make_structure=partial(free_pair, lower=STEEL, upper=STEEL))
    pressed_case = partial(end_case, make_structure=displaced, qois=(goals.Reaction("TOP", up), goals.MeanTraction(up)))
    hard_fn, plastic_fn = layer_fn(CubicHardening(60.0, 40.0, 3e5)), layer_fn(YIELDING_LAW)
    bearing_fn, viscous_fn = layer_fn(BEARING_LAW, None), layer_fn(VISCOUS_LAW)
    box_case = partial(DroppedCase, make_structure=box_3d, is_3d=True)

    roller_layers = {
        "nu = 0.3": soft_layer_fn(40.0, 0.3), "nu = 0.45": layer_fn(R(4.0, 0.45)), "nu = 0.499": soft_layer_fn(40.0, 0.499),
        "nu = 0.4999": soft_layer_fn(0.4, 0.4999), "cubic hardening": hard_fn, "plastic": plastic_fn,
    }
    return [
        *(roller_case(f"between rollers: {suffix}", make_layers=make) for suffix, make in roller_layers.items()),
        end_case("free ends: nu = 0.3", make_layers=soft_layer_fn(40.0, 0.3)),
        unequal_case("free ends: unequal bodies, nu = 0.45", make_layers=soft_layer_fn(20.0, 0.45)),
        end_case("free ends: nu = 0.45", make_layers=layer_fn(R(40.0, 0.45))),
        end_case("free ends: nu = 0.499", make_layers=soft_layer_fn(40.0, 0.499)),
        steel_case("free ends: bearing, loaded", make_layers=bearing_fn),
        pressed_case("free ends: bearing, displaced", make_layers=bearing_fn),
        roller_case("laws: Norton", make_layers=viscous_fn, dt=TIME_STEP),
        end_case("laws: Norton, free ends", make_layers=viscous_fn, dt=TIME_STEP),
        box_case("shapes: box in 3D, nu = 0.35", make_layers=layer_fn(R(40.0, 0.35))),
        box_case("shapes: box in 3D, nu = 0.49", make_layers=soft_layer_fn(40.0, 0.49)),
    ]


SUBLAYERS = Stack((0.3, LinearElastic(60.0, 40.0)), (0.7, LinearElastic(600.0, 20.0)))
YIELDING_LAW = VonMises(60.0, 40.0, 0.3, hardening=100.0)
SLIPPING_LAW = MohrCoulomb(60.0, 40.0, cohesion=0.15, friction_angle=30.0, dilatancy_angle=10.0)
STIFF_NORTON = Norton(lmbda=450.0, mu=300.0, eta=50.0, p=1.5)
CREEPING_LAW = Norton(lmbda=50.0, mu=30.0, eta=1500.0, p=3.0)


HARD_PLY, SOFT_PLY = shear(400.0, 0.3), shear(4.0, 0.3)  # plies
FIBRE_LAW = Anisotropic(np.diag([200.0, 60.0, 90.0, 25.0, 30.0, 40.0]) + 20.0 * np.eye(6)[[1, 0, 2, 3, 4, 5]], "layer")


def _plied_layer_fn(*laws: BulkLaw) -> LayerOfThickness:
    """Return a function from the thickness to a layer of equally thick plies.

    `laws` are the laws of the plies, the lowest ply first.
    """
    return layer_fn(Stack(*((1 / len(laws), law) for law in laws)))


def further_cases() -> list[DroppedCase]:
    """Return the cases that were chosen for this study, in addition to those of `published_cases`."""
    work, displacement = goals.Compliance(), goals.Displacement((0.3, 0.35), (0.6, 0.8))
    end_goals, mid_goals = (work, displacement), (work, displacement, goals.MeanTraction((1.0, 0.0)))
    unlike_pair = partial(free_pair, load=(-0.6, 0.4), heights=(0.4, 0.7), lower=young(50.0, 0.2), upper=young(200.0, 0.35))
    sheet_blocks = partial(free_pair, load=(0.5, -0.6), plane="stress")
    steel_pair = partial(free_pair, load=(0.0, -1.0), lower=STEEL, upper=STEEL)

    def thin_blocks(eps: float) -> Structure:
        return free_pair(eps, heights=(2 * eps, 3 * eps))

    return [
        DroppedCase("free ends: two stiffnesses", unlike_pair, soft_layer_fn(15.0, 0.35), qois=end_goals),
        DroppedCase("shapes: tilted S", tilted_blocks, soft_layer_fn(30.0, 0.25)),
        DroppedCase("shapes: rigid base", block_on_base, soft_layer_fn(25.0, 0.3), qois=end_goals),
        DroppedCase("shapes: plane stress", sheet_blocks, soft_layer_fn(30.0, 0.3), qois=end_goals),
        DroppedCase("shapes: springs and a plate", plated_blocks, soft_layer_fn(30.0, 0.3), qois=end_goals),
        DroppedCase("shapes: two seams", two_seams,
            lambda e: {"LOW": soft_layer_fn(30.0, 0.3)(e), "HIGH": soft_layer_fn(10.0, 0.2)(e / 2)}),
        DroppedCase("free ends: a body expands", heated_blocks, soft_layer_fn(30.0, 0.3), qois=(displacement,)),
        DroppedCase("free ends: fixed moduli", free_pair, layer_fn(young(3.0, 0.35), None), qois=end_goals),
        DroppedCase("laws: plastic in time, free ends", free_pair, layer_fn(YIELDING_LAW), dt=TIME_STEP, qois=end_goals),
        DroppedCase("laws: slips, free ends", free_pair, layer_fn(SLIPPING_LAW), qois=end_goals),
        DroppedCase("laws: as stiff as bodies, creeps", free_pair, layer_fn(STIFF_NORTON), dt=TIME_STEP, qois=end_goals),
        DroppedCase("laws: plastic, free ends", free_pair, layer_fn(YIELDING_LAW), qois=end_goals),
        DroppedCase("laws: sublayers", channel, layer_fn(SUBLAYERS), qois=mid_goals),
        DroppedCase("laws: plies, hard outside", steel_pair, _plied_layer_fn(HARD_PLY, SOFT_PLY, HARD_PLY)),
        DroppedCase("laws: plies, hard inside", steel_pair, _plied_layer_fn(SOFT_PLY, HARD_PLY, SOFT_PLY)),
        DroppedCase("laws: fibres, pressed", steel_pair, layer_fn(FIBRE_LAW)),
        DroppedCase("free ends: thin bodies", thin_blocks, soft_layer_fn(40.0, 0.3), qois=end_goals[:1]),
        DroppedCase("between rollers: rubber", channel, layer_fn(Rubber.shear(20.0, 0.49)), qois=mid_goals),
        DroppedCase("laws: Norton, p = 3", channel, layer_fn(CREEPING_LAW), dt=0.02, qois=mid_goals),
        DroppedCase("laws: Kelvin-Voigt", channel, layer_fn(KelvinVoigt(60.0, 40.0, 0.3, 0.5)), dt=0.2, qois=mid_goals),
        DroppedCase("laws: Maxwell", channel, layer_fn(Maxwell(60.0, 40.0, 0.7, 1.5)), dt=0.5, qois=mid_goals),
        DroppedCase("shapes: rings", rings, layer_fn(LinearElastic(60.0, 40.0)), bodies="extended"),
        DroppedCase("shapes: tubes", stacked_tubes, soft_layer_fn(30.0, 0.35)),
        DroppedCase("shapes: disc", stacked_discs, soft_layer_fn(30.0, 0.3)),
        DroppedCase("shapes: corner in 3D", plate_corner, soft_layer_fn(30.0, 0.3), is_3d=True),
    ]
# fmt: on
