"""State: equilibrium of a model at a time, with energies, reactions, stresses and its transfer to other models."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from operator import add
from typing import Any

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from forms.base import Array, InputError
from forms.tensors import MANDEL_PAIRS, Expr, mandel_tensor, mandel_vector, scalar_strain, three_dimensional
from forms.work import Term, energy, stress, with_added_strain
from geometry.domain import Domain
from geometry.seam import BASE, S
from geometry.topology import IntArray
from thinlayer.discretisation.coefficient import Coordinates, HandedField
from thinlayer.discretisation.form_compilation import checked_user_form, compiled_functionals, unit_values
from thinlayer.discretisation.key import BODY_KIND, LAYER_KIND, PRESSURE_KIND, Key
from thinlayer.discretisation.layer import BODIES
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.prescribed_strains import MEAN_STRAIN, VOIGT_POSITIONS_OF_DIM, from_voigt
from thinlayer.discretisation.rigid_motions import Resultant, default_moment_point, load_resultants, resultant
from thinlayer.discretisation.supports import Place, is_same_or_part
from thinlayer.discretisation.time_functions import TimeLevel, with_strains
from thinlayer.errors import FormerNames
from thinlayer.system.ranks import carry_cell_values


@dataclass(frozen=True)
class Report(FormerNames):
    """Method, iterations and residual of a solve.

    Attributes:
        method: "linear" or "newton"; with a contact law also "condensed" (to displacements of S), "multigrid" or
            "relaxation".
        iterations: Newton steps, or Krylov iterations of a linear solve, or sweeps of the relaxation; the sum over all
            attempts.
        residual: norm of the residual over the size of the forces.
        seconds: wall time of assembling and solving.
        homotopy_steps: number of solves with laws that are easier to solve than the layer's law and approach it; 0
            unless Newton's method failed.
    """

    former_names = {"eased": "homotopy_steps"}
    method: str
    iterations: int
    residual: float
    seconds: float
    homotopy_steps: int = 0


@dataclass(frozen=True)
class Audit:
    """Energy balance of a step: supplied = stored + dissipated + remainder, to the solver's tolerance.

    Energies are per unit thickness in 2D. All except `total` are increments over the step. All except `supplied` are
    NaN for laws without energy.

    Attributes:
        supplied: work of the loads and of moving supports.
        stored: increment of the energy stored in bodies, layers and other parts such as springs.
        dissipated: energy dissipated in bodies, layers and other parts.
        remainder: error of the time scheme, and the effect of parameters that vary in time, at fixed strains. For
            backward Euler the error is the energy of the increments. For the midpoint scheme it is zero if laws have a
            quadratic energy.
        total: energy stored in bodies, layers and other parts at the end of the step.
    """

    supplied: float = 0.0
    stored: float = 0.0
    dissipated: float = 0.0
    remainder: float = 0.0
    total: float = 0.0

    @property
    def imbalance(self) -> float:
        """Relative residual of the energy balance: a number, near 0 if the solver has converged.

        It is supplied - stored - dissipated - remainder, over the largest absolute value of these four and `total`. It
        is NaN if one of the four is not known, as for laws without energy.
        """
        terms = (self.supplied, self.stored, self.dissipated, self.remainder)
        largest = max(abs(self.total), *map(abs, terms)) if all(map(math.isfinite, terms)) else math.nan
        return (terms[0] - sum(terms[1:])) / largest if largest else 0.0


@dataclass(frozen=True, repr=False)
class Configuration:
    """Displacements at a time and what laws and other parts remember: initial data of a step.

    Attributes:
        u: displacement; in a periodic cell without the motion of the mean strain.
        t: time.
        memory: key -> internal values that laws and other parts of the balance of forces keep from step to step. A
            compiled law has an array (points, values) under "layer", for sublayers "layer 1", "layer 2", ..., and in a
            body "body NAME". A contact law has "contact": its slip at this rank's nodes of S, (nodes, d - 1) in d
            dimensions. A user-defined part may have functions by name. With several seams keys contain their names:
            "layer BED", "layer BED/1", "contact BED".
        fields: key of a part -> its unknowns other than displacements.
        stored: key -> energy at the time t, of compiled laws and other parts; energies of laws in UFL forms are left
            out.
        at_rest: whether this is the configuration before the first step, with all strains zero, prescribed strains
            included.
        reactions: (n, k) reactions of the n places in `Model.held_places`, k = 3 in 2D, 6 in 3D: the force, then the moment
            about `Model.centre`. None: they were not computed.
        stresses: key, as in `memory` -> stresses of a compiled law at the time t, (points, 6) in Mandel's order.
    """

    u: fem.Function
    t: float
    memory: Mapping[str, Any] = field(default_factory=dict)
    fields: Mapping[str, fem.Function] = field(default_factory=dict)
    stored: Mapping[str, float] = field(default_factory=dict)
    at_rest: bool = False
    reactions: Array | None = None
    stresses: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True, repr=False, kw_only=True)
class State(Configuration):
    """Equilibrium of a model at a time.

    A state has all attributes of a `Configuration`, such as `memory` and `fields`.

    Attributes:
        u: displacement, a function in model.V; in a periodic cell without the motion of the mean strain.
        t: time.
        model: the model.
        report: method, iterations and residual of the solve.
        audit: energy balance of the step that led here.
        sudden: whether it is the response to sudden loads from rest.
        prescribed_work: work of the reactions at the end of the step in the displacements that supports prescribe, and
            in prescribed motions of multi-point constraints; NaN: not known.
        dissipated: with several seams, name of a seam -> energy that its layer dissipated in this step, without losses
            in a snap. "bodies" -> energy that bodies dissipated, if their laws have memory or depend on rates.
        with_meshed_layers: whether the bodies are in equilibrium with meshed layers, as in `Estimate.better`, and not
            with interface laws. `Surface.traction` is then that of the bodies.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, solve
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> state = solve(plates.interface(ThinLayer(glue, eps=0.05)))
        >>> {part: round(energy, 5) for part, energy in state.energies().items()}
        {'bodies': 0.00384, 'layer': 0.00423, 'loads': 0.01614}
        >>> print(state.reaction("BOTTOM").force.round(6), state.applied().force.round(6))
        [-12.  40.] [ 12. -40.]
        >>> on_top = state.model.ds(state.model.domain.values("TOP"))
        >>> f"{state.integral(state.u[1] * on_top) / 4:.3g}"  # mean displacement along y
        '-0.000243'
    """

    model: Model
    report: Report
    audit: Audit = Audit()
    sudden: bool = False
    prescribed_work: float = math.nan
    dissipated: Mapping[str, float] = field(default_factory=dict)
    with_meshed_layers: bool = False

    @property
    def p(self) -> fem.Function | None:
        """Pressure in a layer whose law has a pressure field, on the layer's cells or on S; None if no law has one.

        If several layers have a pressure, `p` raises InputError: use `fields["pressure NAME"]`, with the name of a
        seam.
        """
        keys = [key for key in self.fields if Key.parse(key).kind == PRESSURE_KIND]
        if len(keys) > 1:
            raise InputError(f"the layers have several pressures; take state.fields[...] of {', '.join(keys)}")
        return self.fields[keys[0]] if keys else None

    def __repr__(self) -> str:
        return f"State({self.model!r}, t = {self.t:g}, {self.report.method}, {self.report.iterations} iterations)"

    def field_on(self, at: Coordinates) -> Expr:
        """Return the scalar field of this state as UFL on the mesh of another model. Collective."""
        return scalar_field_on(self, at.domain)

    def identity(self) -> dict[str, object]:
        """Return the data that identify the state, as JSON: those of its model, and the time."""
        return {"state of": self.model.identity(), "t": self.t}

    def integral(self, form: ufl.Form) -> float:
        """Return the value of a UFL form without arguments, with the factor 2 pi r in axisymmetry. Collective.

        Raises:
            InputError: it is no form, or depends on the time; a number in it is not finite or not real; no cell or
                facet has one of its tags.
        """
        return self._integrate(checked_user_form(form, self.model.domain, self.model.kinematics))

    def _integrate(self, form: ufl.Form) -> float:
        return float(self.model.comm.allreduce(sum(map(fem.assemble_scalar, compiled_functionals(form)))))

    def energies(self) -> dict[str, float]:
        """Return the stored energies of "bodies", "layer" and other parts by key, and the work of "loads". Collective.

        With several seams "layer" is the sum over all layers, and "layer NAME" is the energy of the layer on the seam
        NAME. This includes cells with its law where meshed layers meet.

        Energies are per unit thickness in 2D. For linear laws and supports that do not move, the stored energies are
        half the work of the loads (Clapeyron). An energy is NaN if a law does not declare its energy.
        """
        model, layers = self.model, self.layers
        of_parts = {part.key: self.stored.get(part.key, 0.0) for part in model.parts if not part.has_constraint}
        of_bodies = {p.key: self.stored[p.key] for p in model.bodies if p.key in self.stored}
        of_layers = {key: energy for key, energy in self.stored.items() if key not in {*of_parts, *of_bodies}}
        for key in {p.key: None for p in layers}:
            of_layers[key] = of_layers.get(key, 0.0) + self._form_energy([p for p in layers if p.key == key])
        body_energy, layer_energy = self._form_energy(self.bodies) + sum(of_bodies.values()), sum(of_layers.values())
        seams = {str(Key(LAYER_KIND, name)): energy for name, energy in model.seam_sums(of_layers).items()}
        return {BODIES: body_energy, LAYER_KIND: layer_energy, **seams, **of_parts, "loads": self.load_work()}

    def load_work(self) -> float:
        """Return the work of the loads at the state's time in its displacements. Collective."""
        part_work = sum(part.load_work(self.model, self) for part in self.model.parts)
        work = self.model.external_work(self.u, self.t)
        for name, layer in self.model.layers.items():
            if (b := self.fields.get(layer.bubble_key)) is not None:
                work += TimeLevel(self.t).at_level(self.model.forces.work_on_bubble(name, b))
        return self._integrate(work) + part_work

    def reaction(self, place: Place, about: Sequence[float] | None = None) -> Resultant:
        """Return the reaction of a place: of its supports and springs, or of the rigid base of a layer. Collective.

        A support continues over the side of a layer that ends at the place, and the force on this side is included. If
        several supports prescribe a displacement, its force is divided equally among them. The reactions of all places
        and the loads (`applied`) add up to zero.

        Args:
            place: name of a facet set or coordinates of a vertex, as in `Structure.supports`. "NAME" includes supports
                of its parts "NAME/REGION" (on one body) and "NAME/LAYER" (the layer's own side). Also the name of a
                seam on a rigid base, or "S" for all these seams.
            about: the point (d,) of the moment, in the coordinates of the model's mesh; by default the centroid of the
                place.

        Raises:
            InputError: the place has no supports, springs or rigid base.
        """
        model, reactions = self.model, self.reactions_by_place()
        bases = {BASE, *model.joint.base_seams}
        places = [name for name in reactions if is_same_or_part(name, place)]
        if place == S or (place in bases and not places):
            places = [name for name in reactions if name in bases]
        if not places:
            held_places = ", ".join(map(repr, reactions)) or "nothing"
            raise InputError(f"nothing holds {place!r}: it is free of supports and springs; held are: {held_places}")
        point = default_moment_point(model, place, places) if about is None else about
        return reduce(add, (reactions[name] for name in places)).at(point)

    def work_of_parts(self, v: Expr) -> Expr:
        """Return the virtual work, in v, of the forces of `parts` such as springs, a UFL form that is linear in v."""
        return sum((part.work_in(self.model, self, v) for part in self.model.parts), ufl.Form([]))

    def reactions_by_place(self, about: Sequence[float] | None = None) -> dict[Place, Resultant]:
        """Return the reactions of all places that support the structure, by place.

        Moments are about the point `about` (d,), by default `Model.centre`.

        Raises:
            InputError: the reactions of this state were not computed.
        """
        model = self.model
        if self.reactions is None:
            hint = "; ask estimate for goals.Reaction(place, direction)" * self.with_meshed_layers
            hint += "; observe it where state.t > 0" * self.at_rest
            hint += "; vibrations have none" * (self.report.method == "modes")
            raise InputError(f"this state has no reactions: it was not solved for{hint}")
        part_reactions = [row for part in model.parts for row in part.reaction(model, self.u)]
        all_reactions = [*zip(model.held_places, self.reactions, strict=True), *part_reactions]
        reactions = [(place, resultant(model, values)) for place, values in all_reactions]
        base_loads = load_resultants(model, self.t, model.forces.work_on_bases)
        reactions += [(name, -load) for name, load in base_loads.items()]
        reactions += [*load_resultants(model, self.t, model.forces.work_of_parts).items()]
        total: dict[Place, Resultant] = {}
        for place, reaction in reactions:
            total[place] = total[place] + reaction if place in total else reaction
        return {place: reaction.at(model.centre if about is None else about) for place, reaction in total.items()}

    def applied(self, about: Sequence[float] | None = None) -> Resultant:
        """Return the resultant force and moment of all loads at the time of the state. Collective.

        Args:
            about: the point (d,) of the moment; by default `Model.centre`.
        """
        return self.model.applied(self.t).at(self.model.centre if about is None else about)

    def mean_strain(self) -> Array:
        """Return the mean strain (d, d) of a periodic cell, prescribed or computed under a mean stress. Collective.

        It is zero if the model prescribes neither. For a scalar field it is the mean gradient (d,).
        """
        model, d = self.model, self.model.joint.dim
        if model.strain:
            return model.strain.tensor_at(self.t)
        if MEAN_STRAIN not in self.fields:
            return np.zeros((d,) if model.n_components == 1 else (d, d))
        E, dofmap = self.fields[MEAN_STRAIN].x.array, self.fields[MEAN_STRAIN].function_space.dofmap
        owned_values = E[: dofmap.index_map.size_local * dofmap.index_map_bs]
        return np.concatenate(model.comm.allgather(owned_values))[VOIGT_POSITIONS_OF_DIM[d]] / (2 - np.eye(d))

    @cached_property
    def bodies(self) -> list[Term]:
        """Terms of the bodies' laws at the state's time, with prescribed strains and the mean strain. Collective."""
        return self._terms_at_time(self.model.bodies)

    @cached_property
    def layers(self) -> list[Term]:
        """Terms of the layers' laws at the state's time, with prescribed strains. Collective.

        In meshed layers the mean strain of a periodic cell is included.
        """
        return self._terms_at_time(self.model.layer_terms, on_s=self.model.broken)

    @cached_property
    def elastic_share(self) -> float:
        """Fraction of the work of yielding laws that their elastic parts do. Collective.

        A yielding law may have an elastic part in parallel, with `elastic_fraction` of its stiffness. The fraction is
        the work of the stresses of these parts in the strains, over the work of all stresses of such laws. It is the
        larger of the values for layers and for bodies, and 0 without such laws. Before any yielding it equals
        `elastic_fraction`.
        """
        work, terms = np.zeros((2, 2)), self.bodies + self.layers
        for key, points in self.model.quadratures.items():
            law = points.term.law
            if "elastic_fraction" in law.parameters() and key in self.stresses:
                constants = law.parameters() | law.fields_at(points.joint_x)
                term = next(new for old, new in zip(self.model.terms, terms, strict=True) if old is points.term)
                e = points.values(mandel_vector(term.strain(self.u)))
                spring_work = constants["lmbda"] * e[:, :3].sum(axis=1) ** 2 + 2 * constants["mu"] * (e**2).sum(axis=1)
                spring_work *= constants["elastic_fraction"]
                other_work = abs((self.stresses[key] * e).sum(axis=1) - spring_work)
                work[int(Key.parse(key).kind == BODY_KIND)] += points.weights @ spring_work, points.weights @ other_work
        work = self.model.comm.allreduce(work)
        return float((work[:, 0] / np.maximum(work.sum(axis=1), np.finfo(float).tiny)).max())

    def _terms_at_time(self, terms: list[Term], *, on_s: bool = False) -> list[Term]:
        """Return terms at the time of the state, with the mean strain that was computed under a prescribed mean stress.

        Terms on S, for which `on_s` is true, are without this strain.
        """
        terms = with_strains(terms, TimeLevel(self.t).at_level)
        if on_s or not self.model.stress:
            return terms
        return with_added_strain(terms, three_dimensional(fem.Constant(self.model.domain.mesh, self.mean_strain())))

    def stress(self, term: Term) -> Expr:
        """Return the stress (3, 3), in UFL, of a term of bodies or of a meshed layer. Collective.

        The stress of a compiled law exists only at the quadrature points of the term: integrate it over these, as
        `work` does. For terms on S see `Surface.traction`.
        """
        return next(self._terms_with_stress([term]))[1]

    def work(self, terms: Iterable[Term], v: Expr) -> Expr:
        """Return the virtual work of the stresses of terms in the strains of v, a UFL form. Collective.

        Compiled laws on S are not allowed.
        """
        return sum(ufl.inner(s, p.strain(v)) * p.weight * measure for p, s, measure in self._terms_with_stress(terms))

    def _terms_with_stress(self, terms: Iterable[Term]) -> Iterator[tuple[Term, Expr, ufl.Measure]]:
        """Yield each term with its stress (3, 3), in UFL, and a measure on which this stress can be integrated.

        Raises:
            InputError: a term is that of a compiled law on S.
        """
        for p in terms:
            if not p.law.traits.compiled:
                yield p, stress(p, self.u), p.measure
                continue
            if p.measure.integral_type() != "cell":
                hint = "see Surface.traction" if p.bubble_strain is None else "use order=1, or see Surface.traction"
                raise InputError(f"{type(p.law.law_3d).__name__} on S has no field of stress; {hint}")
            items = self.model.quadratures.items()
            key, points = next((key, quadrature) for key, quadrature in items if quadrature.term.measure is p.measure)
            values = self.stresses.get(key, np.zeros((points.count, len(MANDEL_PAIRS))))
            yield p, mandel_tensor(points.mesh_function(values)), points.measure

    def mean_stress(self) -> Array:
        """Return the mean stress (d, d) of the bodies and of meshed layers. Collective.

        In a periodic cell it is the stress of the cell as a whole, with layers on S included, see `Model.volume`. For a
        scalar field it is the mean flux (d,).
        """
        model, d = self.model, self.model.joint.dim
        is_scalar = model.n_components == 1
        factors = fem.Constant(model.domain.mesh, np.zeros(d if is_scalar else d * (d + 1) // 2))
        unit = scalar_strain(factors) if is_scalar else three_dimensional(from_voigt(factors))
        parts = [(p, model.uniform_strain_in(p, unit)) for p in [*self.bodies, *self.layers]]
        unit_strains = [e for _, e in parts if e is not None]
        stresses = self._terms_with_stress([p for p, e in parts if e is not None])
        works = (ufl.inner(s, e) * p.weight * dx for e, (p, s, dx) in zip(unit_strains, stresses, strict=True))
        values = np.asarray(unit_values(model.comm, sum(works), factors) / model.volume, float)
        return values if is_scalar else values[VOIGT_POSITIONS_OF_DIM[d]]

    def _form_energy(self, terms: Sequence[Term]) -> float:
        """Return the stored energy of those terms whose laws are in UFL forms. Collective.

        It is NaN if one of these laws does not declare its energy.
        """
        form_terms = [p for p in terms if not p.law.traits.compiled]
        if not all(p.law.traits.has_energy for p in form_terms):
            return math.nan
        return self._integrate(energy(form_terms, self.u)) if form_terms else 0.0


def scalar_field_on(state: State, domain: Domain) -> Expr:
    """Return the scalar field of a state as UFL on the mesh of another model. Collective.

    If both models have the same joint, each cell gets the field's values in the same cell, and thus those on its side
    of S. Otherwise it is a function on the mesh of the state, for `Coefficient` to sample.

    Raises:
        InputError: the state is one of displacements, or under a mean gradient; or it has no values in a meshed layer
            of the other model.
    """
    model, joint = state.model, domain.joint
    if not model.kinematics.has_value_in_strain:
        raise InputError(f"{state!r} is a state of a {model.kinematics.unknown}; give one of a temperature")
    if model.strain:
        raise InputError(f"{state!r} has a mean gradient, and its periodic part alone is no temperature or potential")
    if not np.array_equal((joint.band.drawn_joint if joint.band else joint).points, model.joint.points):
        return state.u[0]
    is_taken = domain.original_cells < len(model.joint.cells)
    if joint.band and model.domain.joint.band and np.array_equal(joint.cells, model.domain.joint.cells):
        is_taken[:] = True
    if not state.model.comm.allreduce(int(is_taken.all()), op=MPI.MIN):
        text = "a meshed layer needs values inside it, which this one has not"
        raise InputError(f"{state!r}: {text}; give the state of a full model with the same cells_through")
    family, cell = model.V.ufl_element().basix_element.family, domain.mesh.basix_cell()
    element = basix.ufl.element(family, cell, model.structure.degree, discontinuous=True)
    field = HandedField(fem.functionspace(domain.mesh, element))
    field.x.array[field.function_space.dofmap.list] = node_values(state.u, model, domain.original_cells)[..., 0]
    return field


def node_values(f: fem.Function, model: Model, cells: IntArray) -> Array:
    """Return the values of a function at the nodes of any cells, also of those on other ranks. Collective.

    Args:
        f: the function, with m components, on the model's mesh.
        model: the model.
        cells: (...) numbers of the cells in the joint; the array may have any shape. A cell of a body has the same
            number and order of nodes in all models of a joint.

    Returns:
        Values (..., a, m) at the a nodes of each cell.
    """
    dofmap, n_owned = f.function_space.dofmap, model.domain.mesh.topology.index_map(model.joint.dim).size_local
    nodes, values = dofmap.list[:n_owned], f.x.array.reshape(-1, dofmap.bs)
    by_cell, owned = values[nodes].reshape(n_owned, nodes.shape[1] * dofmap.bs), model.domain.original_cells[:n_owned]
    distinct_cells, positions = np.unique(cells, return_inverse=True)
    cell_data = carry_cell_values(model.comm, owned, lambda k: by_cell[k], distinct_cells)
    return np.asarray(cell_data.reshape(-1, nodes.shape[1], dofmap.bs)[positions.reshape(cells.shape)])


def transfer(f: fem.Function, source: Model, V: fem.FunctionSpace, target: Model) -> fem.Function:
    """Return a function with the values of f on the bodies of another model of the same joint. Collective.

    Values in meshed layers of `target` are zero.

    Args:
        f: the function, on the mesh of `source`.
        source: the model from which values come.
        V: space of the result, on the mesh of `target`.
        target: the model on whose bodies the values are wanted.
    """
    cell_numbers = target.domain.original_cells
    body_cells = np.flatnonzero(cell_numbers < len(source.joint.cells))
    out = fem.Function(V)
    out.x.array.reshape(-1, V.dofmap.bs)[V.dofmap.list[body_cells]] = node_values(f, source, cell_numbers[body_cells])
    out.x.scatter_forward()
    return out


def displacements_of(state: State, model: Model) -> fem.Function:
    """Return the displacements of a state as a function on a model of the same joint and element. Collective."""
    return state.u if state.model is model else transfer(state.u, state.model, model.V, model)
