"""Homogenised stiffness of a periodic cell."""

from __future__ import annotations

import numpy as np

from forms.base import Array, InputError
from forms.kinematics import PLANE_STRAIN
from geometry.parallel import default_comm
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.prescribed_strains import VOIGT_PAIRS_OF_DIM, MeanTensorInput
from thinlayer.discretisation.time_functions import piecewise
from thinlayer.errors import SolveError
from thinlayer.solving.solve import Solver
from thinlayer.system.ranks import errors_on_all

# difference of the stiffness from its transpose, over its size, above which a law or a solve must be wrong
ASYMMETRY_TOLERANCE = 1e-8
ASYMMETRY_ROUNDING_RATIO = 1e-12  # the same over the stiffness of the bodies, whose strains have rounding errors


def homogenised_stiffness(model: Model) -> Array:
    """Compute the stiffness matrix of a periodic cell, from mean strains to mean stresses. Collective.

    It needs one factorisation of the tangent, and one solve for each of the k components of the mean strain.

    Args:
        model: a model of a periodic joint, with linear laws and supports that do not move. Its loads, its eigenstrains
            and its prescribed mean strain are ignored.

    Returns:
        (k, k) stiffness, in units of stress. Components have the order of `Anisotropic`: 11, 22, 12 in 2D (k = 3); 11,
        22, 33, 23, 13, 12 in 3D (k = 6). A column is the mean stress if one component of the mean strain is 1 and the
        others vanish. Shear strains are angles: the columns of 12 have e_12 = e_21 = 1/2. If the cell is periodic only
        in some directions and its other sides are free, rows and columns of the other directions vanish.

    Raises:
        InputError: the joint is not periodic; a law is not linear or has stresses without strains; a layer has an
            interface law of order 1; supports move.
        SolveError: the solution is not unique; the stiffness of symmetric laws is not symmetric.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import bond_cell
        >>> from thinlayer import Structure, ThinLayer, homogenised_stiffness
        >>> brick = LinearElastic.young(E=10e3, nu=0.2)
        >>> mortar = LinearElastic.young(E=500.0, nu=0.2)
        >>> no_strain = ((0, 0), (0, 0))
        >>> joint = bond_cell((4, 2), h=1)
        >>> cell = Structure(joint, body=brick, supports={}, strain=no_strain)
        >>> model = cell.interface(ThinLayer(mortar, eps=0.1))
        >>> print(homogenised_stiffness(model).round(-1) + 0)
        [[7540.  970.    0.]
         [ 970. 5500.    0.]
         [   0.    0. 1800.]]
    """
    with errors_on_all(model.comm if isinstance(model, Model) else default_comm()):
        _require_linear_periodic(model)
    with Solver(model.under_mean_strain(_make_unit_strain_function(model.joint.dim))) as solver:
        times = map(float, range(len(VOIGT_PAIRS_OF_DIM[model.joint.dim])))
        stresses = [solver.step(solver.rest_state(t), t).mean_stress() for t in times]
    stiffness = np.column_stack([[stress[pair] for pair in VOIGT_PAIRS_OF_DIM[len(stress)]] for stress in stresses])
    asymmetry, norm = float(np.abs(stiffness - stiffness.T).max()), float(np.abs(stiffness).max())
    body_norm = max(np.abs(C).max() for C in model.structure.extreme_body_tangents if C is not None)
    if model.symmetric and asymmetry > ASYMMETRY_TOLERANCE * norm + ASYMMETRY_ROUNDING_RATIO * body_norm:
        raise SolveError(f"the homogenised stiffness is not symmetric: entries of {norm:.1e} differ by {asymmetry:.1e}")
    return stiffness


def _require_linear_periodic(model: Model) -> None:
    if not isinstance(model, Model) or model.joint.periods is None:
        raise InputError(f"homogenised_stiffness needs a model of a periodic joint (geometry.periodic), not {model!r}")
    model.kinematics.require(PLANE_STRAIN.unknown, "homogenised_stiffness")
    if not model.kinematics.has_rigid_rotations:
        raise InputError(f"homogenised_stiffness, plane={model.plane!r}: a body of revolution has no mean strain")
    model.require("mean strain")
    for law in (p.law for p in model.terms if not p.law.traits.proportional):
        remedy = "march under Structure(..., strain=...), and take State.mean_stress"
        raise InputError(f"{law!r} is not linear, or has stresses without strains; {remedy}")
    if not model.linear:
        raise InputError("the model is not linear; homogenised_stiffness needs linear laws and parts")
    if moving_places := model.supports.moving_places:
        raise InputError(f"the support on {moving_places[0]!r} moves; homogenised_stiffness needs supports at rest")


def _make_unit_strain_function(d: int) -> MeanTensorInput:
    """Return a function of (x, t), whose value at the time t = k is the unit strain of the column k of the stiffness.

    It is a mean strain (d, d) in d = 2 or 3 dimensions, the same at all places x. Columns, from 0, and their unit
    strains are those of `homogenised_stiffness`.
    """
    axes = np.eye(d)
    unit_strains = [(np.outer(axes[i], axes[j]) + np.outer(axes[j], axes[i])) / 2 for i, j in VOIGT_PAIRS_OF_DIM[d]]
    interpolant = piecewise({float(k): strain.ravel().tolist() for k, strain in enumerate(unit_strains)})
    return lambda x, t: np.reshape(interpolant(x, t), (d, d)).tolist()
