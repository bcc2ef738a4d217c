"""LayerReport: what each facet of S does in a state of an interface model: stays elastic, opens, slides or yields."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from forms.kinematics import MANDEL
from geometry.errors import unknown
from geometry.seam import S
from geometry.topology import IntArray
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.quadratures import compiled_terms
from thinlayer.discretisation.seams import SeamLayer
from thinlayer.discretisation.state import State
from thinlayer.errors import ModelError
from thinlayer.files.table import Table
from thinlayer.output.law_points import tensors
from thinlayer.parts.compiled import GivenAtPoints
from thinlayer.pointwise.compiled_term import CompiledTerm
from thinlayer.pointwise.kernels import memory_slots

Array = npt.NDArray[np.float64]
NO_LAYER, ELASTIC, OPEN, SLIDING, CRUSHED, TORN = "no layer", "elastic", "open", "sliding", "crushed", "torn"
STATUSES = (ELASTIC, SLIDING, CRUSHED, TORN, OPEN, NO_LAYER)
ROUNDING = 1e-6  # traction or plastic strain, over the largest traction or strain of a layer, that counts as none


@dataclass(frozen=True)
class LayerReport:
    """Status of the facets of S in a state of an interface model, the same on all ranks. Collective.

    - "elastic": nothing has yielded, or the law has no plastic strain;
    - "sliding": the largest part of the plastic strain across S is a slip along it;
    - "crushed", "torn": it is a closing, or an opening, along n;
    - "open": it is open, and no traction across S is left;
    - "no layer": an open joint, on which no law acts.

    A facet has the status of the largest part of it. Plastic strains are those since the beginning, not of the last step.

    Args:
        state: state of an interface model without contact laws on these seams.
        seam: name of a seam; "S": all of them.

    Raises:
        ModelError: a state of another model; an unknown seam, or one with a contact law (`ContactReport`).
    """

    state: State
    seam: str = S

    def __post_init__(self) -> None:
        if not isinstance(self.state, State) or not isinstance(self.state.model, InterfaceModel):
            given = self.state.model if isinstance(self.state, State) else self.state
            raise ModelError(f"a layer report needs a state of an interface model, not {given!r:.80}")
        model = self.state.model
        if self.seam not in (S, *model.joint.seams):
            raise ModelError(unknown("seam", self.seam, model.joint.seams))
        if found := [name for name in self._seams if name in model.contacts]:
            raise ModelError(f"the seam {found[0]!r} has a contact law; a ContactReport tells what happens there")
        _ = self.status

    @property
    def _seams(self) -> list[str]:
        joint = self.state.model.joint
        return list(joint.seams) if self.seam == S else [self.seam]

    @cached_property
    def rows(self) -> IntArray:
        """(n,) rows of the facets in the joint's table of facets, seam after seam."""
        joint = self.state.model.joint
        return np.concatenate([joint.rows_of(name) for name in self._seams])

    @cached_property
    def seams(self) -> npt.NDArray[np.str_]:
        """(n,) names of the facets' seams."""
        joint = self.state.model.joint
        return np.repeat(self._seams, [len(joint.rows_of(name)) for name in self._seams])

    @cached_property
    def status(self) -> npt.NDArray[np.str_]:
        """(n,) status of the facets."""
        return np.concatenate([self._of_seam(name) for name in self._seams])

    @cached_property
    def sizes(self) -> Array:
        """(n,) areas of the facets, of straight cells between their vertices (2D: lengths, or areas of revolution)."""
        joint, kinematics = self.state.model.joint, self.state.model.kinematics
        x = joint.points[joint.table.vertices[self.rows]]
        sides = x[:, 1:3] - x[:, :1]
        area = np.sqrt(np.linalg.det(sides @ sides.swapaxes(1, 2)))
        area = area / 2 if joint.cell_type == "tetrahedron" else area
        k = x.shape[1]
        return np.asarray(kinematics.node_areas(x, np.repeat(area[:, None] / k, k, axis=1)).sum(axis=1))

    @property
    def shares(self) -> dict[str, float]:
        """Share of the area of S with each status."""
        parts = {name: float(self.sizes[self.status == name].sum() / self.sizes.sum()) for name in STATUSES}
        return {name: share for name, share in parts.items() if share}

    @property
    def table(self) -> Table:
        """A row for each seam: its area and the share of each status in it."""
        rows = []
        for seam in self._seams:
            sizes, status = self.sizes[self.seams == seam], self.status[self.seams == seam]
            shares = {name: float(sizes[status == name].sum() / sizes.sum()) for name in STATUSES}
            rows.append({"seam": seam, "size": float(sizes.sum())} | shares)
        return Table(rows)

    def __str__(self) -> str:
        return ", ".join(f"{name} {share:.3g}" for name, share in self.shares.items())

    # ---------------------------------------------------------------- of one seam
    def _of_seam(self, name: str) -> npt.NDArray[np.str_]:
        model, count = self.state.model, len(self.state.model.joint.rows_of(name))
        one = model.layers.get(name)
        if one is None:
            return np.full(count, NO_LAYER)
        shares = self._shares(one)
        return np.full(count, ELASTIC) if shares is None else np.array(STATUSES)[shares.argmax(axis=0)]

    def _shares(self, one: SeamLayer) -> Array | None:
        """(statuses, facets) areas of each status on the facets of a seam; None for a law without plastic strain."""
        model, state = self.state.model, self.state
        for key, term in compiled_terms(model.terms).items():
            slots = memory_slots(term.law, "plastic", (3, 3)) if term.key == one.key else []
            if not slots:
                continue
            points = CompiledTerm(model.V, term, model.origin)
            points.at_time(state.t)
            e, memory = points.strain(state.u.x.petsc_vec) + GivenAtPoints(points)(state.t), state.memory[key]
            stress = points.respond(e, e, memory, 0.0, 1.0).whole  # nothing changes at these strains
            parts = [fraction * memory[:, k : k + len(MANDEL)] for fraction, _, k in slots]
            strains, stresses = tensors(e, points.slots), tensors(stress)
            found = self._at_points(points.n, strains, stresses, tensors(np.sum(parts, axis=0)))
            shares = np.array([points.columns.sum_of(points.weights * (found == status)) for status in STATUSES])
            points.destroy()
            return shares
        return None

    def _largest(self, values: Array) -> float:
        return float(self.state.model.comm.allreduce(float(np.abs(values).max(initial=0.0)), max))

    def _at_points(self, n: Array, e: Array, stress: Array, plastic: Array) -> npt.NDArray[np.str_]:
        """(points,) statuses, from normals (points, 3), and tensors (points, 3, 3)."""
        t, flow = np.einsum("pij,pj->pi", stress, n), 2 * np.einsum("pij,pj->pi", plastic, n)
        opening, t_N, closed = (np.einsum("pi,pi->p", a, n) for a in (np.einsum("pij,pj->pi", e, n), t, -flow / 2))
        slip = np.linalg.norm(flow + 2 * closed[:, None] * n, axis=1)
        still = np.maximum(slip, np.abs(closed)) <= ROUNDING * self._largest(e)
        free = (opening > 0) & (np.abs(t_N) <= ROUNDING * self._largest(t))
        kinds = [(free, OPEN), (still, ELASTIC), (slip >= np.abs(closed), SLIDING), (closed > 0, CRUSHED)]
        return np.select([where for where, _ in kinds], [kind for _, kind in kinds], TORN)
