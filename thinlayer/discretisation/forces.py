"""Loads of a model as linear forms: tractions, body forces, and forces at points and along lines."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import dolfinx.fem.petsc
import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from forms.base import InputError, require
from forms.kinematics import Kinematics
from forms.tensors import Expr
from geometry.domain import Domain
from geometry.joint import Joint
from geometry.seam import LAYER, FacetName, S
from geometry.sheet import Sheet
from thinlayer.discretisation.boundary import boundary_tags
from thinlayer.discretisation.coefficient import Coordinates, LoadInput, Pressure, values_by_body
from thinlayer.discretisation.form_compilation import compiled
from thinlayer.discretisation.point_loads import concentrated_density
from thinlayer.errors import warn

if TYPE_CHECKING:
    from thinlayer.discretisation.structure import Structure

BodyForce = LoadInput | Mapping[str, LoadInput]


@dataclass(frozen=True)
class LoadRegion:
    """Region where a load acts: cells or facets of bodies, the volume of a layer, or a layer's side.

    Attributes:
        measure: measure of the cells or facets; for a layer without cells, that of its seam.
        weight: factor of the measure: 2 pi r in axisymmetry, else 1; for a layer without cells times its thickness.
        value_in_region: function from the UFL expression of the load to that of its value there. For a layer without
            cells it is the value on one side of S.
        work_argument: function from a displacement, in UFL, to that with which the load does work. For a layer
            without cells this is the mean over the thickness.
        by_part: name of the facet set on which a part, such as a film, exerts the load as its reaction; "": it is applied.
        base_argument: function from a displacement of the bodies, in UFL, to what the rigid base adds to this mean if
            it moves with them. None: there is no rigid base.
        jump: for a layer without cells, function from a displacement, in UFL, to its jump; None: other regions.
        bubble_factor: value with which the amplitude of the bubble at order 2 does work, over the mean through the layer.
    """

    measure: ufl.Measure
    weight: Expr
    value_in_region: Callable[[Expr], Expr] = field(default_factory=lambda: _unchanged)
    work_argument: Callable[[Expr], Expr] = field(default_factory=lambda: _unchanged)
    base_argument: Callable[[Expr], Expr] | None = None
    by_part: str = ""
    jump: Callable[[Expr], Expr] | None = None
    bubble_factor: float = 1.0


def _unchanged(f: Expr) -> Expr:
    return f


class Forces:
    """All loads of a model, with their virtual work as UFL forms and their nodal forces.

    Args:
        domain: the distributed mesh, with the joint's names.
        kinematics: kinematics of the mesh, with the factor of all measures (2 pi r in axisymmetry).
        joint: the joint as drawn, before S is opened to the layer's thickness.
        at: coordinates and time.
        structure: the structure, which has the tractions, body forces, and loads at points and along lines.

    Attributes:
        at: place and time for loads that are functions.
        user_loads: label, such as "traction on 'TOP'" -> the load as the user wrote it.

    Raises:
        InputError: an unknown name, a traction on S or inside the bodies, a load that is not a vector.
    """

    def __init__(
        self, domain: Domain, kinematics: Kinematics, joint: Joint, at: Coordinates, structure: Structure
    ) -> None:
        self.domain, self.at, self._kinematics = domain, at, kinematics
        self._n_components, names = len(kinematics.components(domain.joint.dim)), kinematics.quantities
        self.user_loads: dict[str, object] = {}
        # label, force, region, name of the seam if it is a layer's load
        self._loads: list[tuple[str, Expr, LoadRegion, str]] = []
        self._cached_work: tuple[fem.FunctionSpace, fem.Form] | None = None  # a space, and the work in it
        ds = ufl.Measure("ds", domain=domain.mesh, subdomain_data=domain.facet_tags)
        dx = ufl.Measure("dx", domain=domain.mesh, subdomain_data=domain.cell_tags)
        tractions = {} if structure.tractions is None else structure.tractions
        body_force = {} if structure.body_force is None else structure.body_force
        arguments = names.load_arguments
        require(isinstance(tractions, Mapping), arguments[0], tractions, f"give {{name: {names.traction}}}")
        for name in sorted(tractions, key=str):  # in the same order on all ranks
            load = tractions[name]
            tags = boundary_tags(domain, kinematics, name, f"{names.traction} on {name!r}", layer_side=True)
            self._add_boundary_load(f"{names.traction} on {name!r}", load, ds(tags) if tags else None)
            self._warn_of_gaps(name)
            layer_side = str(FacetName(FacetName.parse(name).set_name, LAYER))
            if layer_side not in tractions and (side_share := self._layer_side_fraction(name)):
                label, traction, *_ = self._loads[-1]
                self.add_weighted_load("", label, side_share * traction, LoadRegion(ds(domain.values(layer_side)), 1))
        seams = (*(domain.joint.band.drawn_joint if domain.joint.band else domain.joint).seams, S)
        body_loads: dict[str, LoadInput] = values_by_body(body_force, domain.joint, arguments[1], seams)
        for name, load in body_loads.items():
            label = f"{names.body_force} in {name!r}"
            require(not isinstance(load, Pressure), label, load, "there is no normal inside a body; give a vector")
            self._add_boundary_load(label, load, dx(domain.region_tags(name)))
        for concentrated_load in structure.loads:
            self.user_loads[f"{concentrated_load.what}, {len(self.user_loads)}"] = concentrated_load
            density, measure = concentrated_density(concentrated_load, domain, joint, at)
            # total forces: without the factor of measures
            self.add_weighted_load("", concentrated_load.what, density, LoadRegion(measure, 1))
        for part in structure.parts:
            for name, load in part.surface_loads().items():
                label, tags = f"{part.key}: surroundings", boundary_tags(domain, kinematics, name, part.key)
                force = self.at.load(load, label, self._n_components)
                self.add_weighted_load("", label, force, LoadRegion(ds(tags), kinematics.factor, by_part=name))
        self._whole_dx = dx

    def add_layer_load(self, name: str, load: LoadInput, region: LoadRegion, at: Coordinates) -> None:
        """Add a force per volume of a layer to the loads.

        Args:
            name: name of the layer's seam.
            load: the force per volume, (d,) in d dimensions, constant or a function (x, t).
            region: region of the layer.
            at: coordinates in the layer, with the time of the other loads.
        """
        label = f"{self._kinematics.quantities.body_force} in the layer {name!r}"
        self.user_loads[label] = load
        self.add_weighted_load(name, label, at.load(load, label, self._n_components), region)

    def add_weighted_load(self, name: str, what: str, force: Expr, region: LoadRegion) -> None:
        """Add a force per volume or area in a region to the loads.

        Args:
            name: name of the seam of a layer's load; "" for loads on bodies.
            what: label of the load in error messages.
            force: the force, a UFL vector (d,) in d dimensions.
            region: the region, whose weight multiplies the force.
        """
        self._loads.append((what, region.value_in_region(force) * region.weight, region, name))

    def _add_boundary_load(self, what: str, load: LoadInput | Pressure, measure: ufl.Measure | None) -> None:
        self.user_loads[what] = load
        force = self.at.load(load, what, self._n_components, ufl.FacetNormal(self.domain.mesh))
        if measure is not None:
            self.add_weighted_load("", what, force, LoadRegion(measure, self._kinematics.factor))

    def _warn_of_gaps(self, name: str) -> None:
        """Warn if an open seam with a width (a gap) ends on the loaded facet set `name` between extended bodies.

        The bodies gave up a part of their faces to the gap, so that the total load is smaller than in the interface
        model.
        """
        band, facet_set = self.domain.joint.band, FacetName.parse(name).set_name
        if band is None or band.bodies == "kept" or facet_set not in band.drawn_joint.facets:
            return
        for seam in band.eps.keys() - band.regions_of_seam.keys():
            if Sheet(band.drawn_joint, seam).rim.lies_on(band.drawn_joint.facets[facet_set]).any():
                effect = "bodies gave up a part of their faces to it; the load is smaller than the interface model's"
                text = f"traction on {name!r}: the gap {seam!r} ends there, and {effect}. Use bodies='kept'"
                warn("end of a gap", text, self.domain.comm)

    def _layer_side_fraction(self, name: str) -> float:
        """Return the fraction of a traction on bodies that also acts on the layer's side beside them.

        Extended bodies gave up a part of their faces to the layer's side. With this fraction the full and the interface
        model have the same total load. It is 0 for bodies that keep their shape.

        Args:
            name: facet set of the traction.

        Raises:
            InputError: the layer has no cells, so its side has no facets.
        """
        band, parted = self.domain.joint.band, self.domain.joint.parted is not None
        part = FacetName.parse(name)
        facets, layer_side = self.domain.joint.facets.get(part.set_name), str(FacetName(part.set_name, LAYER))
        if parted and facets is not None and Sheet(self.domain.joint).rim.lies_on(facets).any():
            reason = "S ends there, and bodies='extended' gave a part of this face to the layer's side"
            traction = self._kinematics.quantities.traction
            remedy = f"give '{layer_side}', which has no facets, a {traction}, zero if that side is free"
            raise InputError(f"{traction} on {name!r}: {reason}; {remedy}")
        if band is None or band.bodies == "kept" or part.part_name == LAYER or layer_side not in self.domain.set_tags:
            return 0.0
        joint, sheet = band.drawn_joint, Sheet(band.drawn_joint)
        ends = sheet.rim[sheet.rim.lies_on(joint.facets[part.set_name])]
        side_cells = [side for side in joint.surface_cells[ends.facet].T if (side >= 0).all()]
        loaded_regions = [joint.regions.index(body) for body in ([part.part_name] if part.part_name else joint.bodies)]
        loaded_masks = [np.isin(joint.region[side], loaded_regions) for side in side_cells]
        if any(mask.any() and not mask.all() for mask in loaded_masks):
            effect = "which carries no part of it; the load is smaller than the interface model's"
            text = f"traction on {name!r}: other bodies than {part.part_name!r} end at the layer's side too, {effect}"
            warn("other bodies", f"{text}. Load {part.set_name!r}, or '{layer_side}' as well", self.domain.comm)
        return sum(bool(mask.all()) for mask in loaded_masks) / len(loaded_masks)

    def work(
        self, v: Expr, *, layers_only: bool = False, bodies_only: bool = False, applied_only: bool = False
    ) -> Expr:
        """Return the virtual work of the loads in displacements v, a UFL form linear in v.

        It takes its time from the model's clock. With `layers_only` it has only the loads on layers, with `bodies_only`
        those on bodies, with `applied_only` those that are no reactions of parts.
        """
        form = ufl.inner(fem.Constant(self.domain.mesh, np.zeros(self._n_components)), v) * self._whole_dx
        loads = [entry for entry in self._loads if not (bodies_only if entry[3] else layers_only)]
        loads = [entry for entry in loads if not (applied_only and entry[2].by_part)]
        return sum((ufl.inner(load, region.work_argument(v)) * region.measure for _, load, region, _ in loads), form)

    def work_of_parts(self, v: Expr) -> dict[str, Expr]:
        """Return, by facet set, the virtual work of the loads that are reactions of parts, UFL forms linear in v."""
        loads = [(load, region) for _, load, region, _ in self._loads if region.by_part]
        return {region.by_part: ufl.inner(load, v) * region.measure for load, region in loads}

    def work_on_bases(self, v: Expr) -> dict[str, Expr]:
        """Return, for each rigid base, the virtual work of the loads that act directly on the base.

        A rigid base is a rigid body below a seam, in place of a body of the mesh. Half of the load of a layer on it
        acts directly on the base.

        Args:
            v: displacement of the bodies, in UFL. The base below each facet of S moves and rotates as the facet does.

        Returns:
            A dictionary from the name of the base's seam to a UFL form, linear in v. It takes its time from the model's
            clock.
        """
        forms: dict[str, Expr] = {}
        for _, load, region, name in self._loads:
            if region.base_argument:
                forms[name] = forms.get(name, ufl.Form([])) + ufl.inner(load, region.base_argument(v)) * region.measure
        return forms

    def work_on_bubble(self, name: str, b: Expr) -> Expr:
        """Return the virtual work of a layer's loads in the bubble amplitude `b` of order 2, a UFL form linear in b."""
        loads = [(load, region) for _, load, region, seam in self._loads if seam == name and region.bubble_factor]
        terms = (ufl.inner(load, r.bubble_factor * r.value_in_region(b)) * r.measure for load, r in loads)
        return sum(terms, ufl.Form([]))

    def nodal_forces_at(self, V: fem.FunctionSpace, t: float, *, layers: bool = False) -> PETSc.Vec:
        """Return the nodal forces in V of the loads at the time t; the caller destroys the vector. Collective.

        With `layers` they are those of loads on layers only.

        Raises:
            InputError: a load is not finite at this time.
        """
        if self._cached_work is None or self._cached_work[0] is not V:
            self._cached_work = V, compiled(self.work(ufl.TestFunction(V)))
        form = compiled(self.work(ufl.TestFunction(V), layers_only=True)) if layers else self._cached_work[1]
        with self.at.clock.at(t):
            b = dolfinx.fem.petsc.assemble_vector(form)
        b.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
        if not np.isfinite(b.norm()):
            raise InputError(": ".join([f"the loads are not finite at t = {t:g}", *self._names_of_nonfinite(t)]))
        return b

    def _names_of_nonfinite(self, t: float) -> list[str]:
        """Return the labels of the loads that are not finite at the time `t`. Collective."""
        with self.at.clock.at(t):
            sums = [fem.assemble_scalar(compiled(ufl.inner(f, f) * region.measure)) for _, f, region, _ in self._loads]
        n_nonfinite = self.domain.comm.allreduce(1 - np.isfinite(sums))
        return [what for (what, *_), count in zip(self._loads, n_nonfinite, strict=True) if count]
