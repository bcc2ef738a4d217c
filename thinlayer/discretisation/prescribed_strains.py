"""Strains added to those of displacements: the mean strain of a periodic cell, eigenstrains of bodies and layers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import ClassVar

import numpy as np
import ufl
from dolfinx import fem

from forms.base import Array, InputError, is_finite, is_number, require
from forms.kinematics import Kinematics
from forms.law import BulkLaw
from forms.law_tangents import tangent_at_rest
from forms.temperature import finite_values
from forms.tensors import MANDEL_PAIRS, SQRT2, Expr, scalar_strain, three_dimensional
from forms.work import Term, sum_strains
from geometry.joint import Joint
from thinlayer.discretisation.coefficient import Coordinates, HandsOver, depends_on_place, time_constants
from thinlayer.system.compat import compiled

MEAN_STRAIN = "mean strain"  # key of the mean strain under a mean stress, in the fields of states
MeanTensorInput = Sequence[Sequence[float]] | Array | Callable[[Expr, Expr], Sequence[Sequence[Expr]]]
VOIGT_PAIRS_OF_DIM = {2: ((0, 0), (1, 1), (0, 1)), 3: ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))}  # Voigt's order
VOIGT_POSITIONS_OF_DIM = {2: np.array([[0, 2], [2, 1]]), 3: np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])}  # of entries
TensorRows = list[list[Expr]]  # numbers, or UFL scalars of place and time
TensorInput = float | Sequence[Sequence[float]] | Array | Callable[[Expr, Expr], Expr]
SYMMETRY_TOLERANCE = 1e-12  # largest difference of a table from its transpose, over its largest entry
# smallest singular value of a stiffness, over its largest, up to which it is singular: no strain causes some stresses
SINGULARITY_TOLERANCE = 1e-12


class MeanStrain:
    """Prescribed mean strain of a periodic cell, as a function of time.

    Args:
        value: (d, d) symmetric numbers in d dimensions, or a function (x, t) of the time alone that returns them.
        at: coordinates and time.
        joint: the periodic joint.

    Attributes:
        size: largest extent of the periodic cell along an axis, a length.
        expression: the prescribed tensor in UFL, (3, 3), a function of the time; components out of the plane are zero.

    Raises:
        InputError: the joint is not periodic; the value is not (d, d) finite numbers, not symmetric, or depends on the
            place.
    """

    what: ClassVar[str] = "the mean strain"
    rank: ClassVar[int] = 2

    def __init__(self, value: MeanTensorInput, at: Coordinates, joint: Joint) -> None:
        if joint.periods is None:
            raise InputError(f"{self.what} needs a periodic joint; see geometry.periodic")
        self._dim = d = joint.dim
        coefficient = at.coefficient(value, self.what, (d,) * self.rank)
        self._coefficient, self.size = coefficient.once("the whole cell"), joint.size
        self.expression = (three_dimensional, scalar_strain)[self.rank == 1](self._coefficient.expression)
        if not self._coefficient.varies:
            self.tensor_at(0.0)

    def tensor_at(self, t: float) -> Array:
        """Return the prescribed tensor (d, d) at the time t.

        Raises:
            InputError: it is not finite or not symmetric.
        """
        strain = self._coefficient.at_time(t)
        if self.rank == 2:
            require_symmetric(strain, f"{self.what} at t = {t:g}")
        return strain


class MeanGradient(MeanStrain):
    """Prescribed mean gradient of a scalar field in a periodic cell, (d,) numbers or a function of the time."""

    what = "the mean gradient"
    rank = 1


class MeanStress(MeanStrain):
    """Prescribed mean stress of a periodic cell, as a function of time; its mean strain is unknown.

    Args:
        value: (d, d) symmetric numbers in d dimensions, or a function (x, t) of the time alone that returns them.
        at: coordinates and time.
        joint: the periodic joint.
        bodies: terms of the bodies and of meshed layers.

    Raises:
        InputError: the value or the joint is not allowed for a `MeanStrain`; the cell is not periodic in all
            directions; a law of `bodies` is not linear, or has a stress without strain.
    """

    what = "the mean stress"

    def __init__(self, value: MeanTensorInput, at: Coordinates, joint: Joint, bodies: Sequence[Term]) -> None:
        super().__init__(value, at, joint)
        self.n_voigt = len(VOIGT_PAIRS_OF_DIM[joint.dim])
        assert joint.periods is not None  # as the base class requires
        if np.linalg.matrix_rank(joint.periods.vectors(joint.points)) < (d := joint.dim):
            raise InputError(f"a mean stress needs a joint periodic in {d} directions; load free sides by tractions")
        for p in bodies:
            if not p.law.traits.proportional:
                raise InputError(f"mean stress needs linear bodies without stress at rest, not {p.law!r}; give strain")

    def voigt_components(self, t: float) -> Array:
        """Return the components (k,) of the stress at the time t in Voigt's order.

        This is 11, 22, 12 in two dimensions, and 11, 22, 33, 23, 13, 12 in three.
        """
        return self.tensor_at(t)[tuple(np.array(VOIGT_PAIRS_OF_DIM[self._dim]).T)]


def from_voigt(e: Expr) -> Expr:
    """Return the strain tensor (d, d) for a UFL vector e of strains in Voigt's order, with engineering shear strains.

    The shears in e are twice the components of the tensor.
    """
    d = {3: 2, 6: 3}[e.ufl_shape[0]]
    voigt_index = VOIGT_POSITIONS_OF_DIM[d].tolist()
    return ufl.as_tensor([[e[voigt_index[i][j]] / (1 if i == j else 2) for j in range(d)] for i in range(d)])


@dataclass(frozen=True)
class EigenstrainContext:
    """Data of a body or a layer on which its eigenstrain depends.

    Attributes:
        name: name of the body or layer in messages.
        law: law of the body or layer, for example its plane-stress form if the mesh is in plane stress. Its parameters
            are numbers or functions of the place.
        n: mean unit normal of S, (d,) in d dimensions.
        kinematics: rule by which strains follow from displacements: plane strain or stress, axisymmetric or 3D.
        at: coordinates and time, the arguments of values that are functions.
    """

    name: str
    law: BulkLaw
    n: Array
    kinematics: Kinematics
    at: Coordinates

    def tensor_rows(self, value: object, what: str) -> TensorRows:
        """Return a user's tensor as rows of numbers or UFL scalars.

        The rows have the shape (d, d) or (3, 3) of the user's table. A single number becomes a multiple of the identity
        (3, 3).

        Args:
            value: the tensor as the user wrote it.
            what: name of the tensor in messages.

        Raises:
            InputError: another shape, components that are not finite numbers, or a table that is not symmetric.
        """
        what, d = f"{what} of {self.name}", len(self.n)
        coefficient = self.at.coefficient(value, what, (), (d, d), (3, 3))
        if not coefficient.shape:
            return [[coefficient.components[()] if i == j else 0.0 for j in range(3)] for i in range(3)]
        rows: TensorRows = coefficient.components.tolist()
        require_symmetric(rows, what)
        return rows

    def scalar(self, value: object, what: str) -> Expr:
        """Return a user's scalar value as a number or in UFL; `what` names it in messages.

        Raises:
            InputError: it is neither a number nor a scalar function.
        """
        return self.at.coefficient(value, f"{what} of {self.name}", ()).components[()]

    def prescribed_strain(self, eigenstrain: EigenstrainInput | None) -> Expr | None:
        """Return minus the eigenstrain of the body or layer, (3, 3) in UFL, which is added to the displacements' strain.

        Return None if it is zero.

        Args:
            eigenstrain: the eigenstrain as the user wrote it; None: there is none.

        Raises:
            InputError: a value that is not an eigenstrain, or that does not suit this body or layer.
        """
        if eigenstrain is None:
            return None
        summands = (self._negative_tensor(summand.components(self)) for summand in eigenstrain_list(eigenstrain))
        total = self.kinematics.admissible_part(sum_strains(*summands))
        return None if all(isinstance(total[i, j], ufl.classes.Zero) for i in range(3) for j in range(3)) else total

    def _negative_tensor(self, rows: TensorRows) -> Expr:
        """Return a table (3, 3) of numbers and UFL scalars, times -1, as a UFL tensor.

        Numbers become Constants, so that forms are compiled once for all numbers; zeros are left as they are.
        """
        numbers = np.array([[-c if isinstance(c, float) else 0.0 for c in row] for row in rows])
        constant = fem.Constant(self.at.mesh, numbers)
        entries = [[constant[i, j] if numbers[i, j] else -c for j, c in enumerate(row)] for i, row in enumerate(rows)]
        return ufl.as_tensor(entries)


def require_symmetric(rows: TensorRows | Array, what: str) -> None:
    """Raise InputError if a table is not symmetric; `what` names it in the message.

    Components in UFL count as equal only if they are the same expression.
    """
    magnitudes = [abs(c) for row in rows for c in row if isinstance(c, float)]
    for i, j in combinations(range(len(rows)), 2):
        a, b = rows[j][i], rows[i][j]
        are_numbers = isinstance(a, float) and isinstance(b, float)
        if not (abs(a - b) <= SYMMETRY_TOLERANCE * max(magnitudes) if are_numbers else ufl.as_ufl(a) == ufl.as_ufl(b)):
            raise InputError(f"{what} is not symmetric: components {j + 1}{i + 1} and {i + 1}{j + 1} are {a}, {b}")


class Eigenstrain(ABC):
    """A strain that a material would have without stress: its stress comes from the strain minus the eigenstrain."""

    @abstractmethod
    def components(self, context: EigenstrainContext) -> TensorRows:
        """Return the eigenstrain of a body or layer as rows (3, 3) of numbers or UFL scalars.

        Raises:
            InputError: it does not suit the material.
        """

    def __rmul__(self, factor: float) -> Eigenstrain:
        return EigenstrainMultiple(factor, self)


@dataclass(frozen=True)
class EigenstrainMultiple(Eigenstrain):
    """An eigenstrain times a factor."""

    factor: float
    eigenstrain: Eigenstrain

    def components(self, context: EigenstrainContext) -> TensorRows:
        """Return the eigenstrain of a body or layer, times the factor, as rows (3, 3) of numbers or UFL scalars."""
        return [[self.factor * c for c in row] for row in self.eigenstrain.components(context)]


@dataclass(frozen=True)
class PrescribedEigenstrain(Eigenstrain):
    """An eigenstrain given directly: a number times the identity, a table (d, d) or (3, 3), or a function (x, t).

    The function returns such a number or table.
    """

    value: object

    def components(self, context: EigenstrainContext) -> TensorRows:
        """Return the eigenstrain of a body or layer as rows (3, 3) of numbers or UFL scalars.

        Raises:
            InputError: the value is not a symmetric tensor, or not finite.
        """
        rows = context.tensor_rows(self.value, "the eigenstrain")
        return [[rows[i][j] if max(i, j) < len(rows) else 0.0 for j in range(3)] for i in range(3)]


@dataclass(frozen=True)
class ThermalExpansion(Eigenstrain):
    """Thermal expansion by a change of temperature: the eigenstrain alpha (T - reference).

    With a DOLFINx Function as T, making a model is collective. Another process, such as a restart, cannot recognise the
    Function, and takes it for changed data.

    Attributes:
        alpha: coefficient of expansion, per degree: a number, three of them along the axes x, y, z, or a symmetric
            table (3, 3).
        T: change of temperature, degrees: a number, a function (x, t) of UFL coordinates, `piecewise`, or a scalar
            DOLFINx Function on a mesh that covers the bodies. Or the temperature itself: a state of heat, or a history,
            which is linear in time between its states. A layer on S takes the values on both sides, linear through the
            thickness; of order 0 their mean. Its mean in a state of order 2 is not among them: give
            `Surface.function` of `Surface.value_in_layer` for it.
        factor: factor of T - reference, a number or a function (x, t). With it a DOLFINx Function can grow in time;
            otherwise it acts suddenly.
        reference: temperature without strain; needed if T is a state or a history. None: T is a change from it.

    Raises:
        InputError: alpha of another shape, not finite or not symmetric; T or factor that is not a number or a function.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, Surface, ThermalExpansion, ThinLayer, solve
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> heated = ThermalExpansion(12e-6, T=50)
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, eigenstrain={"UPPER": heated}
        ... )
        >>> state = solve(plates.interface(ThinLayer(glue, eps=0.05)))
        >>> jump = Surface(state.model).jump(state)
        >>> f"{jump[0, -1, -1]:.2g}"  # along S, near its right end
        '0.0011'
    """

    alpha: float | Sequence[float] | Sequence[Sequence[float]] | Array
    T: float | Callable[[Expr, Expr], Expr] | fem.Function | HandsOver
    factor: float | Callable[[Expr, Expr], Expr] = 1.0
    reference: float | None = None

    def __post_init__(self) -> None:
        alpha = finite_values(self.alpha, (), (3,), (3, 3))
        require(alpha is not None, "alpha", self.alpha, "allowed: a finite number, three, or a symmetric (3, 3)")
        if np.ndim(self.alpha) == 2:
            require_symmetric(np.array(self.alpha, float), "alpha")
        is_field, reference = isinstance(self.T, HandsOver), self.reference
        for name, value in (("the change of temperature T", 0.0 if is_field else self.T), ("factor", self.factor)):
            require(callable(value) or is_finite(value), name, value, "allowed: a finite number or a function (x, t)")
        hint = "give the temperature without strain, a number" + "; only T of a state needs it" * (not is_field)
        require(is_finite(reference) or not (is_field or reference is not None), "reference", reference, hint)

    def components(self, context: EigenstrainContext) -> TensorRows:
        """Return the eigenstrain of a body or layer as rows (3, 3) of numbers or UFL scalars.

        Raises:
            InputError: the temperature or its factor is not a scalar, or only one of both models has an axis.
        """
        if isinstance(self.T, HandsOver) and (model := getattr(self.T, "model", None)):
            is_alike = model.kinematics.has_axis == context.kinematics.has_axis
            require(
                is_alike, f"the temperature of {context.name}", self.T, "give the state of a model with this plane="
            )
        T, scale = context.scalar(self.T, "the change of temperature T"), context.scalar(self.factor, "the factor of T")
        T, alpha = scale * (T - self.reference if self.reference else T), np.array(self.alpha, float)
        table = alpha if alpha.ndim == 2 else np.diag(np.broadcast_to(alpha, 3))
        return [[a * T if a else 0.0 for a in row] for row in table.tolist()]


@dataclass(frozen=True)
class Prestress(Eigenstrain):
    """A stress before any displacement, such as the in-situ stress of rock: an eigenstrain -C^-1 sigma.

    C is the tangent of the law at zero strain. For laws that creep or relax it is that of a sudden strain. Laws that
    yield compare the whole stress, sigma included, with their strength. Displacements are measured from the state with
    this stress.

    Attributes:
        sigma: stress, tension > 0: a number (times the identity), a symmetric table (3, 3), or a function (x, t). In
            two dimensions also (2, 2): sigma_33 follows from plane strain, as lmbda/(2 (lmbda + mu)) (s_11 + s_22) for
            isotropic laws. In plane stress sigma_33 is zero, and only this is allowed. Bodies of revolution need
            (3, 3), with the hoop stress.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Prestress, Probe, Structure, ThinLayer, solve
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> stressed = Prestress(((20, 0), (0, 0)))
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, eigenstrain={"LOWER": stressed}
        ... )
        >>> state = solve(plates.interface(ThinLayer(glue, eps=0.05)))
        >>> f"{Probe(state).stress((2, -0.5), side='lower')[0, 0]:.3g}"
        '14.4'
    """

    sigma: TensorInput

    def components(self, context: EigenstrainContext) -> TensorRows:
        """Return the eigenstrain of a body or layer as rows (3, 3) of numbers or UFL scalars.

        Raises:
            InputError: sigma has components that the kinematics exclude, or lacks some; the stiffness is not known.
        """
        sigma = context.tensor_rows(self.sigma, "the prestress")
        if context.kinematics.name == "stress":
            out_of_plane = [sigma[i][2] for i in range(3)] if len(sigma) == 3 else []
            if any(not isinstance(c, float) or c for c in out_of_plane):
                raise InputError(f"the prestress of {context.name} has components out of the plane; give (2, 2)")
            sigma = [row[:2] for row in sigma[:2]]
        if len(sigma) == 2 and 2 in context.kinematics.strain_indices(2):
            raise InputError(f"the prestress of {context.name} lacks that of hoops, sigma_33; give (3, 3)")
        mandel_indices = [index for index, (_, j) in enumerate(MANDEL_PAIRS) if j < len(sigma)]
        index_pairs = [(*MANDEL_PAIRS[index], 1.0 if index < 3 else SQRT2) for index in mandel_indices]
        strain: TensorRows = [[0.0] * 3 for _ in range(3)]
        for row, (i, j, scale) in zip(self._compliance(context, mandel_indices), index_pairs, strict=True):
            summands = [-float(c) * s / scale * sigma[k][m] for c, (k, m, s) in zip(row, index_pairs, strict=True) if c]
            strain[i][j] = strain[j][i] = sum(summands, 0.0)
        return strain

    def _compliance(self, context: EigenstrainContext, mandel_indices: Sequence[int]) -> Array:
        """Return the compliance (k, k), strain per stress, of k components in Mandel's notation, at zero strain.

        Strains in the other components are zero.

        Args:
            context: data of the body or layer.
            mandel_indices: (k,) positions of the components in Mandel's order.

        Raises:
            InputError: the stiffness is not known, varies from place to place, or cannot be inverted.
        """
        law = context.law

        def prestress_error(why: str) -> InputError:
            return InputError(f"the prestress of {context.name}: {why}; give its eigenstrain instead")

        if len(law.sublayers) > 1:
            raise prestress_error("its sublayers have stiffnesses of their own")
        try:
            C = tangent_at_rest(law, context.n)
        except TypeError as error:
            if not law.fields:
                raise
            raise prestress_error(f"its stiffness varies from place to place ({', '.join(law.fields)})") from error
        if C is None or not np.isfinite(C).all():
            raise prestress_error(f"the stiffness of {type(law).__name__} is not known at rest")
        C = C[np.ix_(mandel_indices, mandel_indices)]
        singular_values = np.linalg.svd(C, compute_uv=False)
        if singular_values[-1] <= SINGULARITY_TOLERANCE * singular_values[0]:
            raise prestress_error(f"no strain of {type(law).__name__} causes some stresses")
        compliance = np.asarray(np.linalg.inv(C))
        if law.traits.constrained and not law.volume_compliance:
            is_normal = np.array(mandel_indices) < 3  # the pressure carries volumetric stresses
            deviator = np.eye(len(mandel_indices)) - np.outer(is_normal, is_normal) / is_normal.sum()
            compliance = deviator @ compliance @ deviator
        return compliance


EigenstrainInput = TensorInput | Eigenstrain | Sequence[TensorInput | Eigenstrain]


def eigenstrain_list(eigenstrain: EigenstrainInput) -> list[Eigenstrain]:
    """Return a user's eigenstrain, or list of eigenstrains, as a list of `Eigenstrain` objects, which add up."""
    if isinstance(eigenstrain, Eigenstrain):
        return [eigenstrain]
    if isinstance(eigenstrain, (list, tuple)) and not _is_table(eigenstrain):
        allowed = "a number, a table, a function (x, t), ThermalExpansion, Prestress, a list of these that add up"
        require(not all(map(is_number, eigenstrain)), "the eigenstrain", eigenstrain, f"allowed: {allowed}")
        return [strain for summand in eigenstrain for strain in eigenstrain_list(summand)]
    return [PrescribedEigenstrain(eigenstrain)]


