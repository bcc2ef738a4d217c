"""The pressure of an incompressible layer: a field on the cells of the meshed layer, or on S."""

from __future__ import annotations

from collections.abc import Sequence

import dolfinx.fem.petsc
import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from forms.work import Term
from thinlayer.discretisation.given import OverStep
from thinlayer.discretisation.state import PRESSURE, Configuration
from thinlayer.parts.part import DISPLACEMENTS, Array, Block, FileOrder, Interval, Outcome, Part, PartTraits
from thinlayer.pointwise.quadrature import Origin, Region


class PressurePart(Part):
    """int q tr e = 0 for all pressures q, continuous of degree 1, beside displacements of degree 2.

    The strain e is that of the displacements, and the one that is given beside it: a free expansion makes room.

    In the meshed layer this is the pair of Taylor and Hood. On S a multiplier of degree 1 meets jumps of degree 2.

    Args:
        V: space of the displacements.
        term: term of the incompressible law.
        stiffness: stiffness of the bodies at a node, force per displacement, > 0. It makes the rows of G forces, so that
            residuals of both kinds have one unit.
        origin: original numbers of the cells of the mesh, for files.
        key: of the pressure, among the fields of states.
        parts: terms with given strains, of which `term` is made up; by default the term alone.

    Attributes:
        region: the cells of the meshed layer, or S.
        unit: factor of G; `field` is the pressure divided by it.
        G: matrix of int q tr e(v) times `unit`; rows: pressures, columns: displacements.
    """

    traits = PartTraits(saddle=True, weakens=True)
    hint = "S has too few cells for the pressures of its layer"

    def __init__(
        self,
        V: fem.FunctionSpace,
        term: Term,
        stiffness: float,
        origin: Origin | None = None,
        key: str = PRESSURE,
        parts: Sequence[Term] | None = None,
    ) -> None:
        self.key, self._origin = key, origin
        self.region = region = Region(V.mesh, term.measure)
        space = fem.functionspace(region.mesh, ("Lagrange", 1))
        self.field = self._p = fem.Function(space)
        q, v = region.side(ufl.TestFunction(space)), ufl.TrialFunction(V)
        form = q * ufl.tr(term.strain(v)) * term.weight * term.measure
        self.G = dolfinx.fem.petsc.assemble_matrix(fem.form(form, entity_maps=region.maps))
        self.G.assemble()
        self.unit = stiffness / self.G.norm(PETSc.NormType.INFINITY)
        self.G.scale(self.unit)
        strained = [p for p in parts or [term] if p.given is not None]
        self._over = OverStep(V.mesh, strained)
        room = sum(q * ufl.tr(self._over.now(p.given)) * p.weight * p.measure for p in strained)
        self._room = fem.form(room, entity_maps=region.maps) if strained else None
        self._turned = PETSc.Mat()
        self.G.transpose(self._turned)
        self._volume, self._forces = self.G.createVecLeft(), self.G.createVecRight()

    def begin(self, interval: Interval) -> None:
        super().begin(interval)
        old = interval.old
        self._given, before = self._of_given(interval.t), self._of_given(old.t, at_rest=old.at_rest)
        self._growth = self._given - before

    def _of_given(self, t: float, *, at_rest: bool = False) -> Array:
        """What given strains add to `own_residual`, at a time or at rest."""
        if self._room is None:
            return np.zeros(self.own_size)
        self._over.look_at(t, at_rest=at_rest)
        b = dolfinx.fem.petsc.assemble_vector(self._room)
        b.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
        found = self.unit * b.array_r
        b.destroy()
        return np.asarray(found)

    def evaluate(self, u: fem.Function, mid: fem.Function) -> None:
        self.G.mult(u.x.petsc_vec, self._volume)

    def add_forces(self, out: PETSc.Vec) -> float:
        self.G.multTranspose(self._p.x.petsc_vec, self._forces)
        out.axpy(1.0, self._forces)
        return 0.0

    def own_residual(self) -> Array:
        return np.asarray(self._volume.array_r + self._given)

    def tangents(self, relative_residual: float) -> list[Block]:
        return [
            Block(self._turned, row=DISPLACEMENTS, column=self.key, kept=True),
            Block(self.G, row=self.key, column=DISPLACEMENTS, kept=True),
        ]

    def commit(self) -> Outcome:
        """As in `Part`; the pressure of a constraint does no work but in given strains, which displacements follow."""
        self._volume.array[:] = self._growth
        return Outcome(kept=False, supplied=float(self._volume.dot(self._p.x.petsc_vec)))

    def own_start(self, old: Configuration) -> Array:
        p = old.fields.get(self.key)
        return super().own_start(old) if p is None else p.x.array[: self.own_size] / self.unit

    def own_result(self) -> fem.Function:
        """The pressure at the end of the step; `field` is the one at old.t + theta dt."""
        p, old, theta = self._p.copy(), self.interval.old.fields.get(self.key), self.interval.theta
        p.x.array[:] *= self.unit
        if theta < 1 and old is not None:
            p.x.array[:] = (p.x.array - (1 - theta) * old.x.array) / theta
        return p

    @property
    def own_file_order(self) -> FileOrder:
        assert self._origin is not None, "a mesh without a joint"
        space, region = self._p.function_space, self.region
        cells = np.asarray(space.dofmap.list)
        x = space.tabulate_dof_coordinates()[:, : region.mesh.geometry.dim]
        return FileOrder.by_place(self._origin.numbers(region.dim, region.parent)[: len(cells)], cells, x)

    def destroy(self) -> None:
        for thing in (self.G, self._turned, self._volume, self._forces):
            thing.destroy()
