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
from geometry.topology import IntArray, connected, sum_by_number
from thinlayer.discretisation.contact_nodes import ContactNodes, ContactSurface, body_pairs
from thinlayer.discretisation.state import State
from thinlayer.output.nodal_forces import contact_forces, nodal_forces
from thinlayer.surface.surface_mesh import SurfaceMesh
from thinlayer.system.table import Table

PINNED_STATUS, NO_CONTACT_STATUS = "pinned", "no contact law"
STATUS_NAMES = {Status.SEPARATED: "separated", Status.SLIDING: "sliding", Status.STICK: "stick"}
CONTACT_STATUSES = (*STATUS_NAMES.values(), PINNED_STATUS)
ZERO_PRESSURE_SHARE = 1e-10  # pressure, over the largest one, that counts as zero
SLIDING_TOLERANCE = 1e-9  # relative distance from the threshold at which a node of a law with memory counts as sliding


@dataclass(frozen=True)
class Zone:
    """Connected region of S whose nodes have the same contact status.

    Attributes:
        status: "separated", "sliding", "stick" or "pinned" (`Contact.status`).
        size: sum of the areas around its nodes (2D: length).
        start, end: (d,) smallest and largest value of each coordinate of its nodes.
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
    zero at nodes without a contact law, as at tips of S and on seams with other laws.

    Attributes:
        surface: the surface. Its `places` (m, d) are the coordinates of the nodes. Its `nodes` (n, k) are the positions
            in these arrays of the k corners of n facets.
        status: (m,) "separated", "sliding", "stick"; "pinned" if supports prescribe the whole jump; "no contact law".
        u_T: (m, d - 1) tangential jump, components in `frames`; d is the number of dimensions.
        u_N: (m,) penetration of the upper side into the lower side, after closing the initial gap; negative where S is
            open.
        p: (m,) pressure >= 0 of the law; without meaning at pinned nodes, where the support exerts the force.
        t_T: (m, d - 1) tangential traction on the lower side; the traction on the upper side is opposite.
        threshold: (m,) largest |t_T| that the law allows at this pressure. With elements of degree 2, the forces of
            nodes between vertices are divided equally among these vertices. p, t_T and threshold are then means.
        slip: (m, d - 1) slip that the law stores from step to step; zero for laws that store none.
        areas: (m,) area of S around each node, as in the contact law.
        frames: (m, d, d) unit vectors; the rows of each matrix are the tangential axes and then the normal of S.
        equilibrium: largest component of the sum of the nodal forces where no supports act, over the sum of the sizes
            of all nodal forces; zero in equilibrium.
        clapeyron: work of the loads and supports, less the work of the stresses and of the tractions on S, in the
            displacements. It is relative to the largest of the four, and zero in equilibrium.
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
        """(m, d) coordinates of the nodes."""
        return self.surface.places

    @property
    def counts(self) -> dict[str, int]:
        """Number of separated, sliding, sticking and pinned nodes."""
        return {name: int((self.status == name).sum()) for name in CONTACT_STATUSES}

    @property
    def normal_force(self) -> float:
        """Integral of the pressure over S."""
        return float(self.areas @ self.p)

    @property
    def friction_force(self) -> Array:
        """Integral (d - 1,) of the components of the tangential traction on the lower side; a force if S is planar."""
        return np.asarray(self.areas @ self.t_T)

    @property
    def force(self) -> Array:
        """Resultant (d,) of the contact tractions on the upper body, pressure and friction.

        At pinned nodes, where supports prescribe the jump, it has the law's traction, not the force of the support.
        """
        return -np.einsum("n,nki,nk->i", self.areas, self.frames, np.column_stack([self.t_T, -self.p]))

    @cached_property
    def zones(self) -> list[Zone]:
        """Connected regions of S whose nodes have the same status, ordered by the numbers of their first nodes.

        Nodes of several seams at the same vertex are connected. Nodes without a contact law are left out.
        """
        nodes, m = self.surface.nodes, len(self.status)
        a, b = nodes[:, np.triu_indices(nodes.shape[1], 1)].swapaxes(0, 1).reshape(2, -1)
        _, kind = np.unique(self.status, return_inverse=True)
        _, shared = np.unique(np.stack([self.surface.vertices, kind.ravel()]), axis=1, return_inverse=True)
        same = self.status[a] == self.status[b]
        first, second = np.append(a[same], np.arange(m)), np.append(b[same], m + shared.ravel())
        zone = connected(first, second, 2 * m)[:m]
        zones = [np.flatnonzero(zone == label) for label in dict.fromkeys(map(int, zone))]
        return [self._zone(at) for at in zones if self.status[at[0]] != NO_CONTACT_STATUS]

    def _zone(self, at: IntArray) -> Zone:
        start, end = self.x[at].min(axis=0).tolist(), self.x[at].max(axis=0).tolist()
        return Zone(str(self.status[at[0]]), float(self.areas[at].sum()), tuple(start), tuple(end), len(at))

    @property
    def table(self) -> Table:
        """Table with a row for each node: coordinates, u_T, u_N, p, t_T and status."""
        suffixes = [""] if self.x.shape[1] == 2 else ["_1", "_2"]
        columns: dict[str, Sequence[object] | Array] = dict(zip("xyz", self.x.T, strict=False))
        columns |= {f"u_T{s}": self.u_T[:, k] for k, s in enumerate(suffixes)} | {"u_N": self.u_N, "p": self.p}
        columns |= {f"t_T{s}": self.t_T[:, k] for k, s in enumerate(suffixes)}
        return Table.of(columns | {"status": self.status.tolist()})

    @property
    def _counted(self) -> str:
        counts = ", ".join(f"{count} {name}" for name, count in self.counts.items() if count)
        return counts if self.surface.seam == S else f"{self.surface.seam}: {counts}"

    def __repr__(self) -> str:
        return f"Contact({self._counted})"

    def __str__(self) -> str:
        lines = [f"  {z.status:<10}{z.size:.6g} ({z.nodes} node{'s' * (z.nodes > 1)})" for z in self.zones]
        forces = f"normal force {self.normal_force:.6g}, equilibrium {self.equilibrium:.1e}"
        return "\n".join([self._counted, *lines, forces])


def contact_values(surface: SurfaceMesh, state: State) -> dict[str, np.ndarray]:
    """Arrays of contact results at the nodes of a surface, by the names of attributes of `Contact`. Collective.

    It is {} if no contact law acts on the surface. The attributes `equilibrium` and `clapeyron` are not included.
    """
    seams = [name for name in state.model.contacts if surface.seam in (S, name)]
    parts = [part for name in seams for part in state.model.comm.allgather(_rank_values(state, name))]
    if not parts:
        return {}
    nodal = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    at, m = surface.find(nodal.pop("number")), len(surface.numbers)
    vertex, areas = nodal.pop("vertex"), nodal.pop("areas")
    around = sum_by_number(at, areas, m)
    values: dict[str, np.ndarray] = {"areas": around}
    for name, array in nodal.items():
        if name in ("p", "t_T", "threshold"):  # vertices share the forces of nodes between them
            values[name] = (sum_by_number(at, (array.T * areas).T, m).T / np.where(around > 0, around, 1.0)).T
            continue
        values[name] = np.zeros((m, *array.shape[1:])) if name != "status" else np.full(m, NO_CONTACT_STATUS)
        values[name][at] = array  # a vertex without area, on the axis of revolution, has the value of a neighbour
        values[name][at[vertex]] = array[vertex]
    return values


def _rank_values(state: State, seam: str) -> dict[str, np.ndarray]:
    """Arrays of results of one contact law at this rank's nodes, by the names of attributes of `Contact`.

    A node at a vertex has one row; a node between vertices has a row for each of them. The entry "vertex" says whether
    the node is at a vertex. The entry "number" is the number of the pair of bodies that meet at the vertex
    (`Joint.pairs`).
    """
    model, law = state.model, state.model.contacts[seam]
    nodes = ContactNodes(ContactSurface.of(model, seam), model.constraints.bc_dofs, gap=law.gaps)
    w, slip = nodes.separation(state.u.x.petsc_vec), state.memory[model.layers[seam].key]
    t, p, kind = law.traction(w, slip), law.pressure(w), law.status(w, slip)
    threshold = law.threshold(p)
    if law.memory:
        at_limit = np.linalg.norm(t[:, :-1], axis=1) >= (1 - SLIDING_TOLERANCE) * threshold
        kind = np.where((kind == Status.STICK) & at_limit, Status.SLIDING, kind)
    largest = model.comm.allreduce(float(p.max(initial=0.0)), max)
    kind = np.where(p <= ZERO_PRESSURE_SHARE * largest, Status.SEPARATED, kind)
    status = np.array([STATUS_NAMES[Status(int(code))] for code in kind], dtype="<U9")
    status[nodes.is_fixed.all(axis=1)] = PINNED_STATUS
    node, number = body_pairs(model.joint, seam, nodes.file_numbers)
    vertex_count = np.bincount(node, minlength=len(w))
    values: dict[str, np.ndarray] = {
        "vertex": vertex_count == 1, "status": status, "u_T": w[:, :-1], "u_N": -w[:, -1], "p": p, "t_T": t[:, :-1],
        "threshold": threshold, "slip": slip, "areas": nodes.weights / vertex_count, "frames": nodes.frames,
    }  # fmt: skip
    nodes.destroy()
    return {"number": number} | {name: array[node] for name, array in values.items()}


def balance_errors(state: State) -> tuple[float, float]:
    """Check the balance of forces and of work of a state. Collective.

    Returns:
        Two numbers, zero in equilibrium and NaN for models with compiled laws of layers. The first is the largest
        component of the sum of all forces on dofs without supports, over the sum of the sizes of nodal forces. The
        second is the work of loads and supports less that of stresses and contact tractions, over the largest of them.
    """
    model, comm, d = state.model, state.model.comm, state.model.joint.dim
    if any(p.law.traits.compiled for p in model.layer_terms):
        return math.nan, math.nan
    bc_dofs = np.union1d(model.supports.bc_dofs_in(model.V), model.bc_dofs_in(model.V))
    bc_dofs = bc_dofs[bc_dofs < model.V.dofmap.index_map.size_local * model.V.dofmap.index_map_bs]
    v = ufl.TestFunction(model.V)
    stresses = nodal_forces(model.V, state.work(state.bodies + state.layers, v) + model.added_work_in(state, v))
    loads, of_contact = nodal_forces(model.V, model.external_work(v, state.t)), contact_forces(state)
    u, inner, outer, on_s = (f.x.petsc_vec for f in (state.u, stresses, loads, of_contact))
    on_s.scale(-1.0)
    spent, tractions, supplied = float(u.dot(inner)), float(u.dot(on_s)), float(u.dot(outer))
    total = inner.array_r + on_s.array_r - outer.array_r
    at_supports = comm.allreduce(float(total[bc_dofs] @ u.array_r[bc_dofs]))
    total[bc_dofs] = 0.0
    sums = comm.allreduce(total.reshape(-1, d).sum(axis=0))
    sizes = comm.allreduce(sum(float(np.abs(f.array_r).sum()) for f in (inner, outer, on_s)))
    largest = max(map(abs, (spent, tractions, supplied, at_supports)))
    unbalanced, missing = float(np.abs(sums).max()), abs(spent + tractions - supplied - at_supports)
    return unbalanced / sizes if sizes else 0.0, missing / largest if largest else 0.0
