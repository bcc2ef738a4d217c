"""Rows of the study `rates` for layers with phases: laws, wrong laws for comparison, and checks of phases and snaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import ufl

from forms import NonMonotone, NonMonotoneUnrelaxed, TractionLaw
from forms.base import Array
from forms.tensors import Expr
from forms.traction import JumpStep
from studies.problems import SUPPORTS, Problem, between_rollers, phases_on_s
from thinlayer import Surface
from thinlayer.discretisation.state import State
from thinlayer.discretisation.supports import Support

# chi, in the axes t, n of S
OBLIQUE, SHEARED = np.array([[0.0, 0.3], [0.3, 0.5]]), np.array([[0.0, 0.5], [0.5, 0.0]])
# law; amplitudes of shear and pull on the upper side
CASES: dict[str, tuple[NonMonotone, float, float]] = {
    "": (NonMonotone(60.0, 40.0, alpha=1.0, transformation_energy=0.0031, chi=OBLIQUE), 4.0, 1.0),
    "across": (NonMonotone(60.0, 40.0, alpha=0.7, transformation_energy=0.003, chi=np.diag([0.0, 1.0])), 1.0, 1.2),
    "along": (NonMonotone(60.0, 40.0, alpha=0.3, transformation_energy=0.0004, chi=SHEARED), 4.0, 0.4),
}
PURE_LAW = NonMonotoneUnrelaxed(60.0, 40.0, alpha=0.6, transformation_energy=0.0025, chi=OBLIQUE)


@dataclass(frozen=True)
class JumpPhaseLaw(TractionLaw):
    """Interface law in 2D of a layer of the law `NonMonotone`, with coefficients that may be changed.

    The traction at the jump w = w_T + w_N n is mu w_T + K_N w_N n - phase alpha chi n. The phase is from -1 to 1.

    Attributes:
        mu: stiffness along S, stress per length.
        K_N: stiffness across S, stress per length.
        alpha: transformation stress.
        C: transformation energy per area of S.
        G: coefficient of the energy alpha^2 G that mixtures gain, as in `NonMonotone`.
        chi_12, chi_22: components along S and along n of chi n, where chi is the direction of the transformation.
        minus_factor: 1 if the law has the phase -1; 0 for Eq. (43) of the paper as printed, without this phase.
    """

    mu: float
    K_N: float
    alpha: float
    C: float
    G: float
    chi_12: float
    chi_22: float
    minus_factor: float = 1.0

    @classmethod
    def of(cls, layer: NonMonotone, **changed: float) -> JumpPhaseLaw:
        """Return the interface law of `layer`, with those coefficients replaced that are named in `changed`."""
        parameter_names = {"mu": "mu", "alpha": "alpha", "G": "G", "C": "transformation_energy"}
        coefficients = {name: getattr(layer, parameter) for name, parameter in parameter_names.items()}
        coefficients |= {"K_N": layer.lmbda + 2 * layer.mu, "chi_12": layer.chi[0, 1], "chi_22": layer.chi[1, 1]}
        return cls(**coefficients | changed)

    def traction(self, step: JumpStep) -> Expr:
        """Return the traction (3,) at the jump of a time step, `step.mid`."""
        w, n = step.mid, step.n
        w_N, tangent = ufl.dot(w, n), ufl.as_vector([n[1], -n[0], 0])
        transformation_stress = self.alpha * (self.chi_12 * tangent + self.chi_22 * n)
        m = ufl.dot(transformation_stress, w)
        fraction = ufl.min_value(ufl.max_value((abs(m) - self.C) / (self.alpha**2 * self.G) + 0.5, 0), 1)
        phase = fraction * ufl.conditional(ufl.lt(m, 0), -self.minus_factor, 1)
        return self.mu * (w - w_N * n) + self.K_N * w_N * n - phase * transformation_stress


# wrong laws: lambda + mu as in Eqs. (41)-(42); no phase -1, Eq. (43); laminates only across n, G = 1/(lambda + 2 mu)
PRINTED_LAW, ONE_BRANCH_LAW = JumpPhaseLaw.of(CASES[""][0], K_N=100.0), JumpPhaseLaw.of(CASES[""][0], minus_factor=0.0)
SMALL_GAIN_LAW = JumpPhaseLaw.of(CASES["across"][0], G=1 / 140)


def blocks(h: float, shear: float, pull: float, *, moved: bool = False) -> Problem:
    """Two blocks, 2 wide, 0.5 high, under a sinusoidal load (shear sin(pi x), pull cos(pi x/2)) on top.

    The lower side is clamped, the lateral sides are on rollers. Lengths and stresses have no units.

    Args:
        h: cell size.
        shear, pull: amplitudes of the load on top.
        moved: False: the load is a traction. True: it is a prescribed displacement, proportional to the time.

    Returns:
        The joint, and the arguments of its `Structure`.
    """

    def top(x: Expr, t: Expr) -> tuple[Expr, Expr]:
        factor = t if moved else 1
        return factor * shear * ufl.sin(ufl.pi * x[0]), factor * pull * ufl.cos(ufl.pi * x[0] / 2)

    joint, setup = between_rollers(h, top, width=2.0)
    if moved:
        top_support: Support = {"x": lambda x, t: top(x, t)[0], "y": lambda x, t: top(x, t)[1]}
        setup |= {"tractions": {}, "supports": SUPPORTS | {"TOP": top_support}}
    return joint, setup


def phases_along(state: State, _: Surface) -> dict[str, Array]:
    """Return two columns for a table: "x" (n,) and the layer's "phase" (n,) at the n facets of S in `state`.

    The second argument, the surface S, is not used.
    """
    return dict(zip(("x", "phase"), phases_on_s(state), strict=True))
