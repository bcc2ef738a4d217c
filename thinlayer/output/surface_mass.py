"""Forces at the nodes of S and tractions on S: from one to the other."""

from __future__ import annotations

from typing import Any

import dolfinx.fem.petsc
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from petsc4py import PETSc

from forms.kinematics import Expr
from thinlayer.discretisation.contact_nodes import ContactNodes, ContactSurface
from thinlayer.discretisation.measures import compiled
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State

MASS_TOLERANCE = 1e-14  # relative tolerance of the solver for the mass matrix of S
SPREAD = 0.1  # least extent of the places of known tractions, relative to their distance, for a slope


def reaction(state: State) -> fem.Function:
    """Nodal forces that the layer (or the other body) exerts on the bodies, on the nodes of the faces of S. Collective.

    r_i = int_body stress(u) : e(phi_i) - L(phi_i), with the work of additions to the model (springs at the end of S, say)
    on the left. The functions phi_i have degree 1 and jump at the faces of S.
    """
    model = state.model
    W = model.space(1, broken_at_faces=True)
    v = ufl.TestFunction(W)
    # Each form by itself: in a sum DOLFINx 0.9 loses integrals over overlapping sets of regions with unlike quadrature.
    r = nodal_forces(W, state.work(state.bodies, v))
    if (added := model.added_work_in(state, v)).integrals():
        r.x.array[:] += nodal_forces(W, added).x.array
    r.x.array[:] -= nodal_forces(W, model.external_work(v, state.t)).x.array
    return r


def nodal_forces(V: fem.FunctionSpace, form: Expr, maps: Any = None) -> fem.Function:
    """Values of a linear form on the basis functions of a space, ghosts included; `maps`: for `fem.form`. Collective."""
    return assembled(V, fem.form(form, entity_maps=maps) if maps else compiled(form))


def assembled(V: fem.FunctionSpace, form: fem.Form) -> fem.Function:
    """Values of a compiled linear form on the basis functions of a space, ghosts included. Collective."""
    vector = fem.assemble_vector(form)
    vector.scatter_reverse(dolfinx.la.InsertMode.add)
    vector.scatter_forward()
    values = fem.Function(V)
    values.x.array[:] = vector.array
    return values


def contact_forces(state: State) -> fem.Function:
    """Nodal forces that a contact law passes to the bodies, in the state's space. Collective."""
    model, forces = state.model, fem.Function(state.model.V)
    for name, law in model.contacts.items():
        nodes = ContactNodes(ContactSurface.of(model, name), gap=law.gaps)
        out = nodes.zero()
        slip = state.memory[model.layers[name].key]
        nodes.add_forces(-law.traction(nodes.apart(state.u.x.petsc_vec), slip), out)
        forces.x.array[: out.getLocalSize()] += out.array_r
        nodes.destroy()
        out.destroy()
    forces.x.scatter_forward()
    return forces


