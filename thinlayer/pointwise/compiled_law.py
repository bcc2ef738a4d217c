"""Laws compiled to C functions of one point, evaluated with numbers as parameters at many points at once.

A law written in UFL is differentiated by UFL and compiled by FFCx; a `KernelLaw` is written in C. Each becomes a C
function of two arrays of numbers,

    in:  e (6), e_old (6), q, n (3), dt, theta, parameters
    out: stress (6), q_new, tangent (36), energies (3).

e and q_new are the strains and internal variables at the end of a step, e_old and q those at its beginning. n is the
unit normal of the layer (director) and dt the length of the step. Forces balance after the fraction theta of the step.
Tensors are in Mandel's order.

`response.c` calls the function at each point, and finds the strains of the sublayers of a `Stack`. Parameters are no
part of the compiled code: a law is compiled once for all parameters and thicknesses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import ufl
from dolfinx import jit
from mpi4py import MPI

from forms.base import Array, InputError
from forms.check import check
from forms.kernel import KernelLaw
from forms.law import BulkLaw, Step
from forms.law_tangents import SymbolicLaw, equations_key, require_known_symbols, symbolic_law
from forms.parameter_fields import parameter_numbers
from forms.tensors import Expr, mandel_vector
from forms.traits import VARIABLE_SIZES
from thinlayer.system.compilation import c_pointers, compile_library

C_KERNEL_SIGNATURE = "int{}(double *out, const void *, const double *in)"

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


@dataclass(frozen=True)
class Kernel:
    """Compiled C function of one law, or of one sublayer of a `Stack`, at a quadrature point.

    Attributes:
        address: address of the C function.
        memory: number of internal variables of the function. It does not count the three out-of-plane strains that are
            stored if `plane` is True.
        parameters: (n,) parameters of the law, one after the other.
        fraction: fraction of the layer's thickness that the sublayer has; 1 for a whole layer.
        plane: whether the law is in plane stress. The out-of-plane strains are then computed at each point such that
            the out-of-plane stresses are zero.
        keep_alive: objects that must live as long as the address is used.
    """

    address: int
    memory: int
    parameters: Array
    fraction: float = 1.0
    plane: bool = False
    keep_alive: object = field(default=None, repr=False, compare=False)


def compile_kernels(comm: MPI.Intracomm, law: BulkLaw) -> list[Kernel]:
    """Compile `law`, whose parameters are numbers, to one C function for each sublayer. Collective.

    Raises:
        InputError: the law contradicts its declarations, such as that it is linear (`forms.check`); all ranks raise it.
        SourceError: a C source cannot be compiled.
    """
    check(law)
    kernels = []
    for fraction, sublayer in law.sublayers:
        bulk = sublayer.law_3d
        address, keep = _compiled_from_c(comm, bulk) if isinstance(bulk, KernelLaw) else _compiled_by_ffcx(comm, bulk)
        kernels.append(Kernel(address, bulk.memory, bulk.parameter_values(), fraction, bulk is not sublayer, keep))
    return kernels


# this package's laws, by name; other laws may use data that change
_COMPILED_BY_NAME: dict[tuple[object, ...], tuple[int, object]] = {}


def _compiled_by_ffcx(comm: MPI.Intracomm, law: BulkLaw) -> tuple[int, object]:
    name = equations_key(law)
    if name is not None and not comm.allreduce(int(name not in _COMPILED_BY_NAME)):
        return _COMPILED_BY_NAME[name]
    symbols = symbolic_law(law)
    outputs = _outputs(law, symbols)
    require_known_symbols(law, symbols.symbols, outputs)
    (stress, *memory), tangent = outputs[:-3], ufl.diff(outputs[0], symbols.strain)
    tangent_entries = (tangent[i, j] for i in range(6) for j in range(6))
    components = [*(stress[i] for i in range(6)), *memory, *tangent_entries, *outputs[-3:]]
    expression, module, _ = jit.ffcx_jit(comm, (ufl.as_vector(components), np.zeros((1, 1))))
    compiled = int(module.ffi.cast("intptr_t", expression.tabulate_tensor_float64)), (expression, module)
    if name is not None:
        _COMPILED_BY_NAME[name] = compiled
    return compiled


def _outputs(law: BulkLaw, symbols: SymbolicLaw) -> list[Expr]:
    """Return UFL expressions of the results of a law at a point: stress (6,), then internal variables, then energies.

    Each internal variable adds one entry to the list for each component. The last three entries are the energies:
    stored, dissipated, and the remainder of the energy balance. They are zero if the law declares no energy.

    Args:
        law: the law.
        symbols: the same law with symbols for strains, internal variables and parameters.
    """
    ufl_law, step = symbols.law, symbols.step
    stress, new = mandel_vector(ufl_law.stress(ufl_law.law_step(step))), ufl_law.advance(step)
    memory = [value for name, shape in law.internal.items() for value in _packed_components(new[name], shape)]
    energies: list[Expr] = [0.0, 0.0, 0.0]
    if law.traits.has_energy:
        energies = [ufl_law.energy(Step(step.e, step.n, q=new)), ufl_law.dissipated(step), ufl_law.remainder(step)]
    return [stress, *memory, *map(ufl.as_ufl, energies)]


def _packed_components(value: Expr, shape: tuple[int, ...]) -> list[Expr]:
    if shape == ():
        return [ufl.as_ufl(value)]
    vector = mandel_vector(value) if shape == (3, 3) else value
    return [vector[i] for i in range(VARIABLE_SIZES[shape])]


# ---------------------------------------------------------------- laws written for one point
def _compiled_from_c(comm: MPI.Intracomm, law: KernelLaw) -> tuple[int, object]:
    name, source = type(law).__name__, law.source
    if not isinstance(source, (str, Path)):
        raise InputError(f"{name}.source is {source!r}; it must be the name of a C file")
    module = compile_library(Path(source), comm)
    function, ffi = getattr(module.lib, "kernel", None), module.ffi
    if function is None or ffi.typeof(function) is not ffi.typeof(C_KERNEL_SIGNATURE.format("(*)")):
        raise InputError(f"{name}: {str(source)!r} has no function {C_KERNEL_SIGNATURE.format(' kernel')}")
    return int(ffi.cast("intptr_t", ffi.addressof(module.lib, "kernel"))), module
