"""Linear solvers of a model: PETSc options, factors, matrices that similar models share, and blocks with pressures.

If pressures on S are unknowns, the tangent has the blocks [A B'; B -C]. A is the stiffness for displacements, and B
couples displacements and pressures. C contains the compliance and the flow of the layer, and is assembled.

PETSc's PCFIELDSPLIT preconditions the tangent block by block. It needs the Schur complement of the pressures, which is
-(C + B A^-1 B'). The product B A^-1 B' is the compliance of the sides of S under pressures. PETSc computes it with the
diagonal of A in place of A ("selfp"). This is right for pressures that vary from cell to cell. Where bodies are stiff,
or pressures vary over short lengths, C is the larger term.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from forms.base import Array, InputError
from forms.work import Term
from geometry.topology import BoolArray
from thinlayer.discretisation.constraints import create_aij
from thinlayer.discretisation.model import Model
from thinlayer.parts.part import DISPLACEMENT_KEY, FieldPart, Part
from thinlayer.parts.pressure_part import PressurePart
from thinlayer.solving.part_sum import TangentMatrix, UnknownLayout
from thinlayer.solving.petsc import PREFIX, OptionDict, convert_to_baij, db_options, lean_products, set_residual_matrix
from thinlayer.system.ranks import destroy

# blocks of low rank, to rounding: less time and memory from 1e5 unknowns on
LOW_RANK_OPTIONS = OptionDict(mat_mumps_icntl_35=2, mat_mumps_cntl_7=1e-14)
# mat_mumps_icntl_14: spare memory in per cent; with the default of 20 MUMPS may fail on several ranks
DIRECT_OPTIONS = OptionDict(
    ksp_type="preonly", ksp_rtol=1e-10, pc_factor_mat_solver_type="mumps", mat_mumps_icntl_14=100, **LOW_RANK_OPTIONS
)
# dimension -> ordering of MUMPS: 2D: unknowns, not nodes, by least fill, for fewer entries on grids; 3D: nodes, by PORD
ORDERING_OPTIONS = {2: OptionDict(mat_mumps_icntl_7=2, mat_mumps_icntl_15=0), 3: OptionDict(mat_mumps_icntl_7=4)}
# for saddle points at which MUMPS delays many pivots: more memory and smaller pivots
SADDLE_POINT_OPTIONS = OptionDict(mat_mumps_icntl_14=1000, mat_mumps_cntl_1=1e-4)
GAMG_OPTIONS = OptionDict(pc_type="gamg", pc_gamg_aggressive_coarsening=2, pc_gamg_aggressive_square_graph=False)
HIERARCHY_OPTIONS = OptionDict(  # algebraic multigrid as a preconditioner
    GAMG_OPTIONS, pc_gamg_threshold=0.01, mg_levels_ksp_type="chebyshev", mg_levels_pc_type="jacobi"
)
MULTIGRID_OPTIONS = OptionDict(DIRECT_OPTIONS, ksp_max_it=200, **HIERARCHY_OPTIONS)
MULTIGRID_PC_TYPES = ("gamg", "hypre", "ml")  # PETSc's kinds of algebraic multigrid, for the displacements
# for saddle points: multigrid for the displacements after a factorisation for the pressures on S, see above. This
# preconditioner is not symmetric. It takes half the iterations of a symmetric one for MINRES, at the same cost each.
FIELD_SPLIT_OPTIONS: OptionDict = {
    "ksp_type": "gmres",
    "ksp_pc_side": "right",  # then the convergence test uses the residual itself
    "ksp_gmres_restart": 100,
    "ksp_gmres_cgs_refinement_type": "refine_ifneeded",
    **{name: MULTIGRID_OPTIONS[name] for name in ("ksp_rtol", "ksp_max_it")},
    "pc_type": "fieldsplit",
    "pc_fieldsplit_type": "schur",
    "pc_fieldsplit_schur_fact_type": "upper",
    "pc_fieldsplit_schur_precondition": "selfp",
    **{f"fieldsplit_u_{name}": value for name, value in HIERARCHY_OPTIONS.items()},
    "fieldsplit_u_ksp_type": "preonly",
    **{f"fieldsplit_p_{name}": v for name, v in (DIRECT_OPTIONS | ORDERING_OPTIONS[2]).items() if name != "ksp_rtol"},
    "fieldsplit_p_pc_type": "cholesky",
}
# dimension -> number of unknowns from which on multigrid is faster than a factor, even if steps share the factor
MIN_MULTIGRID_UNKNOWNS = {2: 3_000_000, 3: 50_000}


def solver_options(model: Model, parts: Sequence[Part], pctype: str | None = None) -> list[OptionDict]:
    """Return the PETSc options of the linear solvers that suit a model, in the order in which they are tried.

    The direct solver is MUMPS: Cholesky for symmetric tangents, else LU. Large models first try conjugate gradients
    (GMRES if not symmetric) with algebraic multigrid, to which the rigid motions are passed. If this fails, as for very
    stiff layers, the direct solver follows.

    If layers have pressures as unknowns, the tangent is indefinite (a saddle point). Large models with all pressures on
    S then first try GMRES, preconditioned by the blocks of displacements and pressures. If MUMPS fails, it is tried
    again with more memory and smaller pivots.

    Args:
        model: the model.
        parts: the parts of its balance of forces.
        pctype: PETSc's type of preconditioner (pc_type) that the user has chosen; None: the default.

    Returns:
        For each solver {name of a PETSc option without prefix: value}.

    Raises:
        InputError: the chosen type of preconditioner does not suit the model.
    """
    direct_options = direct_solver_options(model)
    is_large = model.unknowns >= MIN_MULTIGRID_UNKNOWNS[model.joint.dim]
    if any(isinstance(part, PressurePart) for part in parts):
        if pctype in MULTIGRID_PC_TYPES:
            raise InputError(f"pc_type {pctype} cannot solve for the pressures of a layer, too; use pc_type fieldsplit")
        attempts = [direct_options, {**direct_options, **SADDLE_POINT_OPTIONS}]
        unsuited = [part.key for part in parts if isinstance(part, FieldPart) and not part.on_S]
        if pctype == "fieldsplit" and unsuited:
            reason = f"not for {unsuited[0]!r} (of a meshed layer, a plate or a mean stress); use pc_type cholesky"
            raise InputError(f"pc_type fieldsplit is for displacements and pressures on S, {reason}")
        return [FIELD_SPLIT_OPTIONS, *attempts] if pctype == "fieldsplit" or (is_large and not unsuited) else attempts
    iterative_options = {**MULTIGRID_OPTIONS, "ksp_type": "cg" if model.symmetric else "gmres"}
    if pctype in MULTIGRID_PC_TYPES:
        return [iterative_options]
    return [iterative_options, direct_options] if is_large else [direct_options]


def direct_solver_options(model: Model) -> OptionDict:
    """Return the PETSc options of the direct solver: Cholesky for a symmetric model, else LU.

    MUMPS computes an LDL^T factor in place of Cholesky's, unless the matrix is marked as positive definite.
    """
    return {**DIRECT_OPTIONS, **ORDERING_OPTIONS[model.joint.dim], "pc_type": "cholesky" if model.symmetric else "lu"}


def needs_factor_only() -> bool:
    """Whether linear solves need the assembled matrix only while they are set up.

    This depends on the options in PETSc's database. It holds for a factorisation by MUMPS, and for algebraic multigrid
    (gamg), which keeps a copy in blocks.
    """
    options, names = db_options(), ("ksp_type", "pc_factor_mat_solver_type")
    return options.get("pc_type") == "gamg" or all(options.get(name) == DIRECT_OPTIONS[name] for name in names)


def pivot_ratio(pc: PETSc.PC) -> float:
    """Return the ratio of the smallest to the largest pivot in MUMPS's Cholesky factor; 0 if it is unknown."""
    if pc.getType() != "cholesky" or pc.getFactorSolverType() != "mumps":
        return 0.0
    smallest, largest = (pc.getFactorMatrix().getMumpsRinfog(k) for k in (20, 21))
    return smallest / largest if largest else 0.0


