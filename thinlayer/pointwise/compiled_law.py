"""Compiled laws with numbers as parameters, evaluated at many points at once."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from mpi4py import MPI

from forms.base import Array, InputError
from forms.kernel import KernelLaw
from forms.law import BulkLaw
from forms.law_tangents import equations_key
from forms.parameter_fields import parameter_numbers
from thinlayer.pointwise.kernels import compile_kernels
from thinlayer.system.compilation import c_pointers, compile_library

Ints = Sequence[int]  # positions of Mandel components
TRIAL_STRAIN_SIZES = tuple(10.0**k for k in range(-15, 7))  # sizes of trial strains, or of trial jumps in any unit
TRIAL_STEP_LENGTHS = (1.0, 0.0, 1e12, 1e30)  # lengths of trial steps in any unit of time
C_SOURCE = Path(__file__).with_name("response.c")


class CompiledLaw:
    """Law that is compiled to a C function, evaluated at all quadrature points of this rank.

    Creating an object is collective, as compiling is. Its methods are not.

    Attributes:
        memory_size: number of internal values at a point. Besides internal variables these are, if needed, strains at
            the point: 3 out of the plane for each sublayer in plane stress, and 3 across each sublayer of a stack.
        parameters: (n,) parameters of the first sublayer, then of the next ones; (points, n) if they vary in place or
            time.
        varies: whether parameters vary in place or time, so that `set_parameters_at` must set them.
    """

    def __init__(self, comm: MPI.Intracomm, law: BulkLaw) -> None:
        self.law, self._current_law, self._kernels = law, law, compile_kernels(comm, law)
        self.varies = law.traits.varies
        self._library = compile_library(C_SOURCE, comm)
        self._n_params = np.array([len(k.parameters) for k in self._kernels], np.int32)
        addresses, fractions = (np.array([getattr(k, name) for k in self._kernels]) for name in ("address", "fraction"))
        sizes, plane = (np.array([getattr(k, name) for k in self._kernels], np.int32) for name in ("memory", "plane"))
        self._sublayers: list[np.ndarray] = [addresses.astype(np.intp), sizes, plane, self._n_params, fractions]
        self.parameters = np.concatenate([k.parameters for k in self._kernels])
        n_plies = len(self._kernels)
        self.memory_size = sum(k.memory + 3 * k.plane for k in self._kernels) + (3 * n_plies if n_plies > 1 else 0)
        for _, sublayer in law.sublayers:
            _check_relaxes(comm, sublayer.law_3d)

    def set_law(self, law: BulkLaw) -> None:
        """Set the parameters to those of `law`, which must have the same compiled code.

        Parameters that vary in place or time are set only by the next call of `set_parameters_at`.

        Raises:
            InputError: `law` or one of its sublayers has another class or other options that change the compiled code.
                Or its parameters have another shape.
        """
        if _identities(law) != _identities(self.law) or [len(p) for p in _parameters(law)] != self._n_params.tolist():
            raise InputError(f"{law!r} is not of the kind that is compiled, {self.law!r}")
        self._current_law = law
        if not law.traits.varies:
            self.parameters = np.concatenate(_parameters(law))

    @property
    def sublayer_parameters(self) -> list[Array]:
        """List with the parameters of each sublayer: (n,) or, if they vary in place or time, (points, n)."""
        return np.split(self.parameters, np.cumsum(self._n_params)[:-1], axis=-1)

    def set_parameters_at(self, x: Array, t: float) -> None:
        """Set those parameters that vary in place or time to their values at points and a time.

        Args:
            x: (d, points) coordinates in the joint as drawn, before S is opened to the layer's thickness.
            t: time.

        Raises:
            InputError: a parameter is out of range at one of the points, or has the wrong shape.
        """
        parameter_columns = []
        for _, law in self._current_law.sublayers:
            varying = law.fields_at(x) if law.fields else _varying_parameters(law, x, t) if law.traits.varies else {}
            for name, value in law.parameters().items():
                constant_values = np.broadcast_to(np.ravel(parameter_numbers(value)), (x.shape[1], np.size(value)))
                parameter_columns.append(varying[name][:, None] if name in varying else constant_values)
        self.parameters = np.ascontiguousarray(np.hstack(parameter_columns))

    def update(
        self, mandel: Ints, e: Array, e_old: Array, q: Array, n: Array, dt: float, theta: float, *, frozen: bool = False
    ) -> tuple[Array, Array, Array, Array, int]:
        """Evaluate the law over a step at all points of this rank.

        Args:
            mandel: positions of the m components of `e` among the 6 Mandel components; the others are zero.
            e, e_old: (points, m) strains at the end and the beginning of the step.
            q: (points, memory) internal values at the beginning of the step.
            n: (points, 3) unit normal of the layer (director).
            dt, theta: length of the step, and fraction of it after which forces balance.
            frozen: True: all strains, also those in sublayers, stay as at the beginning of the step. Only the energies
                in the result are valid then.

        Returns:
            Five values:

            - (points, 6) stresses where forces balance;
            - (points, m, m) their derivatives by the strains at the end;
            - (points, memory) internal values at the end;
            - (points, 3) energies per volume: stored at the end, dissipated in the step, remainder of the energy
              balance;
            - the number of points where the law failed.
        """
        mandel_array = np.array(list(mandel), np.int32)
        n_points, m, parameters_vary = len(e), len(mandel_array), self.parameters.ndim == 2
        s, C, energies = np.empty((n_points, 6)), np.empty((n_points, m, m)), np.empty((n_points, 3))
        q_new = np.empty((n_points, self.memory_size))
        c = self._library
        n_failed = c.lib.run(
            len(self._kernels), *c_pointers(c, *self._sublayers, self.parameters.ravel()), parameters_vary,
            m, *c_pointers(c, mandel_array), n_points, self.memory_size, *c_pointers(c, e, e_old, q, n), dt, theta, frozen,
            *c_pointers(c, s, C, q_new, energies),
        )  # fmt: skip
        if n_failed < 0:
            raise MemoryError("points")
        return s, C, q_new, energies, int(n_failed)


_CHECKED_KERNELS: set[tuple[type[BulkLaw], bytes]] = set()  # classes and parameters of the laws already checked


def _check_relaxes(comm: MPI.Intracomm, law: BulkLaw) -> None:
    """Raise InputError if a user's `KernelLaw` declares wrongly whether it depends on the step length dt.

    The declaration is `relaxes`: True if the law depends on dt. The test calls the compiled function for strains, or
    jumps, of many sizes and for several dt. Laws of this package and laws with the trait `rate` are not tested.

    Args:
        comm: communicator for compiling.
        law: the law.
    """
    key = type(law), law.parameter_values().tobytes()
    if not isinstance(law, KernelLaw) or equations_key(law) is not None or law.traits.rate or key in _CHECKED_KERNELS:
        return
    _CHECKED_KERNELS.add(key)  # before the test, whose `CompiledLaw` calls this function again
    material, name = CompiledLaw(comm, law), type(law).__name__
    e = np.array(TRIAL_STRAIN_SIZES)[:, None] * np.cos(np.arange(6.0 * len(TRIAL_STRAIN_SIZES))).reshape(-1, 6)
    q, n = np.zeros((len(e), law.memory)), np.tile([0.6, 0.8, 0.0], (len(e), 1))
    reference, *others = (material.update(range(6), e, 0 * e, q, n, dt, 1.0) for dt in TRIAL_STEP_LENGTHS)
    if law.relaxes == all(np.array_equal(other[k], reference[k], equal_nan=True) for other in others for k in (0, 2)):
        _CHECKED_KERNELS.discard(key)
        verb = "does not depend" if law.relaxes else "depends"
        raise InputError(f"{name} has relaxes = {law.relaxes}, but {verb} on dt; write relaxes = {not law.relaxes}")


def _varying_parameters(law: BulkLaw, x: Array, t: float) -> dict[str, Array]:
    """Return those parameters of `law` that vary in place or time: name -> values (n,) at n points.

    Args:
        law: the law.
        x: (d, n) coordinates of the points.
        t: time.

    Raises:
        InputError: the law's method `at` returns names that are no scalar parameters. Or its values are not finite or
            not (n,).
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
    """Return what determines the compiled code of each sublayer of `law`: its class and its options as text."""
    return [(type(sublayer), repr(sublayer.choices())) for _, sublayer in law.sublayers]


def _parameters(law: BulkLaw) -> list[Array]:
    """Return a list with the parameters (n,) of each sublayer of `law`."""
    return [sublayer.parameter_values() for _, sublayer in law.sublayers]
