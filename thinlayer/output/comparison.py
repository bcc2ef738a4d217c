"""Comparison of an interface law with a meshed layer: differences of traction and jump on S."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from petsc4py import PETSc

from forms.base import Array, InputError, is_finite, require
from geometry.seam import S
from thinlayer.discretisation.full_model import FullModel
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.state import State
from thinlayer.output.surface import Surface
from thinlayer.solving.history import TIME_TOLERANCE, History, Solution, state_at
from thinlayer.system.fingerprint import differences, differences_text
from thinlayer.system.ranks import errors_on_all, require_same

WhereFunction = Callable[[Array], object]
JUMP_ROUNDING_RATIO = 1e-12  # jump, over the displacements, up to which it is their rounding error
RELATIVE_PROFILE_TOLERANCE = 1e-9  # relative difference of equal thickness profiles


def compare(
    full: Solution, interface: Solution, *, seam: str = S, where: WhereFunction | None = None, at: float | None = None
) -> dict[str, float]:
    """Measure the relative differences of traction and jump between an interface law and a meshed layer. Collective.

    The interface law's traction is compared with the mean of stress times n through the thickness of the meshed layer.
    The jump of the meshed layer is the difference of displacements at opposite points of its upper and lower face. For a
    scalar field such as a temperature, the flux stands in the place of the traction, also in the names of entries.

    Args:
        full: state of a full model, or its history.
        interface: state of the interface model of the same joint, or its history.
        seam: name of the seam to measure on; default all of S.
        where: part of S to measure on, a numpy function of the coordinates, such as `lambda x: x[0] > 1` or
            `lambda x: (x[0] > 1) & (x[0] < 9)`; default all of S.
        at: time of the states to take from histories; default the last time. If a state is given, it must be the state
            at this time.

    Returns:
        A dictionary with these entries:

        - "eps": the largest `ThinLayer.eps` of the layers.
        - "error_traction", "error_jump": L2 norms over S of the differences of the two models. Each is divided by the
          norm of the interface model's field, and nan if this norm is zero up to rounding errors.
        - "traction", "jump": these L2 norms of the interface model's fields. The units are those of stress and length,
          in 2D times the root of a length, in 3D and axisymmetry times the root of an area.

    Raises:
        InputError: the states do not belong to a full and an interface model of the same structure. Joint, bodies,
            supports, loads, plane, element and thickness must be the same. The states have different times; the
            seam is unknown; `where` is no function of the coordinates, or is true nowhere on S.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, compare, solve
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> layer = ThinLayer(glue, eps=0.05)
        >>> full, limit = plates.full(layer, cells_through=2), plates.interface(layer)
        >>> errors = compare(solve(full), solve(limit))
        >>> f"traction {errors['error_traction']:.2g}, jump {errors['error_jump']:.2g}"
        'traction 0.017, jump 0.015'
    """
    for result in (full, interface):
        require(isinstance(result, (State, History)), "compare: a state", result, "give what solve or march returns")
    require(at is None or is_finite(at), "compare: at", at, "give a time, a finite number")
    full, interface = (state_at(result, at) for result in (full, interface))
    meshed, limit = full.model, interface.model
    if not (isinstance(meshed, FullModel) and isinstance(limit, InterfaceModel)):
        raise InputError(f"compare needs a full and an interface model, not {meshed.name} and {limit.name}")
    _require_equal("joint and element", meshed.joint is limit.joint and meshed.element == limit.element, meshed, limit)
    time_tolerance = TIME_TOLERANCE * max(abs(full.t), abs(interface.t))
    _require_equal("time", abs(full.t - interface.t) <= time_tolerance, f"t = {full.t:g}", f"{interface.t:g}")
    no_layer = [", ".join(n for n in model.joint.seams if n not in model.layers) or "none" for model in (meshed, limit)]
    _require_equal("open or bonded seams", no_layer[0] == no_layer[1], *no_layer)
    for name, layer in limit.layers.items():
        meshed_thin, limit_thin = meshed.layers[name].thin_layer, layer.thin_layer
        if meshed_thin and limit_thin:
            _require_equal(f"thickness of {layer}", meshed_thin.eps == limit_thin.eps, meshed_thin.eps, limit_thin.eps)
    _require_same_body_extent(meshed, limit)
    with errors_on_all(meshed.comm):
        _require_same_structure(meshed, limit)
    surface = Surface(limit, seam)
    indicator = _indicator(surface, where)
    row = {"eps": max(float(layer.thin_layer.eps) for layer in meshed.layers.values() if layer.thin_layer)}
    u_norm = float(interface.u.x.petsc_vec.norm(PETSc.NormType.INFINITY)) * math.sqrt(surface.integral(indicator))
    norms = {}
    for name, method in ((limit.kinematics.quantities.traction, surface.traction), ("jump", surface.jump)):
        limit_f = method(interface)
        norms[name] = surface.norm(limit_f, indicator)
        is_nonzero = norms[name] > (JUMP_ROUNDING_RATIO * u_norm if name == "jump" else 0.0)
        row[f"error_{name}"] = surface.norm(method(full) - limit_f, indicator) / norms[name] if is_nonzero else math.nan
    return row | norms


def _require_equal(quantity: str, is_equal: bool, full: object, interface: object) -> None:
    """Raise InputError if `is_equal` is False.

    Args:
        quantity: the quantity that must be the same in both models, such as "time", for the message.
        is_equal: whether the quantity is the same.
        full, interface: values of the quantity in the full and in the interface model, for the message.
    """
    if not is_equal:
        raise InputError(f"compare needs the same {quantity}, not {full} and {interface}")


def _require_same_body_extent(full: FullModel, interface: InterfaceModel) -> None:
    """Raise InputError if the bodies end at different places in both models, and a layer's law has order 1.

    The bodies of a model are either "kept", with S as their boundary, or "extended", with the layer cut out of them. If
    the models differ in this, results differ as much as by the terms of order 1.
    """
    band = full.domain.joint.band
    kind = "kept" if interface.domain.joint.parted is None else "extended"
    assert band is not None
    if band.bodies != kind and any(layer.thin_layer and layer.thin_layer.order for layer in interface.layers.values()):
        clause = f"bodies are {band.bodies} in the full model and {kind} in the interface model"
        raise InputError(f"compare: {clause}, which alone is a difference of order 1; give both the same bodies='...'")


def _require_same_structure(full: FullModel, interface: InterfaceModel) -> None:
    """Raise InputError unless both models have the same bodies, supports, loads, `plane` and variation of thickness."""
    full_data, interface_data = (
        {name: model.description[name] for name in ("plane", "bodies", "loads")}
        | {"supports": model.description["supports"][: len(model.supports.user_entries)]}
        for model in (full, interface)
    )
    if full_data != interface_data:
        changes = [*differences(full_data, interface_data)]
        raise InputError(f"compare needs the same {changes[0][0][0]}: {differences_text(changes)}")
    for name, layer in interface.layers.items():
        profiles = [seam_layer.thin_layer.profile for seam_layer in (full.layers[name], layer) if seam_layer.thin_layer]
        ratios = [full.joint.relative_thickness(profile, name) for profile in profiles]  # a law on S has no thickness
        if not np.allclose(ratios[0], ratios[-1], rtol=RELATIVE_PROFILE_TOLERANCE, atol=0.0):
            raise InputError(f"compare needs the same profile of the thickness of {layer} in both models")


def _indicator(surface: Surface, where: WhereFunction | None) -> Array:
    """Evaluate the user's function `where` at q quadrature points of n facets of S; all ranks get the same result.

    Args:
        surface: the facets of S.
        where: function of the coordinates that is true on a part of S; None: all of S.

    Returns:
        (n, q) numbers, 1 where the function is true and 0 elsewhere.

    Raises:
        InputError: the function has other values than true and false, or is true at no point.
    """
    with errors_on_all(surface.model.comm):
        indicator = surface.where(1.0 if where is None else where)
        if not np.isin(indicator, (0.0, 1.0)).all():
            raise InputError("where gives numbers; it must be true or false at each place, as lambda x: x[0] > 1")
    require_same(surface.model.comm, where=indicator)
    if not indicator.any():
        raise InputError("where is true nowhere on S, or between its quadrature points; choose a larger part")
    return indicator