def mark_symmetry(A: PETSc.Mat, model: Model, *, is_saddle: bool) -> None:
    """Tell PETSc whether a tangent is symmetric and whether it is positive definite.

    Args:
        A: the tangent.
        model: its model.
        is_saddle: whether the tangent may have eigenvalues of both signs, so that it is not positive definite.
    """
    A.setOption(PETSc.Mat.Option.SYMMETRIC, model.symmetric)
    A.setOption(PETSc.Mat.Option.SPD, model.symmetric and model.linear and not is_saddle)


class Factor:
    """Linear solver (PETSc KSP) that keeps the factor or preconditioner of a matrix for several solves. Collective.

    Attributes:
        ksp: the linear solver; None before the first `renew`.
        matrix_key: key that identifies the factorised matrix; None: the matrix is unknown.
    """

    def __init__(self) -> None:
        self.ksp: PETSc.KSP = None
        self.matrix_key: Hashable = None
        self._options: dict[str, str] = {}
        self._baij_copy: PETSc.Mat | None = None

    def renew(self, A: PETSc.Mat, key: Hashable, set_data: Callable[[PETSc.KSP, PETSc.Mat], None]) -> bool:
        """Give the linear solver another matrix, which it factorises in the next solve.

        Args:
            A: the matrix.
            key: key that identifies the matrix.
            set_data: function that passes further data to the preconditioner, such as rigid motions. Its arguments are
                the linear solver and the matrix.

        Returns:
            Whether the same KSP object is used as before. It then orders the unknowns anew only for another nonzero
                pattern.
        """
        options = db_options()
        is_kept = self.ksp is not None and options == self._options and self.ksp.getPC().getType() != "fieldsplit"
        if not is_kept:
            self.destroy()
            self.ksp = PETSc.KSP().create(A.comm)
            self.ksp.setOptionsPrefix(PREFIX)
        self.ksp.setOperators(A)
        self.ksp.getPC().setReusePreconditioner(False)
        if not is_kept:
            self.ksp.setFromOptions()
        set_data(self.ksp, A)
        if self.ksp.getPC().getType() == "gamg":
            self._set_up_in_blocks(A)
        self._options, self.matrix_key = options, key
        return is_kept

    def set_up(self) -> None:
        """Factorise the matrix now. All solves until the next `renew` use this factor, even if the matrix changes."""
        self.ksp.setUp()
        self.ksp.getPC().setReusePreconditioner(True)

    def _set_up_in_blocks(self, A: PETSc.Mat) -> None:
        """Build the multigrid hierarchy of `A` with its matrices in block format, which multiply faster.

        `A` itself is not converted; the finest level uses a copy.
        """
        pc = self.ksp.getPC()
        with lean_products():
            self.ksp.setUp()
        destroy(self._baij_copy)
        self._baij_copy, finest = convert_to_baij(A, PETSc.Mat().create(A.comm)), pc.getMGLevels() - 1
        for level in range(1, finest):  # the coarsest has a factor instead of a smoother
            convert_to_baij(pc.getMGSmoother(level).getOperators()[0])
        if finest:
            pc.getMGSmoother(finest).setOperators(self._baij_copy)
            set_residual_matrix(pc, finest, self._baij_copy)
        pc.setReusePreconditioner(True)
        self.ksp.setOperators(self._baij_copy)

    def destroy(self) -> None:
        """Free the linear solver and its factor."""
        destroy(self.ksp, self._baij_copy)
        self.ksp = self.matrix_key = self._baij_copy = None


