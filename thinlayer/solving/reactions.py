"""Reactions of supports, rigid plates and rigid bases, and the test whether every body is supported."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
import scipy.sparse
from petsc4py import PETSc
from scipy.linalg import block_diag
from scipy.sparse.linalg import splu

from forms.base import Array
from geometry.refusals import place_text
from geometry.topology import Indices, IntArray
from thinlayer.discretisation.boundary import AXIS_NAMES
from thinlayer.discretisation.constraints import distributed_product
from thinlayer.discretisation.contact_nodes import nodes_of_sides
from thinlayer.discretisation.layer import SeamLayer
from thinlayer.discretisation.mesh_functions import mesh_cut_at_faces
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.rigid_motions import model_motion_values, motion_values
from thinlayer.errors import LooseBody
from thinlayer.parts.part import DISPLACEMENT_KEY, Block, Part, TimeStep
from thinlayer.system.ranks import destroy

# Supports allow a motion if its eigenvalue of the Gram matrix of motions at supports is at most this, relative to the
# largest eigenvalue.
ALLOWED_EIGENVALUE = 1e-10
# Least stiffness against a rigid motion, relative to the stiffness of the bodies. Rounding of the forces moves a body
# by the machine epsilon over this ratio, relative to the displacements: here by a thousandth.
MIN_RESISTANCE_RATIO = 1e3 * np.finfo(float).eps
INDEPENDENCE_TOLERANCE = 1e-6  # least singular value of motions of a piece that are independent of each other


class SupportReactions:
    """Forces and moments that supports, rigid plates and rigid bases exert on a model. All methods are collective.

    A rigid base is fixed ground below a layer that has a body on its upper side only.

    Args:
        model: the model.
        parts: the parts of its balance of forces.
    """

    def __init__(self, model: Model, parts: Sequence[Part]) -> None:
        self.model, self.parts = model, parts

    def _motion_values(self, rows: IntArray) -> Array:
        """Return the values (m, k) of the k rigid motions, with rotations about `Model.centre`, at m displacements.

        Args:
            rows: (m,) local numbers of the displacements on this rank.
        """
        return motion_values(self.model, self.model.centre, rows)

    def reactions_at_end(self, r: PETSc.Vec, interval: TimeStep, loads_at: Callable[[float], PETSc.Vec]) -> Array:
        """Return the reactions (n, k) at the end of a time step: k components of force and moment at n supports.

        The rows are in the order of `Model.held_places`: supports, rigid plates and rigid bases. Moments are about
        `Model.centre`.

        The forces `r` balance at the fraction theta of the step. They give a mean of the reactions with the weight 1 -
        theta at its beginning and theta at its end.

        Args:
            r: nodal forces of the parts minus loads, at the last evaluation.
            interval: the time step.
            loads_at: function of a time that returns a new vector of the nodal forces of the loads.
        """
        theta, old = interval.theta, interval.old
        mid_reactions = self._resultants(r, self._mpc_loads(interval.t, old.t, theta))
        if theta == 1:
            return mid_reactions
        old_reactions = old.reactions
        if old_reactions is None:  # at rest there are no stresses
            old_reactions = self._resultants(-loads_at(old.t), self._mpc_loads(old.t, old.t, 1.0), layers=False)
        return np.asarray((mid_reactions - (1 - theta) * old_reactions) / theta)

    def _mpc_loads(self, end: float, start: float, theta: float) -> Array:
        """Return the nodal forces (n,) of loads on multi-point constraints in the balance of a time step.

        Such constraints are rigid plates, for example. The forces are theta times those at its end plus 1 - theta times
        those at its start, at n displacements. They do not count as reactions.

        Args:
            end: time at the end of the step.
            start: time at the start of the step.
            theta: fraction of the step after which forces balance.
        """
        loads = [share * self.model.constraints.loads_at(t) for t, share in ((end, theta), (start, 1 - theta)) if share]
        return np.asarray(sum(loads))

    def _resultants(self, r: PETSc.Vec, mpc_loads: Array, *, layers: bool = True) -> Array:
        """Return the reactions (n, k) that balance given nodal forces: k components of force and moment at n supports.

        The rows are in the order of `Model.held_places`: supports, rigid plates and rigid bases.

        Args:
            r: nodal forces minus loads.
            mpc_loads: nodal forces of loads on multi-point constraints, such as rigid plates. They are not reactions.
            layers: whether layers exert forces. If not, rows of rigid bases are zero, as these bear layers alone.
        """
        model, constraints = self.model, self.model.constraints
        support_forces = constraints.support_forces(r.array_r)
        residual = r.array_r + mpc_loads - constraints.prescribed.condition_rows.T @ support_forces
        mpc_dofs = [np.flatnonzero(np.diff(mpc.R.indptr)) for mpc in constraints.mpcs]
        rows = [constraints.support_works(support_forces, self._motion_values)]
        rows += [(residual[dofs] @ self._motion_values(dofs))[None] for dofs in mpc_dofs]
        first_base = len(model.supports.entries) + len(rows) - 1
        base_layers = [model.layers[str(name)] for name in model.held_places[first_base:]]
        rows += [-self._layer_resultant(layer, r)[None] * layers for layer in base_layers]
        return np.asarray(model.comm.allreduce(np.concatenate(rows)))

    def _layer_resultant(self, layer: SeamLayer, template: PETSc.Vec) -> Array:
        """Return the force and moment (k,) of a layer's nodal forces on this rank, in the last evaluation.

        Forces of its sublayers and of its pressure are included.

        Args:
            layer: the layer.
            template: a vector of nodal forces, whose layout the work vector takes.
        """
        forces = template.duplicate()
        forces.set(0.0)
        for part in self.parts:
            if layer.owns_key(part.key):
                part.add_forces(forces)
        loaded_dofs = np.flatnonzero(forces.array_r)
        return np.asarray(forces.array_r[loaded_dofs] @ self._motion_values(loaded_dofs))


class RigidMotions:
    """Rigid motions of the connected pieces of the bodies that supports allow. All methods are collective.

    Args:
        model: the model.
        stiffness_norm: norm of the diagonal of the stiffness matrix, to which resistance against a motion is compared.
    """

    def __init__(self, model: Model, stiffness_norm: float) -> None:
        self.model, self._stiffness_norm = model, stiffness_norm

    @cached_property
    def _piece_of_node(self) -> Indices:
        """Number of the connected piece of the bodies to which each node of this rank belongs, ghosts included."""
        model, V = self.model, self.model.V
        pieces, dofs = model.split_mesh.pieces, np.asarray(V.dofmap.list)
        piece_of = np.zeros(V.dofmap.index_map.size_local + V.dofmap.index_map.num_ghosts, np.int32)
        piece_of[dofs] = model.domain.to_local(pieces)[: len(dofs), None]
        joint, first_cells = model.domain.joint, np.unique(pieces, return_index=True)[1]
        self._names = [joint.regions[k] for k in joint.region[first_cells]]
        return piece_of

    @cached_property
    def nested_blocks(self) -> tuple[IntArray, scipy.sparse.csr_matrix]:
        """Block number (n,) >= 1 of each of n displacements, and a sparse matrix (k, k) of blocks within blocks.

        The entry (i, j) of the matrix is 1 if i = j, or if block j lies within block i; block 0 is the whole model.
        Both are attributes of `PartSum`: `block_of` and `nesting`.

        A block is a connected piece of the bodies, or the nodes of a piece on one seam, or all meshed layers. The block
        of meshed layers includes their nodes on the bodies, whose forces they bear. It counts as part of each piece,
        because a piece may have no other forces.
        """
        model, V, joint = self.model, self.model.V, self.model.domain.joint
        piece_of_cell = (model.split_mesh if joint.band is None else mesh_cut_at_faces(joint)).pieces
        n_pieces, dofs = int(piece_of_cell.max()) + 1, np.asarray(V.dofmap.list)
        block_of = np.zeros(V.dofmap.index_map.size_local + V.dofmap.index_map.num_ghosts, np.int64)
        layer_regions = [joint.regions.index(name) for name in joint.band.regions] if joint.band else []
        in_layer = np.isin(joint.region, layer_regions)
        # all layers are one block
        block_of_cell = np.where(in_layer, piece_of_cell[in_layer].min(initial=n_pieces), piece_of_cell)
        cell_blocks = model.domain.to_local(block_of_cell)[: len(dofs)]
        for cell_mask in (~in_layer, in_layer):
            local_mask = model.domain.to_local(cell_mask)[: len(dofs)]
            block_of[dofs[local_mask]] = cell_blocks[local_mask, None]
        for k, name in enumerate(model.layers if joint.band is None else (), 1):
            nodes = nodes_of_sides(V, model.domain.sides(name)[0])[0]
            block_of[nodes] = block_of[nodes] % n_pieces + k * n_pieces
        block_of = block_of.repeat(model.n_components)[: model.constraints.n]
        block_of[model.constraints.bc_dofs] %= n_pieces
        block_ids = np.unique(np.concatenate(model.comm.allgather(np.unique(block_of))))
        is_layer = np.isin(block_ids, block_of_cell[in_layer])
        is_within = (block_ids[:, None] == block_ids % n_pieces) | (is_layer & (block_ids < n_pieces)[:, None])
        np.fill_diagonal(is_within, True)
        return 1 + np.searchsorted(block_ids, block_of), scipy.sparse.csr_matrix(block_diag(1.0, is_within))

    def _motions_gram(self, rows: IntArray) -> tuple[scipy.sparse.csr_matrix, scipy.sparse.csr_matrix]:
        """Return c rigid motions as sparse columns (n, c), and a matrix (c, c) that tells which ones supports allow.

        This matrix is the Gram matrix of the constraints' violations: its product with the coefficients of an allowed
        motion is zero. The motions of connected pieces of the bodies come first, then those of rigid plates. They are
        zero at constrained displacements.

        Args:
            rows: local numbers, ascending, of the displacements at which motions are evaluated; other rows are zero. If
                constraints relate displacements, all are evaluated.
        """
        model, constraints = self.model, self.model.constraints
        n, rows = constraints.n, rows if constraints.T is None else np.arange(constraints.n)
        piece_of_row, values = self._piece_of_node[rows // model.n_components], model_motion_values(model, rows)
        self._n_per_piece = per = values.shape[1]
        row_lengths = np.zeros(n + 1, np.int64)
        row_lengths[rows + 1] = per
        csr = values.ravel(), (piece_of_row[:, None] * per + np.arange(per)).ravel(), row_lengths.cumsum()
        return constraints.project_motions(scipy.sparse.csr_matrix(csr, (n, len(self._names) * per)))

    @cached_property
    def _allowed_motions(self) -> scipy.sparse.csc_matrix:
        """The k rigid motions that supports allow, as the columns of a sparse matrix (c, k).

        The rows are their coefficients as combinations of the c rigid motions of all pieces of the bodies and all
        plates.
        """
        gram = self._motions_gram(np.unique(self.model.constraints.prescribed.condition_rows.indices))[1]
        identity, at_supports = scipy.sparse.eye(gram.shape[0], format="csc"), gram.diagonal() > 0
        eigenvalues, vectors = np.linalg.eigh(gram[at_supports][:, at_supports].toarray())
        allowed = scipy.sparse.csc_matrix(vectors[:, eigenvalues <= ALLOWED_EIGENVALUE * eigenvalues.max(initial=1.0)])
        return scipy.sparse.hstack([identity[:, ~at_supports], identity[:, at_supports] @ allowed], format="csc")

    def require_resisted(self, blocks: Sequence[Block]) -> None:
        """Raise LooseBody if a tangent does not resist one of the rigid motions that supports allow.

        Args:
            blocks: matrices that add up to the tangent. Those that their parts do not use again (`Block.kept`) are
                destroyed.
        """
        allowed, comm = self._allowed_motions, self.model.comm
        stiffness = scipy.sparse.csc_matrix((allowed.shape[0],) * 2)
        for block in blocks if allowed.shape[1] else ():
            if block.row == block.column == DISPLACEMENT_KEY:
                rows = np.flatnonzero(np.diff(block.matrix.getRowIJ()[0]))
                row_start, _ = block.matrix.getOwnershipRange()
                row_set = PETSc.IS().createGeneral((row_start + rows).astype(PETSc.IntType), comm=comm)
                motions, submatrix = self._motions_gram(rows)[0][rows], block.matrix.createSubMatrix(row_set, row_set)
                stiffness += block.factor * (motions.T @ distributed_product(submatrix, motions))
                destroy(submatrix)
        destroy(*(block.matrix for block in blocks if not block.kept))
        resistance = allowed.T @ comm.allreduce(stiffness) @ allowed
        min_resistance = MIN_RESISTANCE_RATIO * self._stiffness_norm
        if not allowed.shape[1] or _is_definite(resistance, min_resistance):
            return
        _, singular_values, directions = np.linalg.svd(resistance.toarray())
        if not (singular_values <= min_resistance).any():
            return
        motion = self._motion_text(allowed @ directions[singular_values <= min_resistance].T)
        reason = f"no unique solution: {motion}, and neither supports nor the layer resist it (to rounding)"
        advice = "add supports, or give the layer's law a stiffness in this direction"
        if self.model.contact:  # beds above and below have the same pressure, so that both slide at once
            advice = (
                "add supports, or weight (body_force): between joints that slide a weightless body has no one place"
            )
        raise LooseBody(reason, motion, advice)

    def _motion_text(self, motions: Array) -> str:
        """Say how a piece of the bodies can move: "body NAME can move along ...", or turn.

        It is the piece that moves most in the last of the given motions.

        Args:
            motions: (c, m) coefficients of m motions, as combinations of the c rigid motions of pieces and plates.
        """
        d, n_pieces = self.model.joint.dim, len(self._names)
        by_piece = motions[: n_pieces * self._n_per_piece].reshape(n_pieces, self._n_per_piece, -1)  # plates come last
        k = int(np.abs(by_piece[..., -1]).max(axis=1).argmax())
        axes, translation = [*self.model.kinematics.uniform_components(d)], np.zeros(self.model.n_components)
        translation[axes], rotation = np.split(by_piece[k, :, -1], [len(axes)])
        joint = self.model.domain.joint
        middle = joint.points[joint.corners[self.model.split_mesh.pieces == k]].mean(axis=(0, 1))
        body = f"body {self._names[k]!r}" + f" at {place_text(middle)}" * (self._names.count(self._names[k]) > 1)
        if self.model.n_components == 1:
            return f"the value of {body} can change everywhere"
        rank = np.linalg.matrix_rank(by_piece[k], tol=INDEPENDENCE_TOLERANCE)
        if self.model.kinematics.has_rigid_rotations and rank == self._n_per_piece:
            return f"{body} can move and turn freely"
        if np.abs(rotation).max(initial=0.0) > np.abs(translation).max():
            if self.model.joint.periods:
                return f"{body} can turn about the period"
            planes = [AXIS_NAMES[i] + AXIS_NAMES[j] for i in range(d) for j in range(i + 1, d)]
            return f"{body} can turn in the plane {planes[int(np.abs(rotation).argmax())]}"
        translation /= translation[np.abs(translation).argmax()]  # largest component 1, whichever sign the motion has
        direction = ", ".join(f"{c:.3g}" for c in np.round(translation, 6) + 0.0)
        return f"{body} can move along ({direction})"


def _is_definite(A: scipy.sparse.csc_matrix, min_eigenvalue: float) -> bool:
    """Whether all eigenvalues of the symmetric part of `A` exceed `min_eigenvalue`; also True if `A` contains NaN.

    All singular values of `A` then exceed `min_eigenvalue`, too.
    """
    if not np.isfinite(A.data).all():
        return True
    shifted = (A + A.T - 2 * min_eigenvalue * scipy.sparse.eye(A.shape[0])).tocsc()
    try:
        factor = splu(shifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError:  # a pivot is zero
        return False
    return bool((factor.perm_r == factor.perm_c).all() and (factor.U.diagonal() > 0).all())
