"""Frequencies of interface models: their derivatives by parameters, and how the meshed layer changes them.

Let K and M be the matrices of the structure with meshed layers, with the cells of the bodies. Displacements x of it are
those of a mode in the bodies, and in the layers what their faces cause. The n least Ritz values, of the quotient
x.Kx / x.Mx on a space of such displacements, are at least the n least values of omega^2 (Poincare).

A Ritz vector with x.Mx = 1 and the value rho has the residual r = Kx - rho M x. With omega_j, the frequencies of the
structure with meshed layers, and a stress in equilibrium with r, whose energy norm is g,

    min_j (omega_j^2 - rho)^2 / omega_j^2  <=  r.K^-1 r  <=  g^2,

the first by expansion in modes (Weinstein), the second by Castigliano's principle. So one of the frequencies is within
(rho + g^2/4)^(1/2) -+ g/2. Stresses in equilibrium are those of `GlobalLocal`. Displacements that they cause extend the
space, as in the method of conjugate gradients of blocks (Knyazev 2001) with the interface model as preconditioner.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse
from petsc4py import PETSc

from forms.base import Array, InputError, is_finite, require
from geometry.seam import S
from thinlayer.discretisation.constraints import local_csr
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.estimating.derivative import LayerOfFactor, changed_model, chosen_changes
from thinlayer.estimating.estimate import GOAL_ROUNDING, checked_seams, order_1_layer, require_subproblem
from thinlayer.estimating.global_local import DEFAULT_WIDTH, MAX_ITERATIONS, GlobalLocal
from thinlayer.estimating.parameters import FACTORS, STEP
from thinlayer.parts.inertia import Inertia
from thinlayer.solving.adjoint import Adjoint
from thinlayer.solving.layer_subproblem import LayerSubproblem
from thinlayer.solving.modes import Modes, Pencil, mode_table, multiply
from thinlayer.system.progress import report
from thinlayer.system.table import Table

DEPENDENT_SQUARE = 1e-12  # squared norm of a vector besides others, over its squared norm, that is rounding
MULTIPLE_GAP = 1e-4  # least distance of omega^2 from others, over omega^2, of a mode that has a derivative


@report("frequency derivatives")
def frequency_derivatives(
    natural_modes: Modes, parameters: Sequence[str], *, of: Mapping[str, LayerOfFactor] | None = None
) -> dict[str, Array]:
    """Compute the derivatives of natural frequencies by parameters of layers and bodies. Collective.

    For each parameter two stiffness and mass matrices are made, and no mode is computed again. Their central differences
    have a relative error of about 1e-8, up to 1e-6 for nu.

    Args:
        natural_modes: modes of an interface model.
        parameters: names of parameters, such as "S.E", "S.eps", "LOWER.density".
        of: name -> names of parameters that change together, or a function of a factor, as in `derivative`.

    Returns:
        Name of a parameter p -> (n,) values p d omega/dp, the change of each frequency per relative change of p; 0 for
        rigid motions.

    Raises:
        InputError: no such parameter; a full model; a multiple frequency, which has no derivative.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Inertia, Structure, ThinLayer
        >>> from thinlayer import frequency_derivatives, modes
        >>> joint = sandwich(60, 2, 2, h=2, cell="quadrilateral")
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=5, nu=0.3)
        >>> mass = Inertia({"LOWER": 7.8e-9, "UPPER": 7.8e-9, "S": 1.2e-9})  # t/mm^3
        >>> beam = Structure(joint, body=steel, supports={"LEFT": 0}, parts=[mass])
        >>> lowest = modes(beam.interface(ThinLayer(glue, eps=0.2, order=1)), 2)
        >>> slopes = frequency_derivatives(lowest, ["S.E"])
        >>> [f"{x:.3f}" for x in slopes["S.E"] / lowest.omega]
        ['0.074', '0.016']
    """
    model, omega = _interface_model(natural_modes, "frequency_derivatives"), natural_modes.omega
    if (gap := float(natural_modes.gaps[omega > 0].min(initial=math.inf))) < MULTIPLE_GAP:
        text = f"squared frequencies differ by {gap:.1g} of their size, and a multiple frequency has no derivative"
        raise InputError(f"frequency_derivatives: {text}; model half of a symmetric structure")
    changes, slopes = chosen_changes(model, parameters, of or {}), dict[str, Array]()
    model.family.is_shared = True  # changed models need the same stiffness of the bodies
    for name, change in changes.items():
        pairs = []
        for factor in FACTORS:
            pencil = Pencil(changed_model(model, change, factor))
            pairs.append((pencil.K.copy(), pencil.M.copy()))
            pencil.equations.destroy()  # the next model takes over the bodies' matrices
        (K, M), (K_less, M_less) = pairs
        K.axpy(-1.0, K_less)  # before products, so that entries that do not change leave no rounding
        M.axpy(-1.0, M_less)
        slope = (natural_modes.quotients(K) - omega**2 * natural_modes.quotients(M)) / (2 * STEP)
        slopes[name] = np.where(omega > 0, slope / (2 * np.where(omega > 0, omega, 1.0)), 0.0)
    return slopes


def _interface_model(natural_modes: Modes, what: str) -> InterfaceModel:
    """Return the model of modes, or raise InputError with the function's name `what` if it is no interface model."""
    if not (isinstance(natural_modes, Modes) and isinstance(natural_modes.model, InterfaceModel)):
        raise InputError(f"{what}: give the result of modes for an interface model (structure.interface)")
    return natural_modes.model


