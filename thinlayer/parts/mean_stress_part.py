"""Mean strain of a periodic cell under a prescribed mean stress: a few unknowns of the whole cell."""

from __future__ import annotations

from collections.abc import Sequence

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from forms.base import Array
from forms.tensors import three_dimensional
from forms.work import Term
from thinlayer.discretisation.mesh_functions import SharedDofs, broken_space
from thinlayer.discretisation.prescribed_strains import MEAN_STRAIN, MeanStress, from_voigt
from thinlayer.discretisation.time_functions import StepStrains, with_strains
from thinlayer.parts.form_part import strain_work
from thinlayer.parts.part import DISPLACEMENT_KEY, Block, FieldPart, FileOrder, PartTraits, StepOutcome, TimeStep
from thinlayer.pointwise.quadrature import assemble_matrix
from thinlayer.system.ranks import destroy


class MeanStressPart(FieldPart):
    """Mean strain E of a periodic cell as unknowns, with the equation that the mean stress has its prescribed value.

    The unknowns are the components of E times the size L of the cell, which are lengths; a shear component is 2 E_12.
    The rows of the equation are forces: the mean stress minus its prescribed value, times the cell's volume over L.

    Args:
        V: space of the displacements.
        bodies: virtual works of the bodies' laws, which are linear. Strains prescribed in them by eigenstrains are
            added to E.
        mean_stress: the prescribed mean stress.
        volume: volume of the cell.
        comm: communicator of the mesh.
    """

    key = MEAN_STRAIN
    traits = PartTraits(within_bodies=True)  # the mean strain is no rigid motion of a body

    def __init__(
        self, V: fem.FunctionSpace, bodies: Sequence[Term], mean_stress: MeanStress, volume: float, comm: MPI.Intracomm
    ) -> None:
        self._mean_stress, self.unit, self._volume, mesh = mean_stress, 1 / mean_stress.size, volume, V.mesh
        space = fem.functionspace(mesh, basix.ufl.element("DG", mesh.basix_cell(), 0, shape=(mean_stress.n_voigt,)))
        zeros = np.zeros(np.shape(space.dofmap.list), np.int64)
        W = broken_space(comm, SharedDofs(space, zeros[:1, 0], zeros[:1, 0], zeros))
        self.field = fem.Function(W)
        v, E, F = ufl.TestFunction(V), ufl.TrialFunction(W), ufl.TestFunction(W)
        strain, test_strain = (three_dimensional(from_voigt(voigt)) / mean_stress.size for voigt in (E, F))
        coupling = sum(strain_work(p, strain, p.strain(v)) for p in bodies)
        virtual_work = sum(strain_work(p, strain, test_strain) for p in bodies)
        self.B, self.D = assemble_matrix(fem.form(coupling)), assemble_matrix(fem.form(virtual_work))
        self._B_trans = self.B.transpose(PETSc.Mat())
        strained_terms = [p for p in bodies if p.prescribed_strain is not None]
        self._step_strain = StepStrains(mesh, strained_terms)
        prestrained = with_strains(strained_terms, self._step_strain.now)
        virtual_work = sum(strain_work(p, p.prescribed_strain, test_strain) for p in prestrained)
        self._strain_work = fem.form(virtual_work) if strained_terms else None
        self._forces, self._own_r, self._D_E = self.B.createVecLeft(), self.D.createVecLeft(), self.D.createVecLeft()
        self._mid, self._old, self._change = (self.D.createVecRight() for _ in range(3))

    # ---------------------------------------------------------------- a step
    def begin(self, interval: TimeStep) -> None:
        super().begin(interval)
        new, old = self._strain_forces(self._step_strain, self._strain_work)
        self._strain_forces_of_step = new, old, interval.theta * new + (1 - interval.theta) * old
        self._old.array[:] = self.own_values_before(interval.old)

    def evaluate(self, u: fem.Function, mid: fem.Function) -> None:
        theta, self._u = self.interval.theta, u
        self._mid.array[:] = theta * self.field.x.array[: self.own_size] + (1 - theta) * self._old.array_r
        self.B.mult(self._mid, self._forces)
        self.B.multTranspose(mid.x.petsc_vec, self._own_r)
        self.D.mult(self._mid, self._D_E)
        self._own_r.axpy(1.0, self._D_E)

    def add_forces(self, out: PETSc.Vec) -> float:
        out.axpy(1.0, self._forces)
        return float(self._forces.norm())

    def own_load_at(self, t: float) -> Array:
        mean_stress = self._mean_stress
        return np.asarray(mean_stress.voigt_components(t) * self._volume / mean_stress.size, float)[: self.own_size]

    def own_residual(self) -> Array:
        return np.asarray(self._own_r.array_r + self._strain_forces_of_step[2] - self.load)

    def tangents(self, relative_residual: float) -> list[Block]:
        u, E, theta = DISPLACEMENT_KEY, self.key, self.interval.theta
        matrices = (self.B, u, E), (self._B_trans, E, u), (self.D, E, E)
        return [Block(matrix, theta, row, column, kept=True) for matrix, row, column in matrices]

    def commit(self) -> StepOutcome:
        """Return those energies over the accepted step that the mean strain adds to the bodies' energies."""
        now, old = self._u.x.petsc_vec, self.interval.old.u.x.petsc_vec
        u_change = now - old
        self._change.array[:] = self.field.x.array[: self.own_size] - self._old.array_r
        self._mid.array[:] = self.field.x.array[: self.own_size]
        theta, (new_s, old_s, _) = self.interval.theta, self._strain_forces_of_step
        energy_arguments = (old, self._old, old_s), (now, self._mid, new_s), (u_change, self._change, new_s - old_s)
        before, after, change_energy = (self._energy(*arguments) for arguments in energy_arguments)
        supplied = self._work_in(self.load, self._change) + theta * self._work_in(new_s - old_s, self._mid)
        supplied += (1 - theta) * self._work_in(new_s - old_s, self._old)
        u_change.destroy()
        return StepOutcome(before, after, 0.0, (2 * theta - 1) * change_energy, kept=False, supplied=supplied)

    def _energy(self, u: PETSc.Vec, E: PETSc.Vec, forces: Array) -> float:
        """Return the energy that the mean strain adds to the bodies' energy, a number.

        Args:
            u: displacements.
            E: the unknowns: components of the mean strain times the size of the cell.
            forces: (own_size,) contribution of the bodies' prescribed strains to the rows of the equation of the mean
                stress.
        """
        self.B.mult(E, self._forces)
        self.D.mult(E, self._D_E)
        return float(u.dot(self._forces)) + float(E.dot(self._D_E)) / 2 + self._work_in(forces, E)

    def _work_in(self, forces: Array, E: PETSc.Vec) -> float:
        self._D_E.array[:] = forces
        return float(self._D_E.dot(E))

    # ---------------------------------------------------------------- own unknowns
    @property
    def own_file_order(self) -> FileOrder:
        """Order in which the mean strain's components are written to files: one row for the whole periodic cell."""
        return FileOrder(np.zeros(1, np.int64), np.arange(self._mean_stress.n_voigt)[None, :])

    def destroy(self) -> None:
        """Free the part's PETSc matrices and vectors."""
        destroy(self.B, self.D, self._B_trans, self._forces, self._own_r, self._D_E, self._mid, self._old, self._change)
