"""Results of contact laws at the nodes of S: status, zones, jumps, tractions, resultants and checks of balance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import ufl

from forms.base import Array
from forms.contact import Status
from geometry.seam import S
from geometry.topology import IntArray, components, sum_by_number
from thinlayer.discretisation.contact_nodes import ContactNodes, body_pairs
from thinlayer.discretisation.state import State
from thinlayer.output.nodal_forces import contact_forces, nodal_forces
from thinlayer.surface.surface_mesh import SurfaceMesh
from thinlayer.system.table import Table

PINNED_STATUS, NO_CONTACT_STATUS = "pinned", "no contact law"
STATUS_NAMES = {Status.SEPARATED: "separated", Status.SLIDING: "sliding", Status.STICK: "stick"}
CONTACT_STATUSES = (*STATUS_NAMES.values(), PINNED_STATUS)
ZERO_PRESSURE_RATIO = 1e-10  # pressure, over the largest one, that counts as zero
SLIDING_TOLERANCE = 1e-9  # relative distance from the threshold at which a node of a law with memory counts as sliding


@dataclass(frozen=True)
class Zone:
    """Connected region of S whose nodes have the same contact status.

    Attributes:
        status: "separated", "sliding", "stick" or "pinned" (see `Contact.status`).
        size: sum of the areas around its nodes, in 2D of the lengths.
        start, end: (d,) smallest and largest value of each coordinate of its nodes, in d dimensions.
        nodes: number of its nodes.
    """

    status: str
    size: float
    start: tuple[float, ...]
    end: tuple[float, ...]
    nodes: int


@dataclass(frozen=True, repr=False)
class Contact:
    """Results of the contact laws in a state, at the m nodes (vertices) of a surface; the same on all ranks.

    In 2D the nodes are ordered along S. Arrays (m,) are fields for `Surface.integral`, `along` and pictures. They are
    zero at nodes without a contact law, as where S ends inside a body, and on seams with other laws.

    Attributes:
        surface: the surface. Its `places` (m, d) are the coordinates of the nodes in d dimensions. Its `nodes` (n, k)
            are the positions in the arrays (m, ...) of the k corners of n facets.
        status: (m,) "separated", "sliding" or "stick"; "pinned" if supports prescribe all components of the jump;
            "no contact law".
        u_T: (m, d - 1) tangential jump, a length, in the tangential axes of `frames`.
        u_N: (m,) penetration, a length: the initial gap is subtracted from the approach of the sides. It is negative
            where S is open.
        p: (m,) contact pressure >= 0 by the contact law. It has no meaning at pinned nodes, where the support exerts
            the force.
        t_T: (m, d - 1) tangential traction on the lower side, in the tangential axes; that on the upper side is
            opposite.
        threshold: (m,) largest |t_T| that the law allows at the pressure p. With elements of degree 2, the law
            also acts at nodes between vertices. p, t_T and `threshold` are then means over a vertex and the adjacent
            ones of these nodes, weighted by area.
        slip: (m, d - 1) slip that the law stores from step to step; zero for laws that store none.
        areas: (m,) area of S that belongs to each node, in 2D a length.
        frames: (m, d, d) unit vectors; the rows of each matrix are the tangential axes and then the normal of S.
        equilibrium: largest component of the sum of the nodal forces where no supports act, divided by the sum of the
            sizes of all nodal forces. It is zero in equilibrium, and NaN if a layer of the model has a compiled law.
        clapeyron: work of the loads and the supports, minus the work of the stresses and of the tractions on S, all by
            the same displacements. It is divided by the largest of the four; zero and NaN as `equilibrium`.
    """

    surface: SurfaceMesh
    status: npt.NDArray[np.str_]
    u_T: Array
    u_N: Array
    p: Array
    t_T: Array
    threshold: Array
    slip: Array
    areas: Array
    frames: Array
    equilibrium: float
    clapeyron: float

    @property
    def x(self) -> Array:
        """Coordinates (m, d) of the nodes."""
        return self.surface.places

    @property
    def counts(self) -> dict[str, int]:
        """Number of nodes with each of the statuses "separated", "sliding", "stick" and "pinned", by status."""
        return {name: int((self.status == name).sum()) for name in CONTACT_STATUSES}

    @property
    def normal_force(self) -> float:
        """Integral of the contact pressure over S, a force."""
        return float(self.areas @ self.p)

    @property
    def friction_force(self) -> Array:
        """Integral (d - 1,) over S of each component of `t_T`, the tangential traction on the lower side.

        On a curved S, where the tangential axes change from node to node, this is not a resultant force; `force` is.
        """
        return np.asarray(self.areas @ self.t_T)

    @property
    def force(self) -> Array:
        """Resultant force (d,) of pressure and friction on the upper body.

        At pinned nodes it contains the traction by the contact law, not the force of the support.
        """
        return -np.einsum("n,nki,nk->i", self.areas, self.frames, np.column_stack([self.t_T, -self.p]))

    @cached_property
    def zones(self) -> list[Zone]:
        """Connected regions of S whose nodes have the same status, in the order of their first nodes.

        A zone may continue from seam to seam through a common vertex. Nodes without a contact law are in no zone.
        """
        nodes, m = self.surface.nodes, len(self.status)
        a, b = nodes[:, np.triu_indices(nodes.shape[1], 1)].swapaxes(0, 1).reshape(2, -1)
        _, status_codes = np.unique(self.status, return_inverse=True)
        _, pair_labels = np.unique(np.stack([self.surface.vertices, status_codes.ravel()]), axis=1, return_inverse=True)
        is_same = self.status[a] == self.status[b]
        edge_starts, edge_ends = np.append(a[is_same], np.arange(m)), np.append(b[is_same], m + pair_labels.ravel())
        zone_labels = components(edge_starts, edge_ends, 2 * m)[:m]
        zone_nodes = [np.flatnonzero(zone_labels == label) for label in dict.fromkeys(map(int, zone_labels))]
        return [self._make_zone(members) for members in zone_nodes if self.status[members[0]] != NO_CONTACT_STATUS]

    def _make_zone(self, nodes: IntArray) -> Zone:
        start, end = self.x[nodes].min(axis=0).tolist(), self.x[nodes].max(axis=0).tolist()
        return Zone(str(self.status[nodes[0]]), float(self.areas[nodes].sum()), tuple(start), tuple(end), len(nodes))

    @property
    def table(self) -> Table:
        """Table with a row for each node; the columns are its coordinates, u_T, u_N, p, t_T and status.

        In 3D the columns "u_T_1", "u_T_2", "t_T_1" and "t_T_2" have the tangential components.
        """
        suffixes = [""] if self.x.shape[1] == 2 else ["_1", "_2"]
        columns: dict[str, Sequence[object] | Array] = dict(zip("xyz", self.x.T, strict=False))
        columns |= {f"u_T{s}": self.u_T[:, k] for k, s in enumerate(suffixes)} | {"u_N": self.u_N, "p": self.p}
        columns |= {f"t_T{s}": self.t_T[:, k] for k, s in enumerate(suffixes)}
        return Table.of(columns | {"status": self.status.tolist()})

    @property
    def _counts_text(self) -> str:
        text = ", ".join(f"{count} {name}" for name, count in self.counts.items() if count)
        return text if self.surface.seam == S else f"{self.surface.seam}: {text}"

    def __repr__(self) -> str:
        return f"Contact({self._counts_text})"

    def __str__(self) -> str:
        zone_lines = [f"  {z.status:<10}{z.size:.6g} ({z.nodes} node{'s' * (z.nodes > 1)})" for z in self.zones]
        forces_text = f"normal force {self.normal_force:.6g}, equilibrium {self.equilibrium:.1e}"
        return "\n".join([self._counts_text, *zone_lines, forces_text])


def contact_values(surface: SurfaceMesh, state: State) -> dict[str, np.ndarray]:
    """Evaluate the contact laws of a state at the m nodes of a surface. Collective.

    Args:
        surface: the surface.
        state: the state.

    Returns:
        Name of an attribute of `Contact` -> its array (m, ...), without `equilibrium` and `clapeyron`. {} if no contact
        law acts on the surface.
    """
    seams = [name for name in state.model.contacts if surface.seam in (S, name)]
    results = [result for name in seams for result in state.model.comm.allgather(_rank_values(state, name))]
    if not results:
        return {}
    array_of_name = {name: np.concatenate([result[name] for result in results]) for name in results[0]}
    nodes, m = surface.positions_of(array_of_name.pop("number")), len(surface.node_numbers)
    is_vertex, areas = array_of_name.pop("vertex"), array_of_name.pop("areas")
    area_sums = sum_by_number(nodes, areas, m)
    values: dict[str, np.ndarray] = {"areas": area_sums}
    for name, array in array_of_name.items():
        if name in ("p", "t_T", "threshold"):  # vertices share the forces of nodes between them
            values[name] = (sum_by_number(nodes, (array.T * areas).T, m).T / np.where(area_sums > 0, area_sums, 1.0)).T
            continue
        values[name] = np.zeros((m, *array.shape[1:])) if name != "status" else np.full(m, NO_CONTACT_STATUS)
        values[name][nodes] = array  # a vertex without area, on the axis of revolution, has the value of a neighbour
        values[name][nodes[is_vertex]] = array[is_vertex]
    return values


def _rank_values(state: State, seam: str) -> dict[str, np.ndarray]:
    """Evaluate the contact law of one seam at this rank's nodes, and list the results by vertices of S.

    With elements of degree 2 the law also has nodes between vertices. The results of such a node are listed once for
    each adjacent vertex.

    Args:
        state: the state.
        seam: name of the seam.

    Returns:
        Name -> array (rows, ...): the names of attributes of `Contact`; "vertex", whether the node of this row is
        itself at the vertex; "number", the key of the vertex and of the two bodies that meet there (`Joint.pairs`).
    """
    model, law = state.model, state.model.contacts[seam]
    nodes = ContactNodes(model.contact_surface(seam), model.constraints.bc_dofs, gap=law.gaps)
    w, slip = nodes.separation(state.u.x.petsc_vec), state.memory[model.layers[seam].key]
    t, p, statuses = law.traction(w, slip), law.pressure(w), law.status(w, slip)
    threshold = law.threshold(p)
    if law.memory:
        is_at_threshold = np.linalg.norm(t[:, :-1], axis=1) >= (1 - SLIDING_TOLERANCE) * threshold
        statuses = np.where((statuses == Status.STICK) & is_at_threshold, Status.SLIDING, statuses)
    largest_pressure = model.comm.allreduce(float(p.max(initial=0.0)), max)
    statuses = np.where(p <= ZERO_PRESSURE_RATIO * largest_pressure, Status.SEPARATED, statuses)
    status_names = np.array([STATUS_NAMES[Status(int(code))] for code in statuses], dtype="<U9")
    status_names[nodes.is_fixed.all(axis=1)] = PINNED_STATUS
    row_nodes, pair_keys = body_pairs(model.joint, seam, nodes.node_ids)
    n_vertices = np.bincount(row_nodes, minlength=len(w))
    values: dict[str, np.ndarray] = {
        "vertex": n_vertices == 1, "status": status_names, "u_T": w[:, :-1], "u_N": -w[:, -1], "p": p, "t_T": t[:, :-1],
        "threshold": threshold, "slip": slip, "areas": nodes.weights / n_vertices, "frames": nodes.frames,
    }  # fmt: skip
    nodes.destroy()
    return {"number": pair_keys} | {name: array[row_nodes] for name, array in values.items()}


def balance_errors(state: State) -> tuple[float, float]:
    """Return the relative errors of the balances of forces and work: `Contact.equilibrium`, `clapeyron`. Collective."""
    model, comm, d = state.model, state.model.comm, state.model.joint.dim
    if any(p.law.traits.compiled for p in model.layer_terms):
        return math.nan, math.nan
    bc_dofs = np.union1d(model.supports.bc_dofs_in(model.V), model.bc_dofs_in(model.V))
    bc_dofs = bc_dofs[bc_dofs < model.V.dofmap.index_map.size_local * model.V.dofmap.index_map_bs]
    v = ufl.TestFunction(model.V)
    internal = nodal_forces(model.V, state.work(state.bodies + state.layers, v) + state.work_of_parts(v))
    external, contact = nodal_forces(model.V, model.external_work(v, state.t)), contact_forces(state)
    u, inner_vec, outer_vec, contact_vec = (f.x.petsc_vec for f in (state.u, internal, external, contact))
    contact_vec.scale(-1.0)
    stress_work, contact_work, load_work = float(u.dot(inner_vec)), float(u.dot(contact_vec)), float(u.dot(outer_vec))
    residual = inner_vec.array_r + contact_vec.array_r - outer_vec.array_r
    support_work = comm.allreduce(float(residual[bc_dofs] @ u.array_r[bc_dofs]))
    residual[bc_dofs] = 0.0
    resultant = comm.allreduce(residual.reshape(-1, d).sum(axis=0))
    force_sum = comm.allreduce(sum(float(np.abs(f.array_r).sum()) for f in (inner_vec, outer_vec, contact_vec)))
    largest_work = max(map(abs, (stress_work, contact_work, load_work, support_work)))
    force_error, work_error = float(np.abs(resultant).max()), abs(stress_work + contact_work - load_work - support_work)
    return force_error / force_sum if force_sum else 0.0, work_error / largest_work if largest_work else 0.0