@dataclass(frozen=True, eq=False)
class FrequencyEstimate:
    """Frequencies of a structure with meshed layers, estimated from modes of its interface model.

    Attributes:
        omega: (n,) frequencies of the interface model, rad per time.
        better: (n,) estimates of the n lowest frequencies with meshed layers: Ritz values, so that they are upper bounds.
        lower, upper: (n,) bounds of intervals. Each contains a frequency with meshed layers; it is not proved that there
            are no others. They are 0 and infinity where rounding is too large.
    """

    omega: Array
    better: Array
    lower: Array
    upper: Array

    @property
    def table(self) -> Table:
        """A table with a row for each mode, with the relative error of the interface model."""
        return mode_table({**vars(self), "error": self.omega / self.better - 1})


class FrequencyIteration(GlobalLocal):
    """Iteration from modes of an interface model to those of the structure with meshed layers.

    Displacements are pairs of arrays: m values in the bodies, on this rank, and n_layers unknowns of the layers.

    Args:
        adjoint: an interface model, linearised at rest.
        layers: the layers, meshed by themselves.
        inertia: the mass of bodies and layers.
    """

    def __init__(self, adjoint: Adjoint, layers: LayerSubproblem, inertia: Inertia) -> None:
        super().__init__(adjoint, layers)
        self._M_b = inertia.mass_matrix(self.model, [name for name in inertia.density if name not in layers.seams])
        self._M_l = local_csr(inertia.mass_matrix(layers.model, layers.seams)).copy()
        self._M_l.resize(layers.K.shape)  # pressures have no mass

    def layer_displacements(self, u: Array, load: Array) -> Array:
        """Return the layers' unknowns (n_layers,) for displacements `u` (m,) and forces `load` (n_layers,) on layers."""
        return self.layers.dirichlet_displacements(self.layers.to_layers(u), load, np.zeros_like(load))

    def ritz(self, displacements: Sequence[tuple[Array, Array]], n: int) -> tuple[Array, Array, Array]:
        """Return the n least Ritz values (n,) of omega^2, and their Ritz vectors (m, n) and (n_layers, n).

        Args:
            displacements: arrays (m, k) and (n_layers, k) of k displacements each, which span the space.
            n: number of values.
        """
        U, W = (np.hstack(arrays) for arrays in zip(*displacements, strict=True))
        K, M = (self._gram(U, W, A) for A in ((self._K_b, self.layers.K), (self._M_b, self._M_l)))
        scale = 1 / np.sqrt(M.diagonal())
        squares, Y = np.linalg.eigh(scale[:, None] * M * scale)
        is_new = squares > DEPENDENT_SQUARE
        Y = scale[:, None] * Y[:, is_new] / np.sqrt(squares[is_new])
        values, Z = np.linalg.eigh(Y.T @ K @ Y)
        return values[:n], U @ Y @ Z[:, :n], W @ Y @ Z[:, :n]

    def _gram(self, U: Array, W: Array, matrices: tuple[PETSc.Mat, scipy.sparse.csr_matrix]) -> Array:
        gram = self.model.comm.allreduce(U.T @ multiply(matrices[0], U)) + W.T @ (matrices[1] @ W)
        return np.asarray(self.model.comm.bcast((gram + gram.T) / 2), float)

    def corrections(self, values: Array, U: Array, W: Array) -> tuple[Array, Array, Array]:
        """Return displacements (m, k), (n_layers, k) that residuals of k Ritz vectors cause, and bounds of their norms.

        The bounds (k,) are those of the squared norms r.K^-1 r of the residuals r; infinite where rounding is too large.

        Args:
            values: (k,) Ritz values.
            U, W: (m, k) and (n_layers, k) Ritz vectors.
        """
        R = multiply(self._K_b, U) - multiply(self._M_b, U) * values
        R_layers = self.layers.K @ W - (self._M_l @ W) * values
        new_U, new_W, squares = np.empty_like(U), np.empty_like(W), np.empty(len(values))
        zero, dofs = np.zeros(len(W)), np.arange(self.n)
        for k, (r, load) in enumerate(zip(R.T, R_layers.T, strict=True)):
            face_dofs, face_forces = self.layers.to_interface(-self.layers.dirichlet_reactions(zero, load, zero))
            d = self.adjoint.displacements(np.append(dofs, face_dofs), np.append(r, face_forces))
            new_U[:, k], new_W[:, k] = d, self.layer_displacements(d, load)
            balanced = self._with_couples(d, self._face_forces(r - self._resisting_forces(d)), load, zero)
            squares[k] = self._dot(balanced.u, self._resisting_forces(balanced.u))
            resultant, limit = self._resultant_and_limit(balanced)
            squares[k] += self.layers.compliance(balanced.F + load)[1] if resultant <= 2 * limit else math.inf
        return new_U, new_W, squares


