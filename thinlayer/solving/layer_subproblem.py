"""The layers meshed without the bodies: nodal forces for displacements of their faces, and the inverse."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cached_property

import numpy as np
import scipy.linalg
import scipy.sparse
from dolfinx import fem
from scipy.sparse.csgraph import connected_components

from forms.base import Array
from geometry.inflating.layering import CellsThrough
from geometry.joint import Joint
from geometry.topology import FACET_TYPES, BoolArray, IntArray, facet_nodes, vertex_weights
from thinlayer.discretisation.constraints import local_csr
from thinlayer.discretisation.full_model import LayerModel, why_not_alone
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import ThinLayer
from thinlayer.discretisation.mesh_functions import band_of
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.rigid_motions import model_motions
from thinlayer.discretisation.state import Configuration, Report, State
from thinlayer.discretisation.supports import Place
from thinlayer.errors import SolveError
from thinlayer.parts.inertia import Inertia
from thinlayer.parts.part import TimeStep
from thinlayer.parts.pressure_part import PressurePart
from thinlayer.solving.equations import Equations
from thinlayer.solving.linear_solvers import SubmatrixFactor
from thinlayer.solving.part_sum import FORCE_ROUNDING
from thinlayer.system.compat import interpolation_points
from thinlayer.system.ranks import destroy

MAX_NEWTON_STEPS = 100  # largest number of Newton steps
MESH_ADVICE = "mesh the layer (structure.full), in smaller steps of time if it slips or opens far"
NEWTON_TOLERANCE = 1e-9  # relative change by a Newton step, in the energy norm, at which Newton's method stops
MIN_LENGTH_RATIO, MAX_SHORTENINGS = 0.1, 8  # least ratio of successive lengths of a step, and number of such reductions
WORK_SUBSTEPS = 32  # number of substeps of the line between two displacements over which work is summed
MAX_WORK_DIFFERENCE = 0.01  # largest relative difference of the work of face forces and the energy of their response
RANK_TOLERANCE = 1e-9  # least singular value of independent motions, over the largest


class DirichletLayers:
    """Meshed layers without bodies, with prescribed displacements of their faces, in a time step.

    The faces of a layer are its lower and upper side, where it meets the bodies. Its lateral sides join the faces at
    the ends of S. The n unknowns of the layers are displacements, then other fields such as pressures. All arrays (n,)
    have one entry for each unknown; forces on the layers are such arrays, too.

    Attributes:
        model: the model of the meshed layers.
        K: (n, n) tangent stiffness of the layers, at the unknowns of the last `linearise`.
        load: (n,) forces for which the linearised residual at unknowns w is K w - load. They include the effect of
            prescribed strains.
        nodal_loads: (n,) nodal forces of the loads on the layers, without prescribed strains.
        side_u: (n,) prescribed displacements of the layers' lateral sides; zero elsewhere.
        on_face: (n,) mask of the displacements of the faces, including those that supports constrain.

    Args:
        model: the model of the meshed layers.
        t: time at which the layers, so far at rest, are loaded suddenly. `begin` replaces this by a time step.
    """

    def __init__(self, model: LayerModel, t: float) -> None:
        self.model, self.K = model, scipy.sparse.csr_matrix((0, 0))
        self._equations = equations = Equations(model)  # on this rank only: freed with the layers
        self._x, self._out = equations.create_vector(), equations.create_vector()
        self._n_u, n = equations.n_displacements, self._x.getLocalSize()
        self.nodal_loads, self.side_u, self._at_sides = np.zeros(n), np.zeros(n), np.zeros(n, bool)
        self._at_sides[equations.bc_dofs] = True
        self.begin(self.rest_state(t), t)
        domain, d = model.domain, model.joint.dim
        assert domain.joint.band is not None
        nodes = [fem.locate_dofs_topological(model.V, d - 1, domain.facets(name)) for name in domain.joint.band.faces]
        self.on_face = np.zeros(n, bool)
        c = model.n_components
        self.on_face[np.concatenate(nodes)[:, None] * c + np.arange(c)] = True
        self._inner = ~self.on_face & ~self._at_sides

    def transpose(self) -> None:
        """Replace K by its transpose, for adjoint solutions; another call or `linearise` restores K."""
        if not self.model.symmetric:
            self.K = scipy.sparse.csr_matrix(self.K.T)
            self._drop_factors()

    def _drop_factors(self) -> None:
        for factor in ("_dirichlet_factor", "_neumann_factor"):
            vars(self).pop(factor, None)

    def rest_state(self, t: float) -> State:
        """Return the state of the layers at rest at time `t`."""
        return self._equations.rest_state(t)

    def begin(self, old: Configuration, t: float) -> None:
        """Begin a time step of the layers from the configuration `old` to time `t`, and linearise them at `old`."""
        equations = self._equations
        equations.begin(TimeStep(old, t, t - old.t, 1.0))
        self.nodal_loads[: self._n_u], self.side_u[equations.bc_dofs] = equations.loads.array_r, equations.prescribed
        equations.put_state(old, self._x)
        self.linearise(self._x.array_r.copy())

    def add_inertia(self, mass: Inertia, a: Array) -> None:
        """Load the layers by the inertia of their mass, for accelerations `a` (n,), and linearise them at their state."""
        M, n_u = mass.mass_matrix(self.model, [*self.model.layers]), self._n_u
        forces = -local_csr(M) @ a[:n_u]
        destroy(M)
        for loads in (self.nodal_loads, self._equations.loads.array):
            loads[:n_u] += forces
        self.linearise(self._x.array_r.copy())

    def residual(self, w: Array) -> Array:
        """Return the residual (n,) at unknowns `w` (n,): internal forces minus loads; NaN if a law fails.

        The n unknowns are displacements, then other fields such as pressures.
        """
        self._x.array[:] = w
        self._equations.residual(self._x, self._out)
        return np.asarray(self._out.array_r.copy())

    def cell_pressures(self, w: Array) -> Array:
        """Return the pressures (n_cells, k) at the k vertices of the layers' cells, in the joint's order; zero if none.

        `w` (n,) are unknowns of the layers.
        """
        self.residual(w)  # sets the fields
        domain = self.model.domain
        out = np.zeros(domain.joint.corners.shape)
        for part in self._equations.field_parts:
            assert isinstance(part, PressurePart)  # a layer has no other fields
            dofs = np.asarray(part.field.function_space.dofmap.list)
            out[domain.original_cells[part.region.indices]] = part.field.x.array[dofs] * part.unit
        return out

    def linearise(self, w: Array) -> None:
        """Linearise the layers at unknowns `w` (n,): set their tangent stiffness K and their `load`.

        The residual at unknowns near `w` is then K times these unknowns minus `load`.
        """
        r = self.residual(w)
        self.K = local_csr(self._equations.tangent())
        self.load = self.K @ w - r
        self._drop_factors()

    def state(self, w: Array) -> State:
        """Return the state of the layers at unknowns `w` (n,), at the end of the time step."""
        self.residual(w)
        _, end = self._equations.end_parts(self._equations.u, self._equations.interval.t)
        return State(**vars(end), model=self.model, report=Report("layers", 0, 0.0, 0.0))

    @cached_property
    def _dirichlet_factor(self) -> SubmatrixFactor:
        return SubmatrixFactor(self.K, self._inner, symmetric=self.model.symmetric)

    def dirichlet_displacements(self, v: Array, load: Array, side_displacements: Array) -> Array:
        """Return the n unknowns of the linearised layers in equilibrium, for given displacements of their faces.

        A layer's faces are its lower and upper side, where it meets the bodies. Its lateral sides join them at the ends
        of S.

        Args:
            v: (n,) displacements of the faces; all other entries are ignored.
            load: (n,) forces on the layers.
            side_displacements: (n,) prescribed displacements of the lateral sides; all other entries are ignored.

        Returns:
            Unknowns (n,): displacements, then other fields such as pressures.
        """
        w = np.where(self.on_face, v, np.where(self._at_sides, side_displacements, 0.0))
        self._dirichlet_factor.solve(load - self.K @ w, w)
        return w

    def equilibrate_dirichlet(self, v: Array) -> Array:
        """Return the unknowns (n,) of the layers in equilibrium under their loads, for face displacements `v` (n,).

        Newton's method is used if laws are not linear. The layers are then linearised at the result. Entries of `v`
        outside the faces are ignored.

        Raises:
            SolveError: no convergence, or the layer softens.
        """
        w = self.dirichlet_displacements(v, self.load, self.side_u)
        return self._solve_newton(w, np.zeros(len(v)), lambda: self._dirichlet_factor)

    def _solve_newton(self, w: Array, forces: Array, get_factor: Callable[[], SubmatrixFactor]) -> Array:
        """Solve by Newton's method for the unknowns (n,) at which the residual equals given forces.

        Args:
            w: (n,) initial unknowns. If the laws are linear, they are returned unchanged.
            forces: (n,) forces that the residual must equal.
            get_factor: function that returns the factor of a submatrix of the present K. Unknowns outside this
                submatrix do not change.
        """
        if self.model.linear:
            return w

        def decrease_rate(fraction: float) -> float:
            """Return the rate, per unit of `fraction`, at which the energy falls along `step`, at w + fraction step."""
            return float(step @ (forces - self.residual(w + fraction * step)))

        for _ in range(MAX_NEWTON_STEPS):
            self.linearise(w)
            step = np.zeros_like(w)
            work = get_factor().solve(forces - self.residual(w), step)
            rounding = FORCE_ROUNDING * np.abs(w[: self._n_u]).max(initial=0.0)
            if work <= max(NEWTON_TOLERANCE**2 * abs(w @ (self.K @ w)), rounding**2 * np.abs(self.K.diagonal()).sum()):
                if get_factor().negative_pivots > self._inner[self._n_u :].sum():  # one for each pressure
                    raise SolveError("the layer by itself softens: stresses fall as strains grow", advice=MESH_ADVICE)
                return w
            w = w + step * line_search_fraction(decrease_rate, work)
        raise SolveError(f"the layer by itself: no equilibrium after {MAX_NEWTON_STEPS} steps", advice=MESH_ADVICE)

    def support_force_weights(self, place: Place, direction: Array) -> Array:
        """Return the vector g (n,) for which -g . r is the force of a support along a direction.

        Here r is the residual of the layers, at n unknowns. Entries of g are nonzero only at supports of the layers'
        lateral sides.

        Args:
            place: name of the support's facet set, or coordinates of its point.
            direction: (d,) vector along which the force's component is taken, in d dimensions.
        """
        out = np.zeros(len(self.load))
        out[: self._n_u] = -self.model.constraints.resultant_weights(self.model.held_indices(place), direction)
        return out

    def interpolate_to_refined(self, w: Array, fine: DirichletLayers) -> Array:
        """Interpolate displacements of these layers to the same layers with refined cells.

        Args:
            w: (n,) unknowns of these layers.
            fine: the layers with refined cells, which divide those of these layers.

        Returns:
            Unknowns (m,) of the refined layers, with zeros for fields other than displacements. If no cell has been
                divided, `w` itself.
        """
        refined, d = fine.model.refined_layers, self.model.joint.dim
        if refined is None:
            return w
        V, element = fine.model.V, self.model.V.ufl_element().basix_element
        X = refined.parent_coordinates(interpolation_points(V))
        shape_values = element.tabulate(0, X.reshape(-1, d))[0, :, :, 0].reshape(*X.shape[:2], -1)
        parent_dofs = self.model.V.dofmap.list[self.model.domain.local_cells[refined.parent]]
        c = self.model.n_components
        cell_displacements = w[: self._n_u].reshape(-1, c)[parent_dofs]
        fine_values = np.einsum("iq,nqk,nkd->nid", element.interpolation_matrix, shape_values, cell_displacements)
        out = np.zeros(len(fine.load))
        out[: fine._n_u].reshape(-1, c)[V.dofmap.list] = fine_values[fine.model.domain.original_cells]
        return out


class LayerSubproblem(DirichletLayers):
    """The meshed layers of an interface model, without the bodies: face forces against face displacements.

    With all other unknowns in equilibrium, face displacements v need the face forces E v - l. E is the Schur complement
    of the stiffness K on the faces, and l are loads condensed to the faces. Every rank has all n entries of arrays
    (n,), which belong to the layers' n unknowns.

    Attributes:
        seams: names of the layers' seams.
        cells_through: number of cells through a layer's thickness, or {name of a seam: heights between them}.
        free_faces: (n,) mask of the face displacements that supports do not constrain.
        R: (n, m) orthonormal motions of the layers that need no energy and that supports allow, for each connected
            piece.

    Args:
        interface: the interface model.
        layers: name of a seam -> its layer.
        t: time at which the layers, so far at rest, are loaded suddenly.
        through: number of cells through a layer's thickness, or {name of a seam: heights between them}.
    """

    def __init__(
        self, interface: InterfaceModel, layers: Mapping[str, ThinLayer], t: float, through: CellsThrough = 4
    ) -> None:
        super().__init__(LayerModel(interface, layers, through), t)
        self.seams, self.cells_through, self._comm = [*layers], through, interface.comm
        self._body_dofs, self._face_dofs = _matching_dofs(interface, self.model)
        counts = self._comm.allreduce(np.bincount(self._face_dofs, minlength=len(self.load)))
        # a face displacement of several bodies, which could not separate there
        if (counts > 1).any() and (violation := why_not_alone(interface.joint, self.seams)):
            raise violation.error()
        constrained = np.zeros(interface.V.dofmap.index_map.size_local * interface.V.dofmap.bs)
        constrained[interface.constraints.bc_dofs] = 1.0
        self.free_faces = self.on_face & ~self._at_sides & ~(self.to_layers(constrained) > 0)
        self.R, self._pins = self._free_motions(self.free_faces | self._inner)

    @cached_property
    def _neumann_factor(self) -> SubmatrixFactor:
        return SubmatrixFactor(self.K, (self.free_faces | self._inner) & ~self._pins, symmetric=self.model.symmetric)

    def work_shares(self, w: Array, z: Array) -> Array:
        """Return the work of the stresses in virtual displacements, minus that of the loads, divided among all nodes.

        Args:
            w: (n,) unknowns at which the stresses are computed.
            z: (n,) virtual displacements.

        Returns:
            Array (k,) with the part of the work of each of the layers' k displacement components. The sum is the work.
        """
        self.residual(w)
        virtual_u, nodal_work = fem.Function(self.model.V), fem.Function(self.model.V)
        virtual_u.x.array[:] = z[: self._n_u]
        for part in self._equations.layers:
            part.add_work_in(virtual_u, nodal_work.x.petsc_vec)
        return np.asarray(nodal_work.x.array - (z * self.nodal_loads)[: self._n_u])

    def _free_motions(self, free: BoolArray) -> tuple[Array, BoolArray]:
        """Return m orthonormal motions (n, m) that need no energy and that supports allow, and unknowns that stop them.

        These are marked in a mask (n,): if the m marked unknowns are zero, none of the motions is possible.

        Args:
            free: (n,) mask of the unknowns that supports do not constrain.
        """
        model, pins, null_spaces = self.model, np.zeros(len(free), bool), []
        motions = model_motions(model).values()
        rigid_motions = np.zeros((len(free), len(motions)))
        rigid_motions[: self._n_u] = np.column_stack([motion.x.array[: self._n_u] for motion in motions])
        n_pieces, piece_of = connected_components(self.K, directed=False)
        for k in range(n_pieces):
            piece_rows = np.flatnonzero(piece_of == k)
            modes = rigid_motions[piece_rows]
            supported_rows = np.vstack([modes[~free[piece_rows]], 0 * modes[:1]])
            modes = modes @ scipy.linalg.null_space(supported_rows, rcond=RANK_TOLERANCE)
            modes = scipy.linalg.orth(modes, rcond=RANK_TOLERANCE) if modes.any() else modes[:, :0]
            _, _, pivots = scipy.linalg.qr(modes[free[piece_rows]].T, pivoting=True)
            pins[piece_rows[free[piece_rows]][pivots[: modes.shape[1]]]] = True
            null_spaces.append(np.zeros((len(free), modes.shape[1])))
            null_spaces[-1][piece_rows] = modes
        return np.hstack(null_spaces), pins

    # ---------------------------------------------------------------- vectors of the interface model
    def to_layers(self, x: Array) -> Array:
        """Copy values at the faces from a vector of the interface model to an array (n,) of the layers.

        Entries outside the faces are zero. Collective.

        Args:
            x: (m,) values at the m displacement dofs of the interface model that this rank owns.
        """
        out = np.zeros(len(self.load))
        out[self._face_dofs] = x[self._body_dofs]
        return np.asarray(self._comm.allreduce(out))

    def to_interface(self, w: Array) -> tuple[IntArray, Array]:
        """Return the values of `w` (n,) at the faces, for the interface model.

        Returns:
            Local numbers (k,) of this rank's displacement dofs of the interface model at the faces, and the values
                (k,).
        """
        return self._body_dofs, w[self._face_dofs]

    # ---------------------------------------------------------------- E and its inverse
    def dirichlet_reactions(self, v: Array, load: Array, side_displacements: Array) -> Array:
        """Return the forces (n,) that bodies must exert on the faces of the linearised layers to hold them in place.

        All other unknowns of the layers are in equilibrium. The forces are zero where supports constrain the faces. A
        layer's faces are its lower and upper side; its lateral sides join them at the ends of S.

        Args:
            v: (n,) displacements at which the faces are held. Entries of the n unknowns that are not on faces are
                ignored.
            load: (n,) forces on the layers.
            side_displacements: (n,) prescribed displacements of the lateral sides; all other entries are ignored.
        """
        return self.free_face_values(self.K @ self.dirichlet_displacements(v, load, side_displacements) - load)

    def free_face_values(self, r: Array) -> Array:
        """Return a copy of `r` (n,) with zeros except at the face displacements that supports do not constrain."""
        return np.where(self.free_faces, r, 0.0)

    def compliance(self, r: Array) -> tuple[Array, float]:
        """Return the face displacements (n,) of the linearised layers under face forces, and the work of these forces.

        The work is returned as infinite if rounding errors are too large. They may be so in bending. A layer of length
        L and thickness eps is then about (L/eps)^4 times as soft as under tension across it.

        Args:
            r: (n,) face forces, without a resultant on any piece of the layers.

        Returns:
            The displacements, and the work r . E^+ r with the pseudo-inverse E^+ of the stiffness E of the faces.
        """
        w = np.zeros(len(r))
        work = self._neumann_factor.solve(r, w)
        work_error = abs(work - float(w @ (self.K @ w)))
        return np.where(self.on_face, w, 0.0), work if work_error <= MAX_WORK_DIFFERENCE * work else math.inf

    def neumann_displacements(self, r: Array) -> Array:
        """Return the unknowns (n,) of the linearised layers, at rest, under face forces `r` (n,) without a resultant.

        A second solve removes most of the rounding errors of the first.
        """
        w, correction = np.zeros(len(r)), np.zeros(len(r))
        self._neumann_factor.solve(r, w)
        self._neumann_factor.solve(r - self.K @ w, correction)
        return w + correction

    def equilibrate_neumann(self, w: Array, F: Array) -> Array:
        """Return the unknowns (n,) of the layers in equilibrium under face forces, by Newton's method.

        The layers are then linearised at the result. If all laws are linear, `w` itself is returned.

        Args:
            w: (n,) unknowns from which Newton's method starts.
            F: (n,) face forces, without a resultant on any piece of the layers.

        Raises:
            SolveError: no convergence, or the layer softens.
        """
        return self._solve_newton(w, F, lambda: self._neumann_factor)

    def bregman_divergence(self, w: Array, at: Array) -> tuple[float, float]:
        """Return a lower and an upper bound of the energy at `w` above its tangent plane at `at`, for convex energies.

        This energy is an integral along the straight line from `at` to `w`. Its integrand is the work of the residual
        minus that of the residual at `at`. For a convex energy it grows along the line, so that left and right Riemann
        sums are bounds.

        Args:
            w: (n,) unknowns at the end of the line.
            at: (n,) unknowns at its beginning.

        Raises:
            SolveError: the integrand falls somewhere, so that the energy is not convex.
        """
        step = w - at
        work = np.array([step @ self.residual(at + share * step) for share in np.linspace(0.0, 1.0, WORK_SUBSTEPS + 1)])
        work -= work[0]
        if (np.diff(work) < -NEWTON_TOLERANCE * np.abs(work).max()).any():
            raise SolveError("the energy of the layer is not convex")
        return float(work[:-1].mean()), float(work[1:].mean())


def line_search_fraction(decrease_rate: Callable[[float], float], initial: float) -> float:
    """Shorten a Newton step until the energy does not rise steeply at its end; return the fraction of it that remains.

    Args:
        decrease_rate: function of a fraction of the step. It returns the decrease of the energy, per unit of the
            fraction, at the end of the shortened step.
        initial: value of `decrease_rate` at the fraction 0; it must be positive.

    Returns:
        A fraction of at most 1, at which `decrease_rate` is at least -initial/2.

    Raises:
        SolveError: there is no such fraction.
    """
    fraction = 1.0 if math.isfinite(initial) else 0.0
    while fraction and not (now := decrease_rate(fraction)) >= -initial / 2:  # NaN where a law fails
        fraction *= max(initial / (initial - now), MIN_LENGTH_RATIO) if now < 0 else MIN_LENGTH_RATIO
        fraction = fraction if fraction >= MIN_LENGTH_RATIO**MAX_SHORTENINGS else 0.0
    if not fraction:
        raise SolveError("the layer by itself: Newton's steps lead nowhere; it fails, or softens", advice=MESH_ADVICE)
    return fraction


def _matching_dofs(interface: InterfaceModel, layers: LayerModel) -> tuple[IntArray, IntArray]:
    """Match displacement dofs of the bodies on S with displacement dofs at the faces of the meshed layers.

    Returns:
        Two arrays (k,): local numbers of dofs of the interface model, and numbers of the same displacements in the
            layers. Only dofs that this rank owns in the interface model occur.
    """
    joint, band, c = layers.joint, layers.domain.joint, interface.n_components
    pairs, k = [], band.table.vertices.shape[1]
    for cells, face_nodes in zip(joint.surface_cells.T, band_of(band).face_nodes, strict=True):
        faces = band.table.index(face_nodes[:, :k])
        is_here = (cells >= 0) & (interface.domain.local_cells[cells] >= 0) & (faces >= 0)
        rows, cells, faces = joint.surface_rows[is_here], cells[is_here], faces[is_here]
        body_nodes, body_x = _facet_nodes(interface, joint, rows, cells, joint.points)
        nodes, x = _facet_nodes(layers, band, faces, band.table.cells[faces, 0], band.reference)
        nearest = np.linalg.norm(body_x[:, :, None] - x[:, None], axis=3).argmin(axis=2)
        pairs.append(np.stack([body_nodes, np.take_along_axis(nodes, nearest, axis=1)], axis=2).reshape(-1, 2))
    node_pairs = np.concatenate(pairs)
    node_pairs = node_pairs[node_pairs[:, 0] < interface.V.dofmap.index_map.size_local]
    _, first_rows = np.unique(node_pairs[:, 0], return_index=True)
    body_dofs, face_dofs = (node_pairs[first_rows].T[..., None] * c + np.arange(c)).reshape(2, -1)
    return body_dofs, face_dofs


def _facet_nodes(model: Model, joint: Joint, rows: IntArray, cells: IntArray, points: Array) -> tuple[IntArray, Array]:
    """Return the nodes (n, k) on n facets, and the places (n, k, d) amid whose vertices they are.

    Args:
        model: the model.
        joint: the joint of the model.
        rows: (n,) numbers of the facets in the joint's table.
        cells: (n,) numbers of cells of the joint on this rank, one at each facet.
        points: (n_points, d) coordinates of the joint's points.
    """
    local, kind = joint.table.local_in(rows, cells), joint.cell_type
    nodes = facet_nodes(np.asarray(model.V.dofmap.list, np.int64), kind, model.domain.local_cells[cells], local)
    weights = vertex_weights(FACET_TYPES[kind], model.structure.degree)[: nodes.shape[1]]
    return nodes, weights @ points[facet_nodes(joint.corners, kind, cells, local)]
