"""ContactReport: status of every node of S, zones, resultants and checks of the balance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import ufl

from forms.contact import Status
from geometry.joint import Joint
from geometry.order import edges_of, order_on_s
from geometry.topology import connected
from thinlayer.discretisation.contact_nodes import Array, ContactNodes, ContactSurface, pair_numbers, pairs_of
from thinlayer.discretisation.state import State
from thinlayer.errors import ModelError
from thinlayer.files.table import Table
from thinlayer.output.nodal_forces import contact_forces, nodal_forces

PINNED = "pinned"
NAMES = {Status.SEPARATED: "separated", Status.SLIDING: "sliding", Status.STICK: "stick"}
ROUNDING = 1e-10  # pressure, over the largest one, that counts as zero
AT_LIMIT = 1e-9  # relative distance from the threshold at which a node of a law with memory counts as sliding


@dataclass(frozen=True)
class Zone:
    """Neighbouring nodes of S with one status.

    Attributes:
        status: "separated", "sliding", "stick" or "pinned".
        size: area of S around them (2D: length).
        start, end: lowest and highest coordinates of the nodes.
        nodes: their number.
    """

    status: str
    size: float
    start: tuple[float, ...]
    end: tuple[float, ...]
    nodes: int


class ContactReport:
    """Contact on S in a state, the same on all ranks; nodes in order along S in 2D, else by their coordinates.

    Args:
        state: state of a model with a contact law. The constructor is collective.
        seam: name of a seam with a contact law; None: the only one.

    Raises:
        ModelError: no contact law in the state's model; another seam, or none where there are several.

    Attributes:
        joint: the joint.
        seam: name of the seam.
        numbers: (n,) vertices of the joint; where bodies branch there is a node for each pair of bodies at a vertex,
            in periodic cells one of those that are identified.
        pairs: (n,) number of the pair of bodies of each node (`pair_numbers`).
        x: (n, d) places.
        status: (n,) "separated", "sliding", "stick", or "pinned" where supports prescribe the whole jump.
        u_T: (n, d - 1) tangential jump in the frame of S (`Surface.frame`).
        u_N: (n,) penetration, the upper side into the lower one, less the initial gap; negative where S is open.
        p: (n,) pressure >= 0 of the law; without meaning at pinned nodes, where the support exerts the force.
        t_T: (n, d - 1) tangential traction on the lower side; that on the upper side is opposite.
        threshold: (n,) largest |t_T| at this pressure.
        slip: (n, d - 1) slip that the law remembers; zero for laws without memory.
        weights: (n,) area of S around each node.
        frames: (n, d, d), rows are the tangential axes and the normal of S.
        facets: (m, k) positions among the nodes of the corners of each facet of the seam, in the order of the facet's own
            element; without facets at tips, where a corner is no node.
        corners: (m, k) the same of all its facets (`Joint.rows_of`); -1 at tips.
        force: (d,) resultant of S on the upper body, without the forces of supports at pinned nodes.
        equilibrium: sum of the forces on the free nodes, over the sum of the absolute values of all nodal forces.
        clapeyron: work of the loads and supports in the displacements less that of the stresses and of the tractions on S,
            over the largest of the four: zero in equilibrium.
    """

    def __init__(self, state: State, seam: str | None = None) -> None:
        if not isinstance(state, State) or state.model.contact is None:
            given = f"one of {state.model!r}" if isinstance(state, State) else repr(state)[:200]
            raise ModelError(f"a contact report needs a state of a model with a contact law, not {given}")
        model = state.model
        if seam is None and len(model.contacts) == 1:
            (seam,) = model.contacts
        if not isinstance(seam, str) or seam not in model.contacts:
            raise ModelError(f"seam is {seam!r}; name one with a contact law: {', '.join(model.contacts)}")
        law = model.contacts[seam]
        held = np.union1d(model.supports.held(model.V), model.held_in(model.V))
        owned = model.V.dofmap.index_map.size_local * model.V.dofmap.index_map_bs
        nodes = ContactNodes(ContactSurface.of(model, seam), model.constraints.held, gap=law.gaps)
        slip, d = state.memory[model.layers[seam].key], nodes.dim
        w = nodes.apart(state.u.x.petsc_vec)
        t, p = law.traction(w, slip), law.pressure(w)
        threshold = law.threshold(p)
        kind = law.status(w, slip)
        if law.memory:
            at_limit = np.linalg.norm(t[:, :-1], axis=1) >= (1 - AT_LIMIT) * threshold
            kind = np.where((kind == Status.STICK) & at_limit, Status.SLIDING, kind)
        largest = model.comm.allreduce(float(p.max(initial=0.0)), max)
        kind = np.where(p <= ROUNDING * largest, Status.SEPARATED, kind)
        pinned = nodes.held.all(axis=1)
        axes = nodes.frames.reshape(len(w), d * d)
        facets, pairs = _corners(model.joint, seam), pairs_of(model.joint, seam, nodes.file_numbers)
        vertices = model.joint.masters[nodes.numbers]
        columns = [
            pairs,
            vertices,
            model.joint.points[vertices],
            kind,
            pinned,
            w,
            p,
            t[:, :-1],
            threshold,
            nodes.weights,
            slip,
            axes,
        ]
        rows: Array = np.concatenate(model.comm.allgather(np.column_stack(columns)))
        of_pairs = rows[:, 0].astype(np.int64)
        order = order_on_s(model.joint, of_pairs, rows[:, 2 : 2 + d], seam, facets)
        x, kinds, held_rows, jumps, pressure, friction, bound, weights, slips, frames = np.split(
            rows[order, 2:], np.cumsum([d, 1, 1, d, 1, d - 1, 1, 1, d - 1]), axis=1
        )
        names = np.array([NAMES[Status(int(k))] for k in kinds.ravel()], dtype="<U9")
        names[held_rows.ravel() > 0] = PINNED
        self.joint, self.seam, self.x, self.status = model.joint, seam, x, names
        self.numbers = rows[order, 1].astype(np.int64)
        self._edges = edges_of(facets, of_pairs[order])
        place = np.argsort(of_pairs[order])
        at = place[np.minimum(np.searchsorted(of_pairs[order][place], facets), len(place) - 1)]
        there = of_pairs[order][at] == facets
        self.facets, self.corners = at[there.all(axis=1)], np.where(there, at, -1)
        self.u_T, self.u_N, self.p, self.t_T = jumps[:, :-1], -jumps[:, -1], pressure.ravel(), friction
        self.threshold, self.weights, self.frames = bound.ravel(), weights.ravel(), frames.reshape(-1, d, d)
        self.pairs, self.slip = of_pairs[order], slips
        force = -model.comm.allreduce(np.einsum("n,nki,nk->i", nodes.weights, nodes.frames, t))
        self.force: Array = np.asarray(force)
        self.equilibrium, self.clapeyron = _balance(state, held[held < owned])
        nodes.destroy()

    @property
    def counts(self) -> dict[str, int]:
        """Number of separated, sliding, sticking and pinned nodes."""
        return {name: int((self.status == name).sum()) for name in (*NAMES.values(), PINNED)}

    @property
    def normal_force(self) -> float:
        """Integral of the pressure over S."""
        return float(self.weights @ self.p)

    @property
    def friction_force(self) -> Array:
        """Integral of the tangential traction on the lower side, (d - 1,): a force where S is planar."""
        return np.asarray(self.weights @ self.t_T)

    @cached_property
    def zones(self) -> list[Zone]:
        """Connected parts of S with one status, in the order of their first nodes; nodes at one place are connected."""
        a, b = self._edges
        same, n = self.status[a] == self.status[b], len(self.x)
        _, kind = np.unique(self.status, return_inverse=True)
        _, shared = np.unique(self.numbers * n + kind.ravel(), return_inverse=True)
        links = np.concatenate([b[same], n + shared.ravel()])
        found: npt.NDArray[np.int64] = connected(np.concatenate([a[same], np.arange(n)]), links, 2 * n)[:n]
        zones = []
        for label in dict.fromkeys(map(int, found)):
            at = np.flatnonzero(found == label)
            start, end = self.x[at].min(axis=0), self.x[at].max(axis=0)
            size = float(self.weights[at].sum())
            zones.append(Zone(str(self.status[at[0]]), size, tuple(start.tolist()), tuple(end.tolist()), len(at)))
        return zones

    @property
    def along(self) -> Array:
        """(n,) distance along S from the first node, in 2D; between two pieces of S it is the straight distance."""
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.x, axis=0), axis=1))])

    @cached_property
    def pieces(self) -> list[npt.NDArray[np.int64]]:
        """In 2D, the nodes of each piece of S, in order along it."""
        a, b = self._edges
        near = np.abs(a - b) == 1
        joined = np.isin(np.arange(len(self.x) - 1), np.minimum(a, b)[near])
        return np.split(np.arange(len(self.x)), np.flatnonzero(~joined) + 1)

    @property
    def table(self) -> Table:
        """A row for each node: place, u_T, u_N, p, t_T and status."""
        d = self.x.shape[1]
        suffixes: Sequence[str] = [""] if d == 2 else ["_1", "_2"]
        columns = {"xyz"[k]: self.x[:, k] for k in range(d)}
        columns |= {f"u_T{s}": self.u_T[:, k] for k, s in enumerate(suffixes)}
        columns |= {"u_N": self.u_N, "p": self.p}
        columns |= {f"t_T{s}": self.t_T[:, k] for k, s in enumerate(suffixes)}
        return Table(
            {name: float(values[row]) for name, values in columns.items()} | {"status": str(self.status[row])}
            for row in range(len(self.x))
        )

    def __repr__(self) -> str:
        return f"ContactReport({self._start}{', '.join(f'{count} {name}' for name, count in self.counts.items() if count)})"

    @property
    def label(self) -> str:
        """The seam's name if the joint has several seams, else ""."""
        return self.seam if len(self.joint.seams) > 1 else ""

    @property
    def _start(self) -> str:
        return f"{self.label}: " if self.label else ""

    def __str__(self) -> str:
        lines = [self._start + ", ".join(f"{count} {name}" for name, count in self.counts.items() if count)]
        lines += [f"  {z.status:<10}{z.size:.6g} ({z.nodes} node{'s' * (z.nodes > 1)})" for z in self.zones]
        lines.append(f"normal force {self.normal_force:.6g}, equilibrium {self.equilibrium:.1e}")
        return "\n".join(lines)


