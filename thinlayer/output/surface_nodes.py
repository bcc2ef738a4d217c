"""The nodes of S: projections of expressions to degree 1, and their values there."""

from __future__ import annotations

from functools import cached_property, partial

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from forms.interface import Interface
from forms.kinematics import Expr
from geometry.topology import IntArray
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.output.surface_expression import integrated
from thinlayer.output.surface_mass import SurfaceMass, nodal_forces

Array = npt.NDArray[np.float64]


class SurfaceNodes:
    """The nodes of S on its upper side; where seams meet, one for each pair of bodies at a vertex (`Pairs`). Collective.

    Args:
        model: an interface model.
        sides: the two sides of S, or of a seam.
        trace: vector functions of degree 1, broken across S.

    Attributes:
        space: of functions of degree 1 with values at the nodes.
    """

    def __init__(self, model: InterfaceModel, sides: Interface, trace: fem.FunctionSpace) -> None:
        self.model, self._sides, self._pairs = model, sides, model.pairs
        self.space = self._pairs.space if self._pairs else trace

    def project(self, f: Expr) -> fem.Function:
        """L2 projection of a vector expression, (d,)."""
        v = ufl.TestFunction(self.space)
        form = ufl.inner(f, self._sides.upper(v)) * self._sides.factor * self._sides.measure
        r = integrated(form, partial(nodal_forces, self.space, maps=self._maps))
        return self._mass.divide(r, np.zeros(len(r.x.array), bool))

    def values(self, f: Expr) -> tuple[IntArray, Array, Array]:
        """Numbers, places (n, d) and values of an expression's projection at the nodes of all ranks.

        Numbers are those of vertices, or of pairs of bodies at vertices.

        Args:
            f: vector expression on S, values (n, d), or a scalar one, values (n,).
        """
        V, d, pairs = self.space, self.model.joint.dim, self._pairs
        at = np.flatnonzero(self._on_s[: V.dofmap.index_map.size_local])
        values = self.project(f if f.ufl_shape else ufl.as_vector([f] + [0.0] * (d - 1))).x.array.reshape(-1, d)
        vertices = pairs.at_vertices[at] if pairs else self.model.domain.joint.masters[self._vertices[at]]
        numbers = pairs.numbers[at] if pairs else vertices
        rows = np.column_stack([numbers, self.model.domain.joint.points[vertices], values[at]])
        rows = np.concatenate(self.model.comm.allgather(rows))
        found = rows[:, 1 + d :] if f.ufl_shape else rows[:, 1 + d]
        return rows[:, 0].astype(np.int64), rows[:, 1 : 1 + d], found

    @property
    def _maps(self) -> object:
        return self._pairs.maps if self._pairs else None

    @cached_property
    def _vertices(self) -> npt.NDArray[np.int64]:
        """The vertex of the joint at each local node of the trace space."""
        domain, cells = self.model.domain, self.space.dofmap.list
        numbers = np.zeros(len(self.space.tabulate_dof_coordinates()), np.int64)
        numbers[cells] = domain.on_cells(domain.joint.cells)[: len(cells), : cells.shape[1]]
        return numbers

    @cached_property
    def _on_s(self) -> npt.NDArray[np.bool_]:
        """Which local nodes of the space lie on the upper side of S."""
        v = ufl.TestFunction(self.space)
        ones = fem.Constant(self.model.domain.mesh, np.ones(self.model.joint.dim))
        areas = nodal_forces(self.space, ufl.inner(ones, self._sides.upper(v)) * self._sides.measure, self._maps)
        return np.asarray(areas.x.array.reshape(-1, self.model.joint.dim)[:, 0] > 0)

    @cached_property
    def _mass(self) -> SurfaceMass:
        """Mass matrix of the upper side."""
        u, v = ufl.TrialFunction(self.space), ufl.TestFunction(self.space)
        form = ufl.inner(self._sides.upper(u), self._sides.upper(v)) * self._sides.factor
        return SurfaceMass(self.model, self.space, form * self._sides.measure, self._maps)
