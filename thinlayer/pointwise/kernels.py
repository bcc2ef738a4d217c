"""Laws compiled to C functions of one quadrature point.

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
from forms.tensors import Expr, mandel_vector
from forms.traits import VARIABLE_SIZES
from thinlayer.system.compilation import compile_library

C_KERNEL_SIGNATURE = "int{}(double *out, const void *, const double *in)"


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


# ---------------------------------------------------------------- laws written in UFL
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
