"""Compiled laws with numbers as parameters, evaluated at arrays of points."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from mpi4py import MPI

from forms.base import Array, InputError
from forms.kernel import KernelLaw
from forms.law import BulkLaw
from forms.law_tangents import law_identity
from forms.parameter_fields import parameter_numbers
from thinlayer.pointwise.kernels import compile_kernels
from thinlayer.system.compilation import library, pointers

Slots = Sequence[int]  # Mandel components
TRIAL_STRAINS = tuple(10.0**k for k in range(-15, 7))  # sizes of trial strains, or of trial jumps in any unit
TRIAL_STEPS = (1.0, 0.0, 1e12, 1e30)  # lengths of trial steps in any unit of time
C_SOURCE = Path(__file__).with_name("response.c")


class CompiledLaw:
    """A law compiled to a function of arrays of points, with numbers as parameters. Collective.

    Attributes:
        memory: number of internal values at a point. They are internal variables, 3 strains out of the plane for each
            sublayer in plane stress, and 3 strains across each sublayer of a stack.
        parameters: (n,) parameters of the first sublayer, then of the next ones; (points, n) if they vary in place or
            time.
    """

    def __init__(self, comm: MPI.Intracomm, law: BulkLaw) -> None:
        self.law, self._current_law, self._kernels = law, law, compile_kernels(comm, law)
        self._library = library(C_SOURCE, comm)
        self._counts = np.array([len(k.parameters) for k in self._kernels], np.int32)
        addresses, fractions = (np.array([getattr(k, name) for k in self._kernels]) for name in ("address", "fraction"))
        memory, plane = (np.array([getattr(k, name) for k in self._kernels], np.int32) for name in ("memory", "plane"))
        self._sublayers: list[np.ndarray] = [addresses.astype(np.intp), memory, plane, self._counts, fractions]
        self.parameters = np.concatenate([k.parameters for k in self._kernels])
        n_sublayers = len(self._kernels)
        self.memory = sum(k.memory + 3 * k.plane for k in self._kernels) + (3 * n_sublayers if n_sublayers > 1 else 0)
        for _, sublayer in law.sublayers:
            _check_kernel(comm, sublayer.in_space)

    def set_law(self, law: BulkLaw) -> None:
        """Set the parameters to those of another law with the same compiled code.

        Parameters that vary in place or time are set by the next `set_law_at`.

        Raises:
            InputError: the law has another class or other choices in a sublayer, or parameters of another shape.
        """
        if _identities(law) != _identities(self.law) or [len(p) for p in _parameters(law)] != self._counts.tolist():
            raise InputError(f"{law!r} is not of the kind that is compiled, {self.law!r}")
        self._current_law = law
        if not law.traits.varies:
            self.parameters = np.concatenate(_parameters(law))

    @property
    def varies(self) -> bool:
        """Whether parameters vary in place or time, so that `set_law_at` must set them."""
        return self.law.traits.varies

    @property
    def sublayer_parameters(self) -> list[Array]:
        """List of the parameters of each sublayer k, (n_k,) or, if they vary, (points, n_k)."""
        return np.split(self.parameters, np.cumsum(self._counts)[:-1], axis=-1)

    def set_law_at(self, x: Array, t: float) -> None:
        """Set the parameters that vary to their values at points and a time.

        Args:
            x: (d, points) coordinates in the joint as drawn, before S is opened to the layer's thickness.
            t: time.

        Raises:
            InputError: parameters out of range at one of the points, or of the wrong shape.
        """
        columns = []
        for _, law in self._current_law.sublayers:
            varying = law.fields_at(x) if law.fields else _varying_parameters(law, x, t) if law.traits.varies else {}
            for name, value in law.parameters().items():
                fixed = np.broadcast_to(np.ravel(parameter_numbers(value)), (x.shape[1], np.size(value)))
                columns.append(varying[name][:, None] if name in varying else fixed)
        self.parameters = np.ascontiguousarray(np.hstack(columns))

    def update(
        self, slots: Slots, e: Array, e_old: Array, q: Array, n: Array, dt: float, theta: float, *, fixed: bool = False
    ) -> tuple[Array, Array, Array, Array, int]:
        """Evaluate the law over a step at all points of this rank.

        Args:
            slots: numbers of the m Mandel components of the strains e; the other components are zero.
            e, e_old: (points, m) strains at the end and the beginning of the step.
            q: (points, memory) internal values at the beginning of the step.
            n: (points, 3) director.
            dt, theta: length of the step, and fraction of it after which forces balance.
            fixed: whether strains, also in sublayers, keep their values at the beginning; only energies are then
                computed.

        Returns:
            Stresses (points, 6) where forces balance; their derivatives (points, m, m) by the strains at the end;
            internal values (points, memory) at the end; per volume the stored energy at the end, the energy dissipated
            in the step and the remainder of the energy balance (points, 3); and the number of points where the law
            failed.
        """
        components = np.array(list(slots), np.int32)
        points, m, varying = len(e), len(components), self.parameters.ndim == 2
        s, C, energies = np.empty((points, 6)), np.empty((points, m, m)), np.empty((points, 3))
        q_new = np.empty((points, self.memory))
        c = self._library
        failed = c.lib.run(
            len(self._kernels), *pointers(c, *self._sublayers, self.parameters.ravel()), varying,
            m, *pointers(c, components), points, self.memory, *pointers(c, e, e_old, q, n), dt, theta, fixed,
            *pointers(c, s, C, q_new, energies),
        )  # fmt: skip
        if failed < 0:
            raise MemoryError("points")
        return s, C, q_new, energies, int(failed)


_CHECKED_KERNELS: set[tuple[type[BulkLaw], bytes]] = set()  # classes and parameters of the laws already checked


def _check_kernel(comm: MPI.Intracomm, law: BulkLaw) -> None:
    """Raise InputError if a user-defined KernelLaw depends on the step length dt and `relaxes` is False, or vice versa.

    The test calls its compiled function for strains, or jumps, of many sizes, and for steps of several lengths. Laws of
    this package and laws with the trait `rate` are not tested.
    """
    key = type(law), law.parameter_values().tobytes()
    if not isinstance(law, KernelLaw) or law_identity(law) is not None or law.traits.rate or key in _CHECKED_KERNELS:
        return
    _CHECKED_KERNELS.add(key)  # before the test, whose `CompiledLaw` calls this function again
    material, name = CompiledLaw(comm, law), type(law).__name__
    e = np.array(TRIAL_STRAINS)[:, None] * np.cos(np.arange(6.0 * len(TRIAL_STRAINS))).reshape(-1, 6)
    q, n = np.zeros((len(e), law.memory)), np.tile([0.6, 0.8, 0.0], (len(e), 1))
    reference, *others = (material.update(range(6), e, 0 * e, q, n, dt, 1.0) for dt in TRIAL_STEPS)
    if law.relaxes == all(np.array_equal(other[k], reference[k], equal_nan=True) for other in others for k in (0, 2)):
        _CHECKED_KERNELS.discard(key)
        verb = "does not depend" if law.relaxes else "depends"
        raise InputError(f"{name} has relaxes = {law.relaxes}, but {verb} on dt; write relaxes = {not law.relaxes}")


def _varying_parameters(law: BulkLaw, x: Array, t: float) -> dict[str, Array]:
    """Values (n,), by name, of a law's parameters that vary, at points x (d, n) and time t.

    Raises:
        InputError: the law's method `at` returns names that are no scalar parameters, or values that are not (n,) and
            finite.
    """
    subject = f"{type(law).__name__}.at(x, t), for x of shape {x.shape}"
    scalar_names = [name for name, value in law.parameters().items() if parameter_numbers(value).ndim == 0]
    varying = {name: np.asarray(value, float) for name, value in law.at(x.copy(), t).items()}
    if not varying or not varying.keys() <= set(scalar_names):
        raise InputError(f"{subject}, gives {sorted(varying)}; allowed: those of {', '.join(scalar_names)} that vary")
    for name, value in varying.items():
        if value.shape != x.shape[1:] or not np.isfinite(value).all():
            raise InputError(f"{subject}, gives {name} of shape {value.shape}; allowed: {x.shape[1:]}, finite numbers")
    return varying


def _identities(law: BulkLaw) -> list[tuple[type[BulkLaw], str]]:
    """Class of each sublayer and the text of its choices, which together determine its compiled code."""
    return [(type(sublayer), repr(sublayer.choices())) for _, sublayer in law.sublayers]


def _parameters(law: BulkLaw) -> list[Array]:
    """List of the parameters (n_k,) of each sublayer k."""
    return [sublayer.parameter_values() for _, sublayer in law.sublayers]