class SubmatrixFactor:
    """MUMPS's factor of the rows and columns of a matrix that a mask selects, by default of all, on one rank."""

    def __init__(self, K: csr_matrix, mask: BoolArray | None = None, *, symmetric: bool = False) -> None:
        self._mask, self._symmetric = np.ones(K.shape[0], bool) if mask is None else mask, symmetric
        A = create_aij(K[self._mask][:, self._mask].sorted_indices(), PETSc.COMM_SELF)
        A.setOption(PETSc.Mat.Option.SYMMETRIC, symmetric)
        self._ksp = PETSc.KSP().create(PETSc.COMM_SELF)
        self._ksp.setOperators(A)
        self._ksp.setType("preonly")
        pc = self._ksp.getPC()
        pc.setType("cholesky" if symmetric else "lu")
        pc.setFactorSolverType("mumps")
        pc.setFactorSetUpSolverType()
        pc.getFactorMatrix().setMumpsIcntl(14, 100)  # as in `DIRECT_OPTIONS`: spare memory in per cent
        self._x, self._b = A.createVecs()

    @property
    def negative_pivots(self) -> int:
        """Number of negative eigenvalues of the submatrix; 0 if it is not symmetric."""
        return int(self._ksp.getPC().getFactorMatrix().getMumpsInfog(12)) if self._symmetric and self._mask.any() else 0

    def solve(self, b: Array, out: Array) -> float:
        """Solve for the selected rows of the right-hand side `b` (n,), and write the solution into those of `out` (n,).

        Returns:
            Product of the solution and the right-hand side: for forces `b`, their work.
        """
        if not self._mask.any():
            return 0.0
        self._b.array[:] = b[self._mask]
        self._ksp.solve(self._b, self._x)
        out[self._mask] = self._x.array_r
        return float(self._b.dot(self._x))


