"""The displacements of the two faces of a layer on S."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geometry.sheet import Sheet
from geometry.topology import FloatArray, IntArray
from thinlayer.discretisation.seams import SeamLayer
from thinlayer.discretisation.state import State
from thinlayer.parallel.exchange import carry
from thinlayer.ranges.areas import Areas

JUMP_ROUNDING = 1e-9  # rounding of jumps, relative to the displacements


@dataclass(frozen=True)
class Faces:
    """Thickness (n, d) and displacements of the lower and upper face (n, d, d) at the vertices of the simplices of S."""

    state: State
    sheet: Sheet
    thickness: FloatArray
    lower: FloatArray
    upper: FloatArray

    @classmethod
    def of(cls, state: State, one: SeamLayer) -> Faces | None:
        """The faces of a state on rank 0, None on other ranks. Collective."""
        model, joint = state.model, state.model.joint
        cells = joint.surface_cells[one.sheet.facets]
        needed = np.unique(cells[cells >= 0])
        place = np.full(len(joint.cells), -1)
        place[needed] = np.arange(len(needed))
        domain = model.domain
        owned = domain.original_cells[: domain.mesh.topology.index_map(joint.dim).size_local]
        local = np.flatnonzero(place[owned] >= 0)
        dofs = np.asarray(model.V.dofmap.list)[local][:, : joint.corners.shape[1]]
        values = state.u.x.array.reshape(-1, joint.dim)[dofs].reshape(len(local), dofs.shape[1] * joint.dim)
        wanted = needed if model.comm.rank == 0 else needed[:0]
        values = carry(model.comm, owned[local], values, wanted)
        if model.comm.rank:
            return None
        at_corners, sheet = values.reshape(len(needed), -1, joint.dim), one.sheet
        below, above = cells[np.searchsorted(sheet.facets, sheet.parts[0])].T

        def at_vertices(cell: IntArray) -> FloatArray:
            corner = (joint.corners[cell][:, None, :] == sheet.vertices[:, :, None]).argmax(axis=2)
            return np.asarray(at_corners[place[cell][:, None], corner])

        assert one.thin
        relative = joint.relative_thickness(one.thin.profile, one.name)
        u, thickness = at_vertices(above), one.thin.eps * relative[sheet.vertices]
        return cls(state, sheet, thickness, 0 * u if (below < 0).any() else at_vertices(below), u)

    @cached_property
    def areas(self) -> Areas:
        """Areas of S around the vertices."""
        return Areas(self.sheet, self.state.model.kinematics)

    @cached_property
    def opening(self) -> FloatArray:
        """(n, d) [u_N]."""
        return np.asarray(((self.upper - self.lower) * self.sheet.normals).sum(axis=2))

    @property
    def slip_squared(self) -> FloatArray:
        """(n, d) |w_T|^2 plus the square of the rounding of displacements."""
        slip = self.upper - self.lower - self.opening[..., None] * self.sheet.normals
        return np.asarray((slip**2).sum(axis=2) + self.rounding**2)

    @property
    def rounding(self) -> float:
        """Rounding of jumps."""
        return JUMP_ROUNDING * float(max(np.abs(self.lower).max(), np.abs(self.upper).max()))

    @property
    def closing(self) -> FloatArray:
        """(n, d) approach of the faces, relative to the thickness."""
        return -self.opening / self.thickness

    @property
    def mean_closing(self) -> float:
        """Mean closing over S; an opening counts as zero."""
        return float((self.areas.at_vertices * np.maximum(self.closing, 0)).sum() / self.areas.total)