class SurfaceMass:
    """Mass matrix of vector functions of degree 1 on S. Collective, as all methods are.

    Args:
        model: a model with S.
        V: space of the functions.
        form: bilinear form of the mass matrix.
        maps: of V's mesh, for `fem.form`.

    Attributes:
        matrix: the mass matrix.
        on_s: which of this rank's degrees of freedom are on S.
    """

    def __init__(self, model: Model, V: fem.FunctionSpace, form: Expr, maps: Any = None) -> None:
        self.comm, self.V = model.comm, V
        self._d, self._centre = model.joint.dim, model.joint.points.mean(axis=0)
        self.matrix = dolfinx.fem.petsc.assemble_matrix(fem.form(form, entity_maps=maps))
        self.matrix.assemble()
        self.on_s: npt.NDArray[np.bool_] = self.matrix.getDiagonal().array > 0
        self.around = self.times(np.ones(len(self.on_s)))  # area of S around the nodes; zero off S

    def times(self, values: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
        """Mass matrix times the values at local degrees of freedom, those of this rank."""
        x, y = self.matrix.createVecs()
        x.array[:] = values[: len(self.on_s)]
        self.matrix.mult(x, y)
        found = y.array.copy()
        x.destroy()
        y.destroy()
        return np.asarray(found)

    def extrapolate(self, r: fem.Function, unknown: npt.NDArray[np.bool_], wanted: npt.NDArray[np.bool_]) -> None:
        """Extrapolate nodal forces to the `wanted` ones among the `unknown` ones, which do not follow from reactions.

        The known forces over the areas of their nodes are the values of a linear traction at the centroids of the nodes'
        functions. A linear function of these places is fitted by least squares to the known values up to two nodes away,
        weighted with the square of the mass matrix. It is constant along directions in which the places hardly spread:
        across S, and along S if there is one place only.
        """
        on_s, d = self.on_s, self._d
        owned = len(on_s)
        at, fitted = np.flatnonzero(on_s & wanted[:owned]), on_s & ~unknown[:owned]
        area = np.where(on_s, self.around, 1.0)
        x = self.V.tabulate_dof_coordinates()[: owned // d, :d] - self._centre
        x = np.array([self.times(row) / area for row in x.repeat(d, axis=0).T])
        known = [np.ones(owned), *x, r.x.array[:owned] / area]
        moments = np.zeros((len(at), d + 1, d + 2))
        for i in range(d + 1):
            for j in range(i, d + 2):
                sums = self.times(self.times(np.where(fitted, known[i] * known[j], 0.0)))[at]
                moments[:, i, j] = sums
                if j <= d:
                    moments[:, j, i] = sums
        weight = moments[:, :1, :1]
        moments /= np.where(weight > 0, weight, 1.0)
        centre, mean = moments[:, 0, 1 : d + 1], moments[:, 0, d + 1]
        spread, axes = np.linalg.eigh(moments[:, 1:, 1 : d + 1] - centre[:, :, None] * centre[:, None, :])
        common = np.einsum("nki,nk->ni", axes, moments[:, 1:, d + 1] - centre * mean[:, None])
        away = x[:, at].T - centre
        wide = spread > SPREAD**2 * (away**2).sum(axis=1)[:, None]
        change = np.einsum("nki,nk->ni", axes, away) * common / np.where(wide, spread, np.inf)
        r.x.array[at] = (mean + change.sum(axis=1)) * area[at]
        r.x.scatter_forward()

    def divide_by_areas(self, r: fem.Function) -> fem.Function:
        """Nodal forces over the areas of the nodes: the traction as contact laws define it."""
        on_s, t = self.on_s, fem.Function(self.V)
        t.x.array[: len(on_s)][on_s] = r.x.array[: len(on_s)][on_s] / self.around[on_s]
        t.x.scatter_forward()
        return t

    def divide(self, r: fem.Function, zero: npt.NDArray[np.bool_]) -> fem.Function:
        """Solve M t = r on the nodes of S, with the mass matrix M; t = 0 where `zero`."""
        V, mass, on_s = self.V, self.matrix, self.on_s
        keep = on_s & ~zero[: len(on_s)]
        first = V.dofmap.index_map.local_range[0] * V.dofmap.index_map_bs
        rows = PETSc.IS().createGeneral((first + np.flatnonzero(keep)).astype(PETSc.IntType), comm=self.comm)
        A = mass.createSubMatrix(rows, rows)
        t = fem.Function(V)
        ksp = PETSc.KSP().create(self.comm)
        ksp.setOperators(A)
        ksp.setType("cg")
        ksp.getPC().setType("jacobi")
        ksp.setTolerances(rtol=MASS_TOLERANCE, atol=0.0, max_it=1000)
        b = A.createVecLeft()
        x = A.createVecRight()
        b.array[:] = r.x.array[: len(on_s)][keep]
        size = b.norm(PETSc.NormType.NORM_INFINITY) or 1.0
        b.array[:] /= size  # the squares of forces in the solver must neither underflow nor overflow
        ksp.solve(b, x)
        t.x.array[: len(on_s)][keep] = x.array * size
        t.x.scatter_forward()
        for thing in (A, b, x, rows, ksp):
            thing.destroy()
        return t
