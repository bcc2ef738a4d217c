"""Response of structures with mass to harmonic loads, with losses of layers and bodies."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from petsc4py import PETSc

from forms.base import Array, InputError, is_finite, require
from forms.elastic import LinearElastic
from forms.viscous import KelvinVoigt, Maxwell
from thinlayer.discretisation.layer import ThinLayer
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.solving.modes import (
    ComplexArray,
    Pencil,
    check_phases,
    checked_factors,
    crossing_time,
    layers_on_s,
    solve_complex,
)

LINEARITY_TOLERANCE = 1e-6  # relative deviation of an observed value from a linear function that counts as rounding


@dataclass(frozen=True, eq=False)
class HarmonicResponse:
    """Complex amplitudes of a structure under harmonic loads.

    Attributes:
        omega: (n,) angular frequencies, rad per time.
        values: name of an observed quantity -> (n,) complex amplitudes a. The quantity is Re(a exp(i omega t)), so that
            its largest value is |a|, and it lags behind the loads by minus the angle of a.
    """

    omega: Array
    values: dict[str, ComplexArray]


def harmonic(
    model: Model,
    omegas: Sequence[float],
    observe: Mapping[str, Callable[[State], float]],
    loss: Mapping[str, float] | None = None,
) -> HarmonicResponse:
    """Compute the steady response to loads and support motions that vibrate with given frequencies. Collective.

    Loads and prescribed displacements are those of the model at t = 0, times cos(omega t). Layers may be of
    `KelvinVoigt` or `Maxwell`, whose losses depend on the frequency. Eigenstrains have no influence.

    Args:
        model: a model with `Inertia` among its parts, of linear elastic laws but for such layers.
        omegas: angular frequencies, > 0, rad per time.
        observe: name of a quantity -> function of a state that returns a real number, linear in the displacements and
            the same on all ranks. Reactions are not known.
        loss: name of a seam or body -> loss factor eta >= 0, for the complex stiffness (1 + i eta) K. None: no loss
            besides that of viscous layers.

    Warns:
        RangeWarning: as `solve` for the model; the phase of a layer on S exceeds 1/2, see `Modes.phases`.

    Raises:
        InputError: as `modes`; a frequency or loss factor out of range; a function of `observe` is not linear.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Inertia, Probe, Structure, ThinLayer, harmonic
        >>> joint = sandwich(60, 2, 2, h=2, cell="quadrilateral")
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=5, nu=0.3)
        >>> mass = Inertia({"LOWER": 7.8e-9, "UPPER": 7.8e-9, "S": 1.2e-9})  # t/mm^3
        >>> data = {"supports": {"LEFT": 0}, "tractions": {"TOP": (0, -0.01)}}
        >>> beam = Structure(joint, body=steel, parts=[mass], **data)
        >>> model = beam.interface(ThinLayer(glue, eps=0.2, order=1))
        >>> tip = lambda state: Probe(state).displacement((60, 0), side="lower")[1]
        >>> response = harmonic(model, [1e3, 3.33e3], {"tip": tip}, loss={"S": 0.5})
        >>> print(abs(response.values["tip"]).round(3))
        [0.048 0.598]
    """
    is_list = np.ndim(omegas) == 1 and len(omegas) > 0 and all(is_finite(w) and w > 0 for w in omegas)
    require(is_list, "omegas", omegas, "allowed: a list of numbers > 0")
    require(isinstance(observe, Mapping), "observe", observe, "give {name: function of a state}")
    require(isinstance(loss or {}, Mapping), "loss", loss, "give {name of a seam or body: loss factor}")
    omega = np.array(omegas, float)
    factors, viscous = checked_factors(loss or {}), _viscous_layers(model)
    names, rows = model.comm.bcast([*observe]), list[ComplexArray]()
    for w in omega:
        if viscous or not rows:
            storage = {name: _elastic(layer, w, "storage") for name, layer in viscous.items()}
            pencil = Pencil(model.with_layer({**model.on_seams, **storage}) if viscous else model)
            lossy = [(eta, pencil.stiffness_of(name)) for name, eta in factors.items()]
            lossy += _viscous_stiffnesses(pencil, viscous, w)
        times = {name: crossing_time(pencil.inertia, layer) for name, layer in layers_on_s(pencil.model).items()}
        check_phases(model, {name: w * times[name] * np.ones(1) for name in times})
        parts = _amplitudes(pencil, w, lossy)
        values = np.array([[_observed(name, observe[name](state)) for name in names] for state in parts])
        deviations = abs(values[2] - (values[1] - 2 * values[0]))
        if not deviations.max(initial=0.0) <= LINEARITY_TOLERANCE * abs(values).max(initial=0.0):
            reason = f"observe: {names[int(deviations.argmax())]!r} is not linear in the displacements"
            raise InputError(f"{reason}, which complex amplitudes need; give a displacement, stress or force")
        rows.append(values[0] + 1j * values[1])
    return HarmonicResponse(omega, dict(zip(names, np.transpose(rows), strict=True)))


def _observed(name: str, value: float) -> float:
    require(is_finite(value), f"observe: the value of {name!r}", value, "it must be a finite real number")
    return float(value)


def _viscous_layers(model: Model) -> dict[str, ThinLayer]:
    """Return the layers of `KelvinVoigt` or `Maxwell` by the names of their seams."""
    layers = {name: layer.thin_layer for name, layer in model.layers.items() if layer.thin_layer}
    return {name: thin for name, thin in layers.items() if isinstance(thin.law, KelvinVoigt | Maxwell)}


def _elastic(layer: ThinLayer, omega: float, kind: str) -> ThinLayer:
    """Return a viscous layer with elastic moduli: storage moduli or, for the `kind` "sum", storage plus loss moduli."""
    assert isinstance(layer.law, KelvinVoigt | Maxwell)
    if layer.law.fields:
        reason = f"harmonic: {type(layer.law).__name__} has parameters that vary with the place"
        raise InputError(f"{reason}; give numbers, or a seam for each stretch of the layer")
    moduli = layer.law.complex_moduli(omega)
    return replace(layer, law=LinearElastic(*(m.real + (m.imag if kind == "sum" else 0.0) for m in moduli)))


def _viscous_stiffnesses(
    pencil: Pencil, viscous: Mapping[str, ThinLayer], omega: float
) -> list[tuple[float, PETSc.Mat]]:
    """Return the loss stiffness of viscous layers, as factors and matrices of all unknowns: "sum" minus storage."""
    if not viscous:
        return []
    model = pencil.model
    both = model.with_layer({**model.on_seams, **{name: _elastic(viscous[name], omega, "sum") for name in viscous}})
    sums = [(1.0, pencil.stiffness_of(name, both)) for name in viscous]
    return sums + [(-1.0, pencil.stiffness_of(name)) for name in viscous]


def _amplitudes(pencil: Pencil, omega: float, lossy: Sequence[tuple[float, PETSc.Mat]]) -> list[State]:
    """Return the states of the real and the imaginary amplitude of the response, and of the second minus twice the first.

    Of the third, no quantity that is not linear has the value that follows from the others, also if the second is zero.
    """
    equations, real = pencil.equations, [(1.0, pencil.K), (-(omega**2), pencil.M)]
    x, forces = equations.create_vector(), equations.forces_on_unknowns(equations.loads_at(0.0))
    x.array[equations.bc_dofs] = equations.prescribed
    right_sides = []
    for terms, b in ((real, forces), (lossy, equations.create_vector())):
        for factor, A in terms:
            b.axpy(-factor, A * x)
        right_sides.append(b.array_r[pencil.free_dofs])
    free = [[(factor, pencil.without_supports(A)) for factor, A in terms] for terms in (real, lossy)]
    z = solve_complex(free[0], free[1], right_sides[0] + 1j * right_sides[1])
    states = []
    for values, share in ((z.real, 1.0), (z.imag, 0.0), (z.imag - 2 * z.real, -2.0)):
        y = equations.create_vector()
        y.axpy(share, x)
        y.array[pencil.free_dofs] = values
        states.append(pencil.state_of(y, omega))
    return states
