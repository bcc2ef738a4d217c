"""Vibrations about rest: natural modes of models with mass, and their loss factors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from petsc4py import PETSc

from forms.base import Array, InputError, is_finite, is_integer, require
from forms.law_tangents import acoustic_tensor
from forms.work import Term, work
from geometry.refusals import require_known
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import SeamLayer
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import Report, State
from thinlayer.errors import SolveError
from thinlayer.parts.form_part import assemble_plain_matrix
from thinlayer.parts.inertia import Inertia
from thinlayer.parts.part import Block, TimeStep
from thinlayer.solving.equations import Equations
from thinlayer.solving.initial_state import inertia_part
from thinlayer.solving.part_sum import TangentMatrix
from thinlayer.solving.ranges import warn_of_model
from thinlayer.system.ranks import destroy
from thinlayer.system.table import Table

ComplexArray = npt.NDArray[np.complex128]

MODE_TOLERANCE = 1e-9  # relative residual of shapes; the error of omega^2 is about its square
MAX_BLOCKS = 60  # number of blocks of vectors after which the search for modes ends
EXTRA_VECTORS = 4  # vectors in a block besides the modes that are wanted
DEPENDENT_RATIO = 1e-24  # squared norm of a vector, over the largest of its block, below which it is rounding
# shift of omega^2 below zero, over its largest value on the mesh: without it K of a free body could not be factored
SHIFT_RATIO = 1e-10
MAX_SPREAD = 1e3  # largest ratio of two modes' distances from the shift; above it rounding hides the farther one
WARN_PHASE, MAX_PHASE = 0.5, math.pi / 2  # omega times the time in which a shear wave crosses a layer
RIGID_RATIO = 1e-12  # omega^2, over its largest value on the mesh, that is rounding: of rigid motions
MAX_LEVER = 0.02  # size of eps d<u_N>/ds, over that of [u], that order 0 may neglect


class Pencil:
    """Stiffness and mass matrix of a linear model: a matrix pencil, with and without unknowns at supports. Collective.

    Attributes:
        model, equations: the model and its equations, in a step without duration from rest.
        inertia: the mass of the model.
        K, M: stiffness and mass matrix of all unknowns.
        free_dofs: local numbers of the unknowns that supports leave free.

    Raises:
        InputError: the model has no mass, is not linear, or depends on rates or its history.
    """

    def __init__(self, model: Model) -> None:
        require(isinstance(model, Model), "model", model, "give what Structure.full or Structure.interface returns")
        self.model, self.equations = model, Equations(model)
        self._part = inertia_part(self.equations)
        self.inertia = next(part for part in model.parts if isinstance(part, Inertia))
        laws = [*model.body_laws.values(), *(layer.law for layer in model.layers.values())]
        for law in laws:
            if not (law.traits.linear and law.traits.symmetric) or law.traits.rate or law.traits.remembers:
                text = (
                    f"vibrations: {type(law).__name__} is not linear and symmetric, or depends on rates or its history"
                )
                raise InputError(f"{text}; take LinearElastic with its moduli for small vibrations, and loss factors")
        if not (model.linear and model.symmetric):
            text = "vibrations: the model has contact, or a part that is not linear and symmetric"
            raise InputError(f"{text}; leave it out")
        warn_of_model(model)
        equations = self.equations
        equations.begin(TimeStep(equations.rest_state(0.0), 0.0, 0.0, 1.0))
        self._x, self._r = equations.create_vector(), equations.create_vector()
        equations.residual(self._x, self._r)
        self.K, self.M = equations.tangent(), equations.on_unknowns(self._part.M)
        first, end = self.K.getOwnershipRange()
        self.free_dofs = np.setdiff1d(np.arange(end - first), equations.bc_dofs)
        rows = (first + self.free_dofs).astype(PETSc.IntType)
        self._free_rows = PETSc.IS().createGeneral(rows, comm=model.comm)

    def without_supports(self, A: PETSc.Mat) -> PETSc.Mat:
        """Return the rows and columns of a matrix `A` of all unknowns that supports leave free."""
        return A.createSubMatrix(self._free_rows, self._free_rows)

    def stiffness_of(self, name: str, other: Model | None = None) -> PETSc.Mat:
        """Return the stiffness of a body, or of the layer on a seam, as a matrix of all unknowns.

        Args:
            name: name of the body or seam.
            other: a model on the same mesh, with other laws of layers; None: the model.
        """
        form = work(
            _terms_of(other or self.model, name), ufl.TrialFunction(self.model.V), ufl.TestFunction(self.model.V)
        )
        return self.equations.on_unknowns(assemble_plain_matrix(form))

    def state(self, x: Array, omega: float) -> State:
        """Return the state of largest displacement in a vibration, from values `x` (n,) of the free unknowns."""
        self._x.set(0.0)
        self._x.array[self.free_dofs] = x
        return self.state_of(self._x, omega)

    def state_of(self, x: PETSc.Vec, omega: float) -> State:
        """Return the state with all unknowns `x`; its accelerations are -omega^2 times the displacements."""
        equations, a = self.equations, fem.Function(self.model.V)
        equations.residual(x, self._r)
        end = equations.end_parts(equations.u, 0.0)[1]
        a.x.array[:] = -(omega**2) * end.u.x.array
        memory = {**end.memory, self.inertia.key: {"v": fem.Function(self.model.V), "a": a}}
        return State(**{**vars(end), "memory": memory}, model=self.model, report=Report("modes", 0, 0.0, 0.0))


def _terms_of(model: Model, name: str) -> list[Term]:
    """Return the terms of the law of a body, or of the layer on a seam, without prescribed strains."""
    require_known("body or layer", name, (*model.body_laws, *model.layers))
    if name in model.layers:
        terms = [p for p in model.layer_terms if model.layers[name].owns_key(p.key)]
    else:
        (tag,) = model.domain.region_tags(name)
        term = next(p for p in model.bodies if tag in np.atleast_1d(p.measure.subdomain_id()))
        terms = [replace(term, measure=term.measure.reconstruct(subdomain_id=tag))]
    if any(p.law.traits.compiled or p.law.traits.constrained for p in terms):
        reason = f"the stiffness of {name!r} alone is not known, as its law is incompressible, or varies with the place"
        raise InputError(f"{reason}; take LinearElastic with numbers, or no loss factor there")
    return [replace(p, prescribed_strain=None) for p in terms]


def mode_table(columns: Mapping[str, Array]) -> Table:
    """Return a table with a row for each mode, from columns (n,) by name."""
    return Table(
        {"mode": k} | dict(zip(columns, map(float, row), strict=True))
        for k, row in enumerate(zip(*columns.values(), strict=True), 1)
    )


@dataclass(frozen=True, eq=False)
class Modes:
    """Natural modes of a model, in the order of their frequencies.

    Attributes:
        model: the model.
        omega: (n,) angular frequencies, rad per time; 0 for rigid motions.
        shapes: the n states of largest displacement, for pictures and probes. Shapes v are of any sign, with v.Mv = 1
            for the mass matrix M, so that their energies are omega^2/2. Their reactions are not known.
        phases: name of a seam -> (n,) omega times the time in which a shear wave crosses the layer. An interface law
            has an error of about the square of the phase over 12, times the layer's share of the energy.
        gaps: (n,) distance of omega^2 from that of the nearest other mode, over omega^2; also of modes beyond the n.
        lowest: whether the n modes are the lowest ones.
    """

    model: Model
    omega: Array
    shapes: list[State]
    phases: dict[str, Array]
    gaps: Array
    lowest: bool
    _pencil: Pencil
    _vectors: Array

    @property
    def table(self) -> Table:
        """A table with a row for each mode: frequencies, phases of layers, and shares of energy if all laws have them.

        Collective.
        """
        columns = {"omega": self.omega, "hertz": self.hertz}
        columns |= {f"phase {name}": values for name, values in self.phases.items()}
        with suppress(InputError):  # of laws that are incompressible or vary with the place
            columns |= {f"{kind} {name}": v for kind, shares in self.shares.items() for name, v in shares.items()}
        return mode_table(columns)

    @property
    def hertz(self) -> Array:
        """Frequencies (n,) in cycles per time, Hz if times are in seconds."""
        return np.asarray(self.omega / (2 * math.pi), float)

    @cached_property
    def shares(self) -> dict[str, dict[str, Array]]:
        """Shares (n,) of each body and layer in the energies of the modes, by "kinetic" or "strain", then by name.

        Other parts, such as springs, have what is missing to 1. The strain energy of a rigid motion is rounding.
        Collective.
        """
        pencil, names, out = self._pencil, [*self.model.body_laws, *self.model.layers], dict[str, dict[str, Array]]()
        mass_of = {name: pencil.inertia.mass_matrix(self.model, [name]) for name in names}
        matrices = {"kinetic": {name: pencil.equations.on_unknowns(M) for name, M in mass_of.items()}}
        matrices["strain"] = {name: pencil.stiffness_of(name) for name in names}
        for kind, total in (("kinetic", pencil.M), ("strain", pencil.K)):
            energies = self.quotients(total)
            out[kind] = {name: self.quotients(A) / energies for name, A in matrices[kind].items()}
        return out

    def quotients(self, A: PETSc.Mat) -> Array:
        """Return v . A v (n,) for the shapes v, with v.Mv = 1, and a matrix `A` of all unknowns. Collective."""
        free = self._pencil.without_supports(A)
        return _products(self.model, self._vectors, multiply(free, self._vectors)).diagonal().copy()

    def loss(self, **factors: float) -> tuple[Array, Array]:
        """Return frequencies and loss factors (n,) of the modes, if the stiffness of layers or bodies is complex.

        A part with the loss factor eta has the complex stiffness (1 + i eta) K. The loss factor of a mode is the
        imaginary part of omega^2 over its real part: energy lost per radian, over the energy of the vibration. Collective.

        Args:
            factors: name of a seam or body -> its loss factor eta >= 0.

        Returns:
            The angular frequencies, roots of the real parts of omega^2, and the loss factors.

        Raises:
            InputError: an unknown name, a factor < 0, or a law that is incompressible or varies with the place.
        """
        pencil = self._pencil
        lossy = [
            (eta, pencil.without_supports(pencil.stiffness_of(name))) for name, eta in checked_factors(factors).items()
        ]
        K, M = pencil.without_supports(pencil.K), pencil.without_supports(pencil.M)
        pairs = zip(self.omega, self._vectors.T, strict=True)
        values = [self._complex_value(v, K, M, lossy) if w else 0j for w, v in pairs]
        real = np.array([value.real for value in values])
        return np.sqrt(np.abs(real)), np.array([value.imag for value in values]) / np.where(real, real, 1.0)

    def _complex_value(self, v: Array, K: PETSc.Mat, M: PETSc.Mat, lossy: Sequence[tuple[float, PETSc.Mat]]) -> complex:
        """Return the complex omega^2 of the mode with losses that belongs to the mode `v` (n,) without losses.

        It takes one step of inverse iteration, with the Rayleigh quotient of `v` as shift. The error is of sixth order
        in the change of the shape: cubed by the step, squared by the quotient.
        """
        shift = self._quotient(v.astype(np.complex128), K, M, lossy)
        imaginary = [*lossy, (-shift.imag, M)]
        z = solve_complex([(1.0, K), (-shift.real, M)], imaginary, multiply(M, v[:, None])[:, 0].astype(np.complex128))
        return self._quotient(z, K, M, lossy)

    def _quotient(
        self, z: ComplexArray, K: PETSc.Mat, M: PETSc.Mat, lossy: Sequence[tuple[float, PETSc.Mat]]
    ) -> complex:
        """Return z.(K + i K'')z / z.Mz, without conjugates, for complex vectors z (n,) and lossy parts K'' of K."""
        pair = np.stack([z.real, z.imag], axis=1)

        def product(A: PETSc.Mat) -> complex:
            return complex(self.model.comm.allreduce(complex(z @ (multiply(A, pair) @ np.array([1, 1j])))))

        return (product(K) + 1j * sum(eta * product(A) for eta, A in lossy)) / product(M)


def modes(model: Model, n: int = 6, near: float = 0.0) -> Modes:
    """Return the n natural modes of a model with mass whose frequencies are nearest to a given one. Collective.

    Loads, eigenstrains and the values that supports prescribe have no influence. A structure without supports has modes
    of rigid motions with omega = 0.

    Args:
        model: a model of linear elastic laws, with `Inertia` among its parts.
        n: number of modes.
        near: angular frequency, >= 0; 0: the lowest modes.

    Warns:
        RangeWarning: as `solve` for the model; the phase of a layer on S (`Modes.phases`) exceeds 1/2; plates bend about
            a layer of order 0.

    Raises:
        InputError: the model has no mass; a law or part is not linear; fewer than n modes; the phase of a layer on S
            exceeds pi/2, where interface laws are of no use: mesh it.
        SolveError: the modes do not converge.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Inertia, Structure, ThinLayer, modes
        >>> joint = sandwich(60, 2, 2, h=2, cell="quadrilateral")
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=5, nu=0.3)
        >>> mass = Inertia({"LOWER": 7.8e-9, "UPPER": 7.8e-9, "S": 1.2e-9})  # t/mm^3
        >>> beam = Structure(joint, body=steel, supports={"LEFT": 0}, parts=[mass])
        >>> print(modes(beam.interface(ThinLayer(glue, eps=0.2, order=1)), 3).hertz.round())
        [ 531. 3088. 8480.]
    """
    require(is_integer(n, 1), "n", n, "allowed: a whole number > 0")
    require(is_finite(near) and near >= 0, "near", near, "allowed: an angular frequency >= 0")
    pencil = Pencil(model)
    K, M = pencil.without_supports(pencil.K), pencil.without_supports(pencil.M)
    if n > (count := K.getSize()[0]):
        raise InputError(f"n is {n}; the model has {count} unknowns, and no more modes")
    diagonals = K.getDiagonal(), M.getDiagonal()
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(diagonals[1].array_r > 0, diagonals[0].array_r / diagonals[1].array_r, 0.0)
    largest = model.comm.allreduce(float(ratios.max(initial=0.0)), max)
    values, vectors, further = _nearest_pairs(model, K, M, n, near**2 - SHIFT_RATIO * largest)
    order = np.argsort(values)
    values, vectors = values[order], vectors[:, order]
    distances = np.abs(values[:, None] - np.append(values, further)) + np.diag([math.inf] * (n + len(further)))[:n]
    gaps = distances.min(axis=1, initial=math.inf) / np.maximum(np.abs(values), np.finfo(float).tiny)
    omega = np.sqrt(np.where(values < RIGID_RATIO * largest, 0.0, values))
    shapes = [pencil.state(v, w) for v, w in zip(vectors.T, omega, strict=True)]
    phases = {name: omega * crossing_time(pencil.inertia, layer) for name, layer in layers_on_s(model).items()}
    check_phases(model, phases)
    check_levers(shapes, omega)
    return Modes(model, omega, shapes, phases, gaps, near == 0, pencil, vectors)


def _nearest_pairs(model: Model, K: PETSc.Mat, M: PETSc.Mat, n: int, shift: float) -> tuple[Array, Array, Array]:
    """Return the n values lambda and vectors v (n_unknowns, n) of K v = lambda M v that are nearest to a shift.

    A third array has estimates of values that come next. All are found in the space that the inverse of K - shift M
    spans from a block of random vectors (block Lanczos, all vectors orthogonal). M may be singular. The blocks find
    values that are equal, as for rigid motions. To save memory K becomes K - shift M.
    """
    K.axpy(-shift, M, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    ksp, n_local = _direct_solver(K), K.getLocalSize()[0]
    block = ksp_solve(ksp, np.random.default_rng(model.comm.rank).standard_normal((n_local, n + EXTRA_VECTORS)))
    Q, MQ, W = (np.empty((n_local, 0)) for _ in range(3))
    for _ in range(MAX_BLOCKS):
        for _ in range(2):  # twice, as rounding leaves parts along earlier vectors
            block = block - Q @ _products(model, MQ, block)
            M_block = multiply(M, block)
            squares, U = np.linalg.eigh(_products(model, block, M_block))
            is_new = squares > DEPENDENT_RATIO * squares.max(initial=np.finfo(float).tiny)
            U = U[:, is_new] / np.sqrt(squares[is_new])
            block, M_block = block @ U, M_block @ U
        if not block.shape[1]:
            break
        image = ksp_solve(ksp, M_block)
        Q, MQ, W = (np.hstack(pair) for pair in ((Q, block), (MQ, M_block), (W, image)))
        projected = _products(model, MQ, W)
        inverses, Y = np.linalg.eigh((projected + projected.T) / 2)
        order = np.argsort(-np.abs(inverses))
        next_inverses, inverses, Y = inverses[order[n : n + EXTRA_VECTORS]], inverses[order[:n]], Y[:, order[:n]]
        R = W @ Y - Q @ (Y * inverses)
        norms = np.sqrt(np.abs(_products(model, R, multiply(M, R)).diagonal()))
        if len(inverses) == n and (norms <= MODE_TOLERANCE * np.abs(inverses)).all():
            V = W @ (Y / inverses)  # without parts that have no mass
            scale = np.sqrt(_products(model, V, multiply(M, V)).diagonal())
            destroy(ksp)
            return shift + 1 / inverses, V / scale, shift + 1 / next_inverses[next_inverses != 0]
        values = shift + 1 / inverses
        elastic = values[values > MAX_SPREAD * abs(shift)]
        if shift < 0 and len(elastic) and abs(inverses[0]) > MAX_SPREAD * abs(inverses[-1]):
            destroy(ksp)  # rigid motions are too near: the other frequencies give a better shift
            K.axpy(shift, M, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
            return _nearest_pairs(model, K, M, n, -float(elastic.min()) / 10)
        if shift > 0 and len(inverses) == n and abs(inverses[0]) > MAX_SPREAD * abs(inverses[-1]):
            destroy(ksp)  # a frequency is the given one, so that rounding hides the others
            K.axpy(shift, M, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
            return _nearest_pairs(model, K, M, n, shift + 2 / MAX_SPREAD / abs(float(inverses[-1])))
        block = image
    if Q.shape[1] < n:
        raise InputError(f"n is {n}, and the model has {Q.shape[1]} modes; ask for fewer")
    raise SolveError(f"the {n} modes have not converged with {Q.shape[1]} vectors", advice="ask for fewer modes")


def _direct_solver(A: PETSc.Mat) -> PETSc.KSP:
    """Return a solver that factors a symmetric matrix by MUMPS."""
    A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    ksp = PETSc.KSP().create(A.comm)
    ksp.setOperators(A)
    ksp.setType("preonly")
    ksp.getPC().setType("cholesky")
    ksp.getPC().setFactorSolverType("mumps")
    return ksp


def ksp_solve(ksp: PETSc.KSP, B: Array) -> Array:
    """Return the solutions (n, k) for k right-hand sides (n, k); n is the number of rows on this rank."""
    right, X = (_dense_matrix(ksp.getOperators()[0], values) for values in (B, np.empty_like(B)))
    ksp.matSolve(right, X)
    return _copied_values(X, right)


def multiply(A: PETSc.Mat, X: Array) -> Array:
    """Return the product (n, k) of a matrix and k vectors (n, k); n is the number of rows on this rank."""
    vectors = _dense_matrix(A, X)
    return _copied_values(A.matMult(vectors), vectors)


def _dense_matrix(A: PETSc.Mat, X: Array) -> PETSc.Mat:
    """Return k vectors (n, k) on the rows of `A` as columns of a matrix: all together are faster than one by one."""
    sizes = (A.getLocalSize()[0], None), (None, X.shape[1])
    return PETSc.Mat().createDense(sizes, array=np.array(X, float, order="F"), comm=A.comm)


def _copied_values(X: PETSc.Mat, *others: PETSc.Mat) -> Array:
    values = np.array(X.getDenseArray(), float)
    destroy(X, *others)
    return values


def _products(model: Model, X: Array, Y: Array) -> Array:
    """Return the scalar products (k, m) of k vectors `X` (n, k) and m vectors `Y` (n, m), summed over all ranks."""
    return np.asarray(model.comm.allreduce(X.T @ Y), float)


def solve_complex(
    real: Sequence[tuple[float, PETSc.Mat]], imaginary: Sequence[tuple[float, PETSc.Mat]], b: ComplexArray
) -> ComplexArray:
    """Return the solution (n,) of (Z' + i Z'') z = b for sums Z', Z'' of factors times matrices, as a real pair.

    The pair [[Z', -Z''], [-Z'', -Z']] is symmetric.
    """
    keys, n = ("real", "imaginary"), len(b)
    blocks = [Block(A, factor, "real", "real", kept=True) for factor, A in real]
    blocks += [Block(A, -factor, "imaginary", "imaginary", kept=True) for factor, A in real]
    blocks += [Block(A, -factor, *pair, kept=True) for pair in (keys, keys[::-1]) for factor, A in imaginary]
    pair = TangentMatrix(real[0][1].comm, dict.fromkeys(keys, n)).fill(blocks)
    ksp = _direct_solver(pair)
    solution = ksp_solve(ksp, np.concatenate([b.real, -b.imag])[:, None])[:, 0]
    destroy(ksp, pair)
    return solution[:n] + 1j * solution[n:]


def checked_factors(factors: Mapping[str, float]) -> dict[str, float]:
    """Return the loss factors by name of a seam or body, as floats; raise InputError if one is out of range."""
    for name, eta in factors.items():
        require(is_finite(eta) and eta >= 0, f"the loss factor of {name!r}", eta, "allowed: >= 0")
    return {name: float(eta) for name, eta in factors.items()}


# ---------------------------------------------------------------- range of validity
def layers_on_s(model: Model) -> dict[str, SeamLayer]:
    """Return the layers with a thickness that an interface model has on S, by seam."""
    layers = model.layers if isinstance(model, InterfaceModel) else {}
    return {name: layer for name, layer in layers.items() if layer.thin_layer}


def crossing_time(inertia: Inertia, layer: SeamLayer) -> float:
    """Return the time in which the slowest wave across a layer crosses it, where it is thickest."""
    joint, thin = layer.structure.joint, layer.as_thin_layer
    vertices = np.unique(joint.table.vertices[joint.rows_of(layer.name)])
    thickness = float(thin.eps * joint.relative_thickness(thin.profile, layer.name)[vertices].max())
    slownesses = []
    for sample in layer.samples:
        tangents = sample.initial_tangents
        pairs = [(a, acoustic_tensor(C, np.array(tangents.n))) for a, _, C in tangents.sublayers if C is not None]
        moduli = [(a, float(np.linalg.eigvalsh(modulus)[0])) for a, modulus in pairs]
        slownesses.append(sum(a * math.sqrt(inertia.density[layer.name] / modulus) for a, modulus in moduli))
    return thickness * max(slownesses)


def check_phases(model: Model, phases: Mapping[str, Array]) -> None:
    """Warn if waves in a layer on S are not long compared with its thickness; InputError if they are too short."""
    for name, values in phases.items():
        phase = float(values.max())
        text = f"a shear wave crosses the layer {name!r} in {phase:.3g} radians of the vibration"
        if phase > MAX_PHASE:
            raise InputError(f"{text}, and interface laws are for less than pi/2; mesh it, structure.full")
        if phase > WARN_PHASE:
            effect = f"its interface law has an error of up to {phase**2 / 12:.1%} of its energy"
            model.warn("phase", f"{text}: {effect}; mesh it, structure.full", name)


def check_levers(shapes: Sequence[State], omega: Array) -> None:
    """Warn if plates bend about a layer of order 0, which neglects its thickness as a lever arm."""
    model = shapes[0].model
    for name, layer in layers_on_s(model).items():
        if layer.as_thin_layer.order or not isinstance(model, InterfaceModel):
            continue
        sides, largest = model.sides_of(name), 0.0
        along = ufl.Identity(len(sides.n)) - ufl.outer(sides.n, sides.n)
        for state in (state for state, w in zip(shapes, omega, strict=True) if w):
            gradient = (sides.upper(ufl.grad(state.u)) + sides.lower(ufl.grad(state.u))) / 2
            vectors = layer.eps * ufl.dot(ufl.dot(sides.n, gradient), along), sides.jump(state.u)
            lever, jump = (state.integral(ufl.inner(v, v) * sides.factor * sides.measure) for v in vectors)
            largest = max(largest, math.sqrt(lever / jump) if jump > 0 else 0.0)
        if largest > MAX_LEVER:
            text = f"plates bend about the layer {name!r} of order 0, which neglects its thickness as a lever arm"
            model.warn("lever", f"{text}: {largest:.1%} of its jump; take order=1", name)