def _corners(joint: Joint, seam: str) -> npt.NDArray[np.int64]:
    """(m, k) numbers of the pairs of bodies at the corners of a seam's facets, in the order of the facets' own element."""
    here = joint.seam_numbers == list(joint.seams).index(seam)
    facets = pair_numbers(joint)[here]
    own = joint.surface[here, : facets.shape[1]].argsort(axis=1).argsort(axis=1)
    return np.take_along_axis(facets, own, axis=1)


def _balance(state: State, held: npt.NDArray[np.int32]) -> tuple[float, float]:
    """Sum of the forces on free nodes and the work balance, relative; NaN beside compiled laws on S. Collective."""
    model, comm, d = state.model, state.model.comm, state.model.joint.dim
    if any(p.law.traits.compiled for p in model.layer_terms):
        return math.nan, math.nan
    v = ufl.TestFunction(model.V)
    stresses, loads = (
        nodal_forces(model.V, state.work(state.bodies + state.layers, v) + model.added_work_in(state, v)),
        nodal_forces(model.V, model.external_work(v, state.t)),
    )
    inner, outer = stresses.x.petsc_vec, loads.x.petsc_vec
    of_contact = contact_forces(state)  # owns the vector
    on_s = of_contact.x.petsc_vec
    on_s.scale(-1.0)
    u = state.u.x.petsc_vec
    spent, tractions, supplied = float(u.dot(inner)), float(u.dot(on_s)), float(u.dot(outer))
    total = inner.array_r + on_s.array_r - outer.array_r
    at_supports = comm.allreduce(float(total[held] @ u.array_r[held]))
    total[held] = 0.0
    sums = comm.allreduce(total.reshape(-1, d).sum(axis=0))
    sizes = comm.allreduce(sum(float(np.abs(f.array_r).sum()) for f in (inner, outer, on_s)))
    largest = max(map(abs, (spent, tractions, supplied, at_supports)))
    return (
        float(np.abs(sums).max() / sizes) if sizes else 0.0,
        abs(spent + tractions - supplied - at_supports) / largest if largest else 0.0,
    )
