"""What happens on S: traction, jump and the displacements of both faces, for either model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import dolfinx.fem.petsc
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from petsc4py import PETSc

from forms.kinematics import Expr, layer_frame, lift
from forms.work import Interface, work
from thinlayer.loads import ModelError
from thinlayer.model import Model
from thinlayer.state import State, transfer

MASS_TOLERANCE = 1e-14


def reaction(state: State) -> fem.Function:
    """Nodal forces that the bodies pass to S, tested with degree-1 functions broken at its faces. Collective.

    On the nodes of each face r_i = int_body stress(u) : e(phi_i) - L(phi_i): what the layer (or the other body) exerts.
    """
    model = state.model
    model.coordinates.t.value = state.t
    W = model.space(1, broken_at_faces=True)
    v = ufl.TestFunction(W)
    return nodal_forces(W, work(model.bodies, state.u, v) - model.external_work(v))


def nodal_forces(V: fem.FunctionSpace, form: Expr) -> fem.Function:
    """Values of a linear form on the basis functions of a space, ghosts included. Collective."""
    vector = fem.assemble_vector(fem.form(form))
    vector.scatter_reverse(dolfinx.la.InsertMode.add)
    vector.scatter_forward()
    values = fem.Function(V)
    values.x.array[:] = vector.array
    return values


@dataclass(frozen=True)
class Surface:
    """S as the interface model sees it; fields of a full model on the same joint can be brought here.

    Attributes:
        model: an interface model.

    Raises:
        ModelError: another kind of model.
    """

    model: Model

    def __post_init__(self) -> None:
        if self.model.kind != "interface":
            raise ModelError(f"Surface needs an interface model, not {self.model!r}")

    def _require_same_joint(self, state: State) -> None:
        if state.model.joint is not self.model.joint:
            raise ModelError("this state's model has another joint than the surface; build both from the same one")

    @property
    def sides(self) -> Interface:
        """The two sides of S."""
        return cast(Interface, self.model.sides)

    @cached_property
    def trace_space(self) -> fem.FunctionSpace:
        """Degree-1 vector functions, broken across S."""
        return self.model.space(1)

    def displacement(self, state: State) -> fem.Function:
        """Displacement of a state (of either model) in the interface model's space. Collective."""
        self._require_same_joint(state)
        if state.model is self.model:
            return state.u
        return transfer(state.u, state.model, self.model.V, self.model)

    def jump(self, state: State) -> Expr:
        """[u] = u(upper face) - u(lower face), a UFL expression on S. Collective."""
        return self.sides.jump(self.displacement(state))

    def traction(self, state: State) -> Expr:
        """Traction t = stress n on S, (d,), a UFL expression of degree 1 on S. Collective.

        Mean over both faces of the bodies' reactions; components that a side support holds are left out (zero), because
        the reaction there is the support's too. It is zero at nodes where S ends inside the bodies: nothing jumps there.
        """
        self._require_same_joint(state)
        r = transfer(reaction(state), state.model, self.trace_space, self.model)
        t = self._divide_by_areas(r) if self.model.contact else self._divide_by_mass(r, self._held)
        if self.model.joint.rigid_base:
            return -self.sides.upper(t)
        return (self.sides.lower(t) - self.sides.upper(t)) / 2

    def nodal(self, f: Expr) -> fem.Function:
        """L2 projection of a vector expression on S to degree 1, a function on the upper side's nodes. Collective."""
        v = ufl.TestFunction(self.trace_space)
        r = nodal_forces(self.trace_space, ufl.inner(f, self.sides.upper(v)) * self.sides.measure)
        return self._divide_by_mass(r, np.empty(0, np.int32))

    def frame(self, f: Expr) -> Expr:
        """A vector expression on S in the frame of S: tangential components, then the normal one, (d,).

        The tangents are those of `forms.kinematics.layer_frame`: (n_2, -n_1) in 2D, its first and third axis in 3D.
        """
        n = self.sides.n
        axes = layer_frame(n)
        tangential = [ufl.dot(lift(f), axes[:, column]) for column in (0, 2)[: len(n) - 1]]
        return ufl.as_vector([*tangential, ufl.dot(f, n)])

    def profile(self, f: Expr) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Places (n, d) and values (n, d) of a vector expression, projected to degree 1, at the vertices of S. Collective.

        Sorted by the coordinates, the same on every rank.
        """
        V = self.trace_space
        d, owned = self.model.joint.dim, V.dofmap.index_map.size_local
        at = np.flatnonzero(self._upper_nodes[:owned])
        rows = np.hstack([V.tabulate_dof_coordinates()[at, :d], self.nodal(f).x.array.reshape(-1, d)[at]])
        rows = np.concatenate(self.model.comm.allgather(rows))
        close = 1e-9 * np.ptp(self.model.joint.points, axis=0).max()  # places that differ by rounding are the same
        rows = rows[np.lexsort(np.rint(rows[:, d - 1 :: -1] / close).T)]
        return rows[:, :d], rows[:, d:]

    @cached_property
    def _upper_nodes(self) -> npt.NDArray[np.bool_]:
        """Which local nodes of the trace space lie on the upper side of S."""
        return self._areas(self.sides.upper).reshape(-1, self.model.joint.dim)[:, 0] > 0

    def _areas(self, *sides: Callable[[Expr], Expr]) -> npt.NDArray[np.float64]:
        """Area of S around the nodes of sides, for every trace degree of freedom; zero elsewhere."""
        v = ufl.TestFunction(self.trace_space)
        ones = fem.Constant(self.model.domain.mesh, np.ones(self.model.joint.dim))
        form = sum(ufl.inner(ones, side(v)) for side in sides) * self.sides.measure
        return np.asarray(nodal_forces(self.trace_space, form).x.array)

    def integral(self, f: Expr) -> float:
        """Integral over S of a scalar expression. Collective."""
        return float(self.model.comm.allreduce(fem.assemble_scalar(fem.form(f * self.sides.measure))))

    def norm(self, f: Expr, where: Expr = 1) -> float:
        """L2 norm over S of a vector expression, weighted with `where`. Collective."""
        return float(np.sqrt(self.integral(where * ufl.inner(f, f))))

    @cached_property
    def _held(self) -> np.ndarray:
        """Supported trace degrees of freedom, on either side: one side's support counts for both."""
        V = self.trace_space
        mark = fem.Function(V)
        mark.x.array[self.model.supports.held(V)] = 1.0
        mark.x.scatter_forward()
        if self.model.joint.rigid_base:
            return np.flatnonzero(mark.x.array > 0)
        v, corners = ufl.TestFunction(V), {"quadrature_rule": "vertex", "quadrature_degree": 1}
        measure = self.sides.measure(metadata=corners)
        seen = nodal_forces(V, ufl.inner(mark("+"), v("-")) * measure + ufl.inner(mark("-"), v("+")) * measure)
        return np.flatnonzero((mark.x.array > 0) | (seen.x.array > 0))

    @cached_property
    def _mass(self) -> tuple[PETSc.Mat, np.ndarray]:
        """Mass matrix of both sides of S, and the local degrees of freedom on S."""
        V, sides = self.trace_space, self.sides
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        form = ufl.inner(sides.upper(u), sides.upper(v)) * sides.measure
        if not self.model.joint.rigid_base:
            form += ufl.inner(sides.lower(u), sides.lower(v)) * sides.measure
        A = dolfinx.fem.petsc.assemble_matrix(fem.form(form))
        A.assemble()
        diagonal = A.getDiagonal()
        return A, diagonal.array > 0

    def _divide_by_areas(self, r: fem.Function) -> fem.Function:
        """Nodal forces over the areas of the nodes, as contact laws see them; zero where held."""
        sides = (self.sides.upper,) if self.model.joint.rigid_base else (self.sides.upper, self.sides.lower)
        area = self._areas(*sides)
        t = fem.Function(self.trace_space)
        on_s = area > 0
        t.x.array[on_s] = r.x.array[on_s] / area[on_s]
        t.x.array[self._held] = 0.0
        return t

    def _divide_by_mass(self, r: fem.Function, left_out: np.ndarray) -> fem.Function:
        """Solve M t = r on the nodes of S with the components `left_out` zero."""
        V = self.trace_space
        mass, on_s = self._mass
        owned = V.dofmap.index_map.size_local * V.dofmap.index_map_bs
        keep = on_s.copy()
        keep[left_out[left_out < owned]] = False
        first = V.dofmap.index_map.local_range[0] * V.dofmap.index_map_bs
        rows = PETSc.IS().createGeneral((first + np.flatnonzero(keep)).astype(PETSc.IntType), comm=self.model.comm)
        A = mass.createSubMatrix(rows, rows)
        t = fem.Function(V)
        ksp = PETSc.KSP().create(self.model.comm)
        ksp.setOperators(A)
        ksp.setType("cg")
        ksp.getPC().setType("jacobi")
        ksp.setTolerances(rtol=MASS_TOLERANCE, atol=1e-300, max_it=1000)
        b = A.createVecLeft()
        x = A.createVecRight()
        b.array[:] = r.x.array[:owned][keep]
        ksp.solve(b, x)
        t.x.array[:owned][keep] = x.array
        t.x.scatter_forward()
        for thing in (A, b, x, rows, ksp):
            thing.destroy()
        return t