@report("estimate_frequencies")
def estimate_frequencies(natural_modes: Modes, *, seam: str = S, width: float = DEFAULT_WIDTH) -> FrequencyEstimate:
    """Estimate frequencies with the layer meshed, from modes with its interface law, and bound them. Collective.

    The layer is meshed by itself, without the bodies. The frequencies are those on the cells of the bodies, as in
    `estimate`, and not those of finer cells.

    Args:
        natural_modes: the lowest modes of an interface model.
        seam: name of the seam whose layer is meshed; all other seams keep their laws. "S": all seams.
        width: the iteration ends when each interval is at most this wide, over the estimated change of its frequency,
            or after five steps.

    Raises:
        InputError: a model as `estimate` refuses it; rigid motions; modes that are not the lowest ones.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Inertia, Structure, ThinLayer, estimate_frequencies, modes
        >>> joint = sandwich(60, 2, 2, h=2, cell="quadrilateral")
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=5, nu=0.3)
        >>> mass = Inertia({"LOWER": 7.8e-9, "UPPER": 7.8e-9, "S": 1.2e-9})  # t/mm^3
        >>> beam = Structure(joint, body=steel, supports={"LEFT": 0}, parts=[mass])
        >>> lowest = modes(beam.interface(ThinLayer(glue, eps=0.2)), 2)  # order 0 warns
        >>> result = estimate_frequencies(lowest)
        >>> [f"{error:.1%}" for error in lowest.omega / result.better - 1]
        ['-1.4%', '-0.3%']
    """
    model, omega = _interface_model(natural_modes, "estimate_frequencies"), natural_modes.omega
    require(is_finite(width) and width > 0, "estimate_frequencies: width", width, "allowed: > 0, over the change")
    if not natural_modes.lowest or not omega[0]:
        reason = "give the lowest modes (near=0), and supports that prevent rigid motions"
        raise InputError(f"estimate_frequencies: {reason}")
    seams, rest = checked_seams(model, (), seam), replace(natural_modes.shapes[0], at_rest=True, sudden=True)
    require_subproblem(model, rest, [model.layers[name] for name in seams])
    laws = {name: order_1_layer(model.applicability[name]) for name in seams}
    layers = LayerSubproblem(model, {name: replace(law, order=0, edges=None) for name, law in laws.items()}, 0.0)
    inertia = next(part for part in model.parts if isinstance(part, Inertia))
    n, rounding = len(omega), GOAL_ROUNDING * omega
    bounds, smallest = np.stack([np.zeros(n), np.full(n, math.inf)]), np.full(n, math.inf)
    with Adjoint(rest) as adjoint:
        iteration = FrequencyIteration(adjoint, layers, inertia)
        U = np.stack([shape.u.x.array[: iteration.n] for shape in natural_modes.shapes], axis=1)
        W = np.stack([iteration.layer_displacements(u, np.zeros(len(layers.load))) for u in U.T], axis=1)
        directions = [(U, W)]
        for _ in range(MAX_ITERATIONS + 1):
            values, U, W = iteration.ritz(directions, n)
            new_U, new_W, squares = iteration.corrections(values, U, W)
            upper = np.sqrt(values + squares / 4) + np.sqrt(squares) / 2
            narrower = squares < smallest
            smallest = np.minimum(squares, smallest)
            bounds = np.where(narrower, [values / upper, upper], bounds)
            if (bounds[1] - bounds[0] <= np.maximum(width * np.abs(np.sqrt(values) - omega), rounding)).all():
                break
            directions = [(U, W), (new_U, new_W)]
    return FrequencyEstimate(omega, np.sqrt(values), np.maximum(bounds[0] - rounding, 0.0), bounds[1] + rounding)