class SharedMatrices:
    """Matrices that the solvers of similar models, those of one `ModelFamily`, use one after the other.

    Attributes:
        bodies: parts of the balance that depend on the mesh and the bodies alone; empty before they are created.
        matrix: the tangent; None before it is created.
        factor: linear solver with the factor of the tangent.
    """

    def __init__(self) -> None:
        self.bodies: Sequence[Part] = ()
        self.matrix: TangentMatrix | None = None
        self.factor = Factor()
        self._terms: Sequence[Term] = ()
        self._pattern_key: object = None

    @classmethod
    def acquire(cls, model: Model) -> SharedMatrices:
        """Return the matrices that the last solver in the model's `ModelFamily` has left, or new ones.

        A tangent with a nonzero pattern that does not suit this model is freed before.
        """
        shared: SharedMatrices = model.family.idle_matrices or cls()
        model.family.idle_matrices = None
        layer_kinds = [(name, type(s.law), s.thin_layer and s.thin_layer.order) for name, s in model.layers.items()]
        pattern_key = layer_kinds, [(p.key, type(p.law), p.law.traits, len(p.law.sublayers)) for p in model.layer_terms]
        if pattern_key != shared._pattern_key:
            shared.free()
        if model.layer_terms is not shared._terms:
            shared.factor.matrix_key = None
        shared._terms, shared._pattern_key = model.layer_terms, pattern_key
        return shared

    def release(self, model: Model) -> None:
        """Leave the matrices to the next solver of `model`, or of a similar model in its `ModelFamily`.

        If no other model was made from this one, no next solver can come: then free the matrices at once.
        """
        for part in self.bodies:
            vars(part).pop("interval", None)  # its state refers to a model of the family
        family = model.family
        unused = family.idle_matrices if family.is_shared else self
        if unused is not None:
            unused.free()
        family.idle_matrices = self if family.is_shared else None

    def free(self) -> None:
        """Free the tangent and its factor."""
        destroy(self.factor, self.matrix)
        self.matrix = None


# ---------------------------------------------------------------- blocks with pressures
def orthonormalise(vectors: list[PETSc.Vec]) -> list[PETSc.Vec]:
    """Orthonormalise linearly independent vectors in place, and return them."""
    for k, v in enumerate(vectors):
        for earlier in vectors[:k]:
            v.axpy(-v.dot(earlier), earlier)
        v.normalize()
    return vectors


def set_field_split(pc: PETSc.PC, A: PETSc.Mat, layout: UnknownLayout, motions: list[PETSc.Vec]) -> None:
    """Define the two blocks of a PCFIELDSPLIT: "u", the displacements, and "p", the pressures. Collective.

    Args:
        pc: the preconditioner, which has read its options.
        A: the tangent, with Dirichlet conditions applied.
        layout: order of the unknowns in a vector: displacements, then pressures on S.
        motions: vectors of the rigid motions; only their displacements are used.
    """
    row_start, row_end = A.getOwnershipRange()
    n_u, bs = layout.sizes[DISPLACEMENT_KEY], layout.fields[DISPLACEMENT_KEY].function_space.dofmap.index_map_bs
    rows_u = PETSc.IS().createStride(n_u, row_start, 1, comm=A.comm)
    rows_u.setBlockSize(bs)
    rows_p = PETSc.IS().createStride(row_end - row_start - n_u, row_start + n_u, 1, comm=A.comm)
    rigid_u = [PETSc.Vec().createWithArray(v.array_r[:n_u].copy(), (n_u, None), bsize=bs, comm=A.comm) for v in motions]
    rows_u.compose("nearnullspace", PETSc.NullSpace().create(vectors=orthonormalise(rigid_u), comm=A.comm))
    pc.setFieldSplitIS(("u", rows_u), ("p", rows_p))