def _is_table(rows: Sequence[object]) -> bool:
    """Return whether a list has rows of scalars, as a table has, and not several eigenstrains."""
    return bool(rows) and all(isinstance(row, (list, tuple, np.ndarray)) and np.ndim(row[0]) == 0 for row in rows)


class VaryingStrainIntegrals:
    """Integrals of prescribed strains over single cells or facets, for strains that vary in time or place. Collective.

    Terms whose prescribed strains do not vary are left out.

    Args:
        terms: the terms of bodies and layers.
        at: coordinates and time.
    """

    def __init__(self, terms: Sequence[Term], at: Coordinates) -> None:
        self._at, self._forms_by_term = at, []
        for p in terms:
            strain = p.prescribed_strain
            if strain is not None and (time_constants(strain) or depends_on_place(strain)):
                q = ufl.TestFunction(fem.functionspace(at.mesh, ("DG", 0, (3, 3))))
                q = q("+") if p.measure.integral_type() == "interior_facet" else q
                self._forms_by_term.append((p, compiled(ufl.inner(strain, q) * p.measure)))

    def integrals_at(self, t: float) -> list[Array]:
        """Return, for each term with a strain that varies, the strain's integrals over this rank's cells or facets.

        They are those at the time t. Each array has the 9 components in one cell after those in another.

        Raises:
            InputError: a strain that is not finite.
        """
        with self._at.clock.at(t):
            integrals = [np.asarray(fem.assemble_vector(form).array) for _, form in self._forms_by_term]
        for (p, _), values in zip(self._forms_by_term, integrals, strict=True):
            if self._at.mesh.comm.allreduce(int(not np.isfinite(values).all())):
                text = "layer" if p.n is not None else "bodies"
                raise InputError(f"the eigenstrain of the {p.key or text} is not finite at t = {t:g}")
        return integrals
