"""Tractions on seams that meet: several act on one corner of a body."""

from __future__ import annotations

from functools import cached_property, reduce
from operator import add
from typing import Any

import dolfinx.fem.petsc
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from forms.kinematics import Expr, lift
from forms.law import explained
from forms.work import Term
from thinlayer.discretisation.clock import Hand
from thinlayer.discretisation.contact_nodes import ContactNodes, ContactSurface
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import real_law
from thinlayer.discretisation.pairs import Pairs
from thinlayer.discretisation.seams import SeamLayer
from thinlayer.discretisation.state import State, transfer
from thinlayer.output.seam_tractions import NO_JUMP
from thinlayer.output.surface_mass import SurfaceMass, contact_forces, nodal_forces, reaction
from thinlayer.parallel.exchange import ask

Mask = npt.NDArray[np.bool_]
Array = npt.NDArray[np.float64]
LEAST_SQUARES_TOLERANCE = 1e-15  # relative tolerance of the solver for the tractions whose forces are the reactions
MOST_ITERATIONS = 2000  # of this solver; it needs 29 to 45 on uniform meshes


class JunctionTractions:
    """Tractions on all seams of an interface model, with one value for each pair of bodies around a vertex (`Pairs`).

    Their forces on the nodes of all bodies are the bodies' reactions, in least squares if these are not in balance. Where a
    support holds a component of a body, its reaction is not known and is left out. What is left open is one circulation of
    forces for each component and each vertex around which the seams close a cycle, such as a T-junction or a crossing;
    and the components of the bodies on both sides that supports hold. There the tractions are those closest to

    - the law's at the jump, if this tells them: of laws in UFL without memory and rate;
    - for other laws the ones that are extrapolated from the nodes around (`SurfaceMass.extrapolate`); zero where supports
      hold both bodies together, if this follows from the law (`SeamLayer.zero_tractions`).

    The squares of differences are weighted with the areas around nodes. Tractions of contact laws are the law's; those of
    open seams are zero, and those where a seam ends inside a body.

    Args:
        model: an interface model.
        pairs: its pairs.
    """

    def __init__(self, model: InterfaceModel, pairs: Pairs) -> None:
        self.model, self.pairs, self._trace = model, pairs, model.space(1)
        self._sides = {name: model.sides_of(name) for name in model.joint.seams}

    def recovered(self, state: State) -> fem.Function:
        """The tractions in a state of either model, of this joint; a function of `pairs`. Collective."""
        model = state.model
        if isinstance(model, InterfaceModel) and model is not self.model:
            assert model.pairs is not None, "models of one joint"
            return self.pairs.from_other(JunctionTractions(model, model.pairs).recovered(state), model.pairs)
        r = reaction(state)
        if model.contact:
            r.x.array[:] -= contact_forces(state).x.array  # of areas around nodes, not of tractions of degree 1
        held, u = fem.Function(r.function_space), fem.Function(r.function_space)
        held.x.array[model.held_in(r.function_space)] = 1.0
        held.x.scatter_forward()
        u.interpolate(state.u)
        r, held, u = (transfer(f, model, self._trace, self.model) for f in (r, held, u))
        free = held.copy()
        free.x.array[:] = held.x.array < 0.5

        t, fixed, mute = fem.Function(self.pairs.space), self._blocks(self.pairs.tip), []
        for name in self._sides:
            layer, here = model.layers.get(name), self._on(name)
            if layer.contact if layer else model.layers:  # bonded bodies have no layers
                fixed |= here
            elif layer and _is_told(layer) and self._is_finite(by_law := self._by_law(layer, u, state.t)):
                t.x.array[here] = by_law.x.array[here]
            else:
                mute.append(name)
        t.x.array[fixed] = 0.0
        if mute:
            self._extrapolate(t, fixed, r, free, u, state, mute)
        self._fit(t, fixed, r, free)
        for name in model.contacts:
            t.x.array[:] += self._by_contact(state, model.layers[name]).x.array
        return t

    # ---------------------------------------------------------------- forms on all seams
    def _over_seams(self, integrand: Any, **metadata: object) -> Any:
        """Integral over all seams of a function of their sides, with the factor of measures but at single points."""
        factor = 1 if metadata else self.model.kinematics.factor
        measures = {name: sides.measure(metadata=metadata) for name, sides in self._sides.items()}
        return reduce(add, (integrand(sides) * factor * measures[name] for name, sides in self._sides.items()))

    def _at_vertices(self, integrand: Any) -> Array:
        """Integral over all seams of a function of their sides, by the quadrature rule whose points are vertices."""
        form = self._over_seams(integrand, quadrature_rule="vertex", quadrature_degree=1)
        return np.asarray(nodal_forces(self.pairs.space, form, self.pairs.maps).x.array)

    def _means(self, integrand: Any) -> Array:
        """Values of a vector function of the sides of seams at the nodes of `pairs`, means over their facets."""
        q = ufl.TestFunction(self.pairs.space)
        return self._at_vertices(lambda sides: ufl.inner(integrand(sides), sides.upper(q))) / self._vertex_areas

    @cached_property
    def _vertex_areas(self) -> Array:
        ones = fem.Constant(self.model.domain.mesh, np.ones(self.model.joint.dim))
        q = ufl.TestFunction(self.pairs.space)
        return self._at_vertices(lambda sides: ufl.inner(ones, sides.upper(q)))

    def _blocks(self, nodes: Mask) -> Mask:
        """The degrees of freedom of nodes."""
        return np.repeat(nodes, self.model.joint.dim)

    def _on(self, *names: str) -> Mask:
        """The degrees of freedom on seams."""
        return self._blocks(np.isin(self.pairs.seam, [list(self._sides).index(name) for name in names]))

    def _is_finite(self, f: fem.Function) -> bool:
        return not self.model.comm.allreduce(int(not np.isfinite(f.x.array).all()))

    @cached_property
    def _mass(self) -> SurfaceMass:
        p, q = ufl.TrialFunction(self.pairs.space), ufl.TestFunction(self.pairs.space)
        form = self._over_seams(lambda sides: ufl.inner(sides.upper(p), sides.upper(q)))
        return SurfaceMass(self.model, self.pairs.space, form, self.pairs.maps)

    @cached_property
    def _forces(self) -> PETSc.Mat:
        """Matrix from tractions to their forces on the nodes of the bodies."""
        p, v = ufl.TrialFunction(self.pairs.space), ufl.TestFunction(self._trace)
        form = self._over_seams(lambda sides: -ufl.inner(sides.upper(p), sides.jump(v)))
        B = dolfinx.fem.petsc.assemble_matrix(fem.form(form, entity_maps=self.pairs.maps))
        B.assemble()
        return B

    @cached_property
    def _body_areas(self) -> Array:
        """Area of S around the nodes of the bodies; zero off S."""
        ones = fem.Constant(self.model.domain.mesh, np.ones(self.model.joint.dim))
        v = ufl.TestFunction(self._trace)
        form = self._over_seams(lambda sides: ufl.inner(ones, sides.upper(v) + sides.lower(v)))
        return np.asarray(nodal_forces(self._trace, form).x.array)

    # ---------------------------------------------------------------- what is known beforehand
    def _by_law(self, layer: SeamLayer, u: fem.Function, t: float) -> fem.Function:
        """The law's tractions at the jump and a time, on a layer's seam."""
        terms, sides = Hand(t).terms(self.model.terms_of(layer)), self._sides[layer.name]

        def stress(term: Term) -> Expr:
            with explained(term.law, "stress"):
                return ufl.dot(term.law.stress(term.step(u)), lift(sides.n))

        total = reduce(add, map(stress, terms)) / len(terms)  # points through the thickness have equal weights
        by_law = ufl.as_vector([total[k] for k in range(len(sides.n))])
        rule = {"quadrature_rule": "vertex", "quadrature_degree": 1}
        form = ufl.inner(by_law, sides.upper(ufl.TestFunction(self.pairs.space))) * sides.measure(metadata=rule)
        found = nodal_forces(self.pairs.space, form, self.pairs.maps)
        found.x.array[:] /= self._vertex_areas
        return found

    def _by_contact(self, state: State, layer: SeamLayer) -> fem.Function:
        """The tractions of a contact law on its seam."""
        model, law = self.model, layer.contact
        assert law is not None
        surface = ContactSurface.of(model, layer.name)
        nodes = ContactNodes(surface, gap=law.gaps)
        t = law.traction(nodes.apart(state.u.x.petsc_vec), state.memory[layer.key])
        known = np.vstack([np.einsum("nij,ni->nj", nodes.frames, t), np.zeros(model.joint.dim)])  # the last: at tips
        imap = model.V.dofmap.index_map
        keys = nodes.pairs @ [imap.size_global + 1, 1]
        order = np.argsort(keys)

        def answer(asked: npt.NDArray[np.int64], _: npt.NDArray[np.int64]) -> Array:
            at = np.searchsorted(keys[order], asked)
            there = np.append(keys[order], -2)[at] == asked
            return np.asarray(known[np.where(there, np.append(order, 0)[at], len(known) - 1)])

        ours, upper, lower = self._bodies_of(surface)
        owners = np.concatenate([np.full(imap.size_local, model.comm.rank), imap.owners])
        upper_global, lower_global = (
            np.where(one < 0, -1, imap.local_to_global(np.maximum(one, 0))) for one in (upper, lower)
        )
        questions = upper_global * (imap.size_global + 1) + lower_global
        found = fem.Function(self.pairs.space)
        found.x.array.reshape(-1, model.joint.dim)[ours] = ask(model.comm, owners[upper], questions, answer)
        found.x.scatter_forward()
        nodes.destroy()
        return found

    def _bodies_of(self, surface: ContactSurface) -> tuple[npt.NDArray[np.int32], ...]:
        """Local nodes of `pairs` on this rank's facets of a surface, and those of the bodies above and below (base: -1)."""
        pairs, domain = self.pairs, self.model.domain
        cells = np.flatnonzero(np.isin(pairs.parent, surface.facets))
        at = np.searchsorted(surface.facets, pairs.parent[cells])
        corners, dofs = domain.on_cells(domain.joint.corners), np.asarray(surface.V.dofmap.list)
        sides = []
        for side in (surface.upper, surface.lower):
            if side is None:
                sides.append(np.full(pairs.vertices[cells].size, -1, np.int32))
                continue
            here = side[at]
            corner = (corners[here][:, None, :] == pairs.vertices[cells][:, :, None]).argmax(axis=2)
            sides.append(np.take_along_axis(dofs[here], corner, axis=1).ravel())
        return np.asarray(pairs.space.dofmap.list)[cells].ravel(), sides[0], sides[1]

    def _extrapolate(
        self,
        t: fem.Function,
        fixed: Mask,
        r: fem.Function,
        free: fem.Function,
        u: fem.Function,
        state: State,
        mute: list[str],
    ) -> None:
        """Extrapolate what reactions do not tell on seams whose laws are `mute`; add zero tractions to `fixed`."""
        here = self._on(*mute) & ~fixed
        held = self._means(lambda sides: sides.upper(free) + sides.lower(free)) < 0.5
        apart = np.abs(self._means(lambda sides: sides.jump(u)))
        together = held & (apart <= NO_JUMP * self.model.comm.allreduce(np.abs(u.x.array).max(initial=0.0), MPI.MAX))
        moving = bool(state.model.supports.functions)
        for name in mute if state.model.layers else ():
            along, whole = state.model.layers[name].zero_tractions(moving)
            nodes = (together & self._on(name)).reshape(-1, len(along))
            fixed |= (nodes & (along | (whole & nodes.all(axis=1, keepdims=True)))).ravel()
        self._fit(t, fixed, r, free)
        forces = fem.Function(self.pairs.space)
        forces.x.array[: len(self._mass.on_s)] = self._mass.times(t.x.array)
        unknown = (held | self._blocks(self.pairs.shared)) & ~fixed
        self._mass.extrapolate(forces, unknown, unknown & here)
        t.x.array[here] = self._mass.divide(forces, fixed).x.array[here]

    # ---------------------------------------------------------------- least squares
    def _fit(self, t: fem.Function, fixed: Mask, r: fem.Function, free: fem.Function) -> None:
        """Change tractions that are not `fixed` as little as possible so that their forces are the `free` reactions."""
        B, around = self._forces, self._mass.around
        x, b = B.createVecs()
        n, m = x.getLocalSize(), b.getLocalSize()
        if not self.model.comm.allreduce(int((~fixed[:n]).any())):
            return
        x.array[:] = t.x.array[:n]
        B.mult(x, b)
        areas = self._body_areas[:m]
        told = (areas > 0) & (free.x.array[:m] > 0.5)
        rows, columns = b.duplicate(), x.duplicate()
        rows.array[:] = np.where(told, np.where(areas > 0, areas, 1.0) ** -0.5, 0.0)
        columns.array[:] = np.where(fixed[:n], 0.0, around**-0.5)
        b.array[:] = (r.x.array[:m] - b.array_r) * rows.array_r
        size = b.norm(PETSc.NormType.NORM_INFINITY) or 1.0
        b.scale(1 / size)  # the squares of forces in the solver must neither underflow nor overflow
        A = B.copy()
        A.diagonalScale(rows, columns)
        ksp = PETSc.KSP().create(self.model.comm)
        ksp.setOperators(A)
        ksp.setType("lsqr")
        ksp.getPC().setType("none")
        ksp.setTolerances(rtol=LEAST_SQUARES_TOLERANCE, atol=LEAST_SQUARES_TOLERANCE, max_it=MOST_ITERATIONS)
        ksp.solve(b, x)  # from zero: the solution of least norm
        t.x.array[:n] += size * columns.array_r * x.array_r
        t.x.scatter_forward()
        for thing in (A, x, b, rows, columns, ksp):
            thing.destroy()


def _is_told(layer: SeamLayer) -> bool:
    """Whether the jump alone tells the traction of a law without contact, by an expression."""
    traits = real_law(layer.layer, layer.structure.kinematics).traits
    hidden = traits.compiled or traits.remembers or traits.rate or traits.constrained or traits.varies
    return traits.in_ufl and not hidden
