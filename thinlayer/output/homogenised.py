"""Homogenised stiffness or conductivity of a periodic cell."""

from __future__ import annotations

import numpy as np

from forms.base import Array, InputError
from forms.kinematics import Kinematics, ScalarField
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
    return _homogenised(model, "homogenised_stiffness", Kinematics.unknown)


def homogenised_conductivity(model: Model) -> Array:
    """Compute the conductivity matrix (d, d) of a periodic cell, from mean gradients to mean fluxes. Collective.

    It needs one factorisation of the tangent, and one solve for each of the d directions. Conducting layers on S need
    order 1: at order 0 the flux along them is missing.

    Args:
        model: a model of a periodic joint with a scalar field, linear laws, and supports that do not move. Its loads
            and its prescribed mean gradient are ignored.

    Returns:
        (d, d) conductivity. A column is the mean flux if one component of the mean gradient is 1 and the others vanish.

    Raises:
        InputError: the joint is not periodic; a law is not linear; supports move.
        SolveError: the solution is not unique; the conductivity of symmetric laws is not symmetric.

    Example:
        >>> from forms import Conduction
        >>> from geometry import bond_cell
        >>> from thinlayer import Structure, ThinLayer, homogenised_conductivity
        >>> joint = bond_cell((0.25, 0.125), h=1 / 32)  # m
        >>> cell = Structure(joint, body=Conduction(k=0.6), supports={}, gradient=(0, 0))
        >>> mortar = ThinLayer(Conduction(k=0.2), eps=0.01)
        >>> print(homogenised_conductivity(cell.interface(mortar)).round(3) + 0)
        [[0.557 0.   ]
         [0.    0.489]]
    """
    return _homogenised(model, "homogenised_conductivity", ScalarField.unknown)


def _homogenised(model: Model, name: str, unknown: str) -> Array:
    """Return the stiffness or conductivity matrix of a periodic cell; `name` is that of the user's call, for messages.

    `unknown` is the unknown that the model must have, see `Kinematics.unknown`.
    """
    with errors_on_all(model.comm if isinstance(model, Model) else default_comm()):
        _require_linear_periodic(model, name, unknown)
    d = model.joint.dim
    pairs = tuple((i,) for i in range(d)) if unknown == ScalarField.unknown else VOIGT_PAIRS_OF_DIM[d]
    with Solver(model.under_mean_strain(_make_unit_strain_function(d, pairs))) as solver:
        stresses = [solver.step(solver.rest_state(t), t).mean_stress() for t in map(float, range(len(pairs)))]
    stiffness = np.column_stack([[stress[pair] for pair in pairs] for stress in stresses])
    asymmetry, norm = float(np.abs(stiffness - stiffness.T).max()), float(np.abs(stiffness).max())
    body_norm = max(np.abs(C).max() for C in model.structure.extreme_body_tangents if C is not None)
    if model.symmetric and asymmetry > ASYMMETRY_TOLERANCE * norm + ASYMMETRY_ROUNDING_RATIO * body_norm:
        raise SolveError(f"{name}: the result is not symmetric: entries of {norm:.1e} differ by {asymmetry:.1e}")
    return stiffness


def _require_linear_periodic(model: Model, name: str, unknown: str) -> None:
    if not isinstance(model, Model) or model.joint.periods is None:
        raise InputError(f"{name} needs a model of a periodic joint (geometry.periodic), not {model!r}")
    model.kinematics.require(unknown, name)
    if model.kinematics.has_axis:
        raise InputError(f"{name}, plane={model.plane!r}: a body of revolution has no mean strain")
    model.require("mean strain")
    for law in (p.law for p in model.terms if not p.law.traits.proportional):
        remedy = "march under Structure(..., strain=...), and take State.mean_stress"
        raise InputError(f"{law!r} is not linear, or has stresses without strains; {remedy}")
    if not model.linear:
        raise InputError(f"the model is not linear; {name} needs linear laws and parts")
    if moving_places := model.supports.moving_places:
        raise InputError(f"the support on {moving_places[0]!r} moves; {name} needs supports at rest")


def _make_unit_strain_function(d: int, pairs: tuple[tuple[int, ...], ...]) -> MeanTensorInput:
    """Return a function of (x, t), whose value at the time t = k is the unit strain of the column k of the stiffness.

    It is a mean strain (d, d) in d = 2 or 3 dimensions, or a mean gradient (d,), the same at all places x. Columns,
    from 0, and their unit strains are those of `homogenised_stiffness`; `pairs` are the indices of their components.
    """
    unit_strains = np.zeros((len(pairs), *(d,) * len(pairs[0])))
    for unit, pair in zip(unit_strains, pairs, strict=True):
        unit[pair] += 0.5
        unit[pair[::-1]] += 0.5
    interpolant = piecewise({float(k): strain.ravel().tolist() for k, strain in enumerate(unit_strains)})
    return lambda x, t: np.reshape(interpolant(x, t), unit_strains.shape[1:]).tolist()
