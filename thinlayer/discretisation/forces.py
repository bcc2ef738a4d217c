"""Tractions and body forces of a model as a linear form."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import dolfinx.fem.petsc
import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from forms.base import InputError, require
from forms.kinematics import Expr
from forms.planes import Kinematics
from geometry.domain import Domain
from geometry.seam import LAYER, S
from geometry.sheet import Sheet
from thinlayer.discretisation.boundary import on_boundary
from thinlayer.discretisation.given import Coordinates, Load, Pressure, by_body
from thinlayer.discretisation.measures import compiled
from thinlayer.discretisation.point_loads import Concentrated, ConcentratedForms
from thinlayer.errors import warn

BodyForce = Load | Mapping[str, Load]

WEIGHT = "body force in the layer {!r}"  # the words for it, by the name of the seam


@dataclass(frozen=True)
class Weighted:
    """Where a load acts: in cells or on facets of bodies, in a layer's volume, or on its side.

    Attributes:
        measure: of the cells or facets; of a layer on S its seam.
        weight: factor of the measure, times the thickness on S.
        value: how a function of place and time is taken there.
        mean: what the load does work in, of displacements; of a layer their mean over the thickness.
        on_base: the part of this mean that is of a rigid base, for motions that move it as well; None: there is no base.
    """

    measure: ufl.Measure
    weight: Expr
    value: Callable[[Expr], Expr] = lambda f: f
    mean: Callable[[Expr], Expr] = lambda v: v
    on_base: Callable[[Expr], Expr] | None = None


class Forces:
    """The loads on a domain.

    Args:
        domain: the domain.
        kinematics: of the mesh; all measures have their factor.
        points: makes forms of loads at points and along lines.
        tractions: facet name -> traction on the outer boundary.
        body_force: force per volume in the bodies, or region name -> force.
        loads: loads at points and along lines.

    Attributes:
        points: the argument.
        at: coordinates for loads that are functions.
        given: description of kind and place -> the load as given.
        loaded: names of the facet sets with tractions.

    Raises:
        InputError: unknown names, a traction on S or inside, loads that are no vectors.
    """

    def __init__(
        self,
        domain: Domain,
        kinematics: Kinematics,
        points: ConcentratedForms,
        tractions: Mapping[str, Load | Pressure] | None = None,
        body_force: BodyForce | None = None,
        loads: Sequence[Concentrated] = (),
    ) -> None:
        self.domain, self.at, self.points, self._kinematics = domain, points.at, points, kinematics
        self.given: dict[str, Any] = {}
        self.loaded: list[str] = []
        self._loads: list[tuple[str, Expr, Weighted, str]] = []  # words, force, its place, the seam if it is a layer's
        self._form: tuple[fem.FunctionSpace, fem.Form] | None = None  # of the work in a space
        ds = ufl.Measure("ds", domain=domain.mesh, subdomain_data=domain.facet_tags)
        dx = ufl.Measure("dx", domain=domain.mesh, subdomain_data=domain.cell_tags)
        require(tractions is None or isinstance(tractions, Mapping), "tractions", tractions, "give {name: traction}")
        tractions = tractions or {}
        for name in sorted(tractions, key=str):  # in the same order on all ranks
            load = tractions[name]
            values = on_boundary(domain, kinematics, name, f"traction on {name!r}", side=True)
            self._add(f"traction on {name!r}", load, ds(values) if values else None)
            self.loaded += [name] if values else []
            self._warn_of_gaps(name)
            side = f"{name.split('/')[0]}/{LAYER}"
            if side not in tractions:
                self._refuse_end(name, side)
            if side not in tractions and (share := self._share(name)):
                what, loaded, *_ = self._loads[-1]
                self.add_weighted("", what, share * loaded, Weighted(ds(domain.values(side)), 1))
        seams = (*(domain.joint.band.base if domain.joint.band else domain.joint).seams, S)
        for name, load in by_body({} if body_force is None else body_force, domain.joint, "", seams).items():
            self._add(f"body force in {name!r}", load, dx(domain.cell_values(name)))
        for one in loads:
            self.given[f"{one.what}, {len(self.given)}"] = one
            for density, measure in points.terms(one):  # whole forces: their measures have no factor
                self.add_weighted("", one.what, density, Weighted(measure, 1))
        self._everywhere = dx

    def add_layer(self, name: str, load: Load, places: Sequence[Weighted], at: Coordinates) -> None:
        """Add a force per volume of a layer.

        Args:
            name: of its seam.
            load: the force.
            places: where the layer is: its weight, and how the work of displacements there is told, see `Weighted`.
            at: coordinates there, with the time of the other loads.
        """
        what = WEIGHT.format(name)
        self.given[what] = load
        force = at.given(load, what, (self.domain.joint.dim,)).expression
        for one in places:
            self.add_weighted(name, what, force, one)

    def add_weighted(self, name: str, what: str, force: Expr, place: Weighted) -> None:
        """Add a force, a UFL vector, at a place: of the layer of a seam, or of the bodies ("")."""
        self._loads.append((what, place.value(force) * place.weight, place, name))

    def _add(self, what: str, load: Load | Pressure, measure: ufl.Measure | None) -> None:
        self.given[what] = load
        if isinstance(load, Pressure) and what.startswith("body force"):
            raise InputError(f"{what} is {load!r}: there is no normal inside a body; give a vector")
        checked = self.at.traction(load, what, ufl.FacetNormal(self.domain.mesh))
        if measure is not None:
            self.add_weighted("", what, checked, Weighted(measure, self._kinematics.factor))

    def _warn_of_gaps(self, name: str) -> None:
        """Warn where a gap ends that bodies gave up a part of their loaded faces to."""
        band, whole = self.domain.joint.band, name.split("/")[0]
        if band is None or band.bodies == "kept" or whole not in band.base.facets:
            return
        for seam in band.eps.keys() - band.of_seam.keys():
            if Sheet(band.base, seam).rim.on(band.base.facets[whole]).any():
                warn(
                    "end of a gap",
                    f"traction on {name!r}: the gap {seam!r} ends there, and bodies gave up a part of their faces to it; "
                    "the load is smaller than the interface model's. Use bodies='kept'",
                    self.domain.comm,
                )

    def _refuse_end(self, name: str, side: str) -> None:
        """Raise InputError if bodies gave up a part of a loaded face to the side of a layer without cells."""
        joint, whole = self.domain.joint, name.split("/")[0]
        if joint.parted is not None and whole in joint.facets and Sheet(joint).rim.on(joint.facets[whole]).any():
            raise InputError(
                f"traction on {name!r}: S ends there, and bodies='extended' gave a part of this face to the side of the "
                f"layer, which has no facets to carry it; give {side!r} a traction of its own, zero if that side is free"
            )

    def _share(self, name: str) -> float:
        """Share of a traction on bodies that also acts on the layer's side: the room that these bodies gave up.

        It is 0 for kept bodies. With it the full and the interface model have the same total load.
        """
        band = self.domain.joint.band
        whole, _, region = name.partition("/")
        if band is None or band.bodies == "kept" or region == LAYER:
            return 0.0
        if f"{whole}/{LAYER}" not in self.domain.facet_values:
            return 0.0
        joint = band.base
        facets = joint.facets[whole]
        cells = joint.table.cells[joint.table.index(facets), 0]
        loaded = joint.region[cells] == joint.regions.index(region) if region else np.ones(len(cells), bool)
        rim = Sheet(joint).rim
        ends = rim[rim.on(facets)]
        splitting = joint.splitting
        around = splitting.copies[1][cells]
        beside = [splitting.copies[1][side] for side in joint.surface_cells.T if (side >= 0).all()]
        covered = [ends.on(facets[loaded & np.isin(around, nodes).any(axis=1)]) for nodes in beside]
        if any(some.any() and not some.all() for some in covered):
            warn(
                "other bodies",
                f"traction on {name!r}: other bodies than {region!r} end at the layer's side too, which carries no part of "
                f"it; the load is smaller than the interface model's. Load {whole!r}, or {whole + '/' + LAYER!r} as well",
                self.domain.comm,
            )
        return sum(bool(some.all()) for some in covered) / len(covered)

    def work(self, v: Expr, *, layers: bool = False) -> Expr:
        """Virtual work of the loads, or of those on layers alone, a UFL form linear in v that reads the clock."""
        form = ufl.inner(fem.Constant(self.domain.mesh, np.zeros(self.domain.joint.dim)), v) * self._everywhere
        loads = [one for one in self._loads if one[3] or not layers]
        return sum((ufl.inner(load, one.mean(v)) * one.measure for _, load, one, _ in loads), form)

    def work_on_bases(self, v: Expr) -> dict[str, Expr]:
        """Virtual work of what goes to rigid bases by itself, in motions v that move them, by seam; see `work`."""
        works: dict[str, Expr] = {}
        for _, load, one, name in self._loads:
            if one.on_base:
                works[name] = works.get(name, ufl.Form([])) + ufl.inner(load, one.on_base(v)) * one.measure
        return works

    def nodal_at(self, V: fem.FunctionSpace, t: float, *, layers: bool = False) -> PETSc.Vec:
        """Nodal forces of the loads, or of those on layers alone, in a space; the caller destroys the vector. Collective.

        Raises:
            InputError: loads that are not finite.
        """
        if self._form is None or self._form[0] is not V:
            self._form = V, compiled(self.work(ufl.TestFunction(V)))
        form = compiled(self.work(ufl.TestFunction(V), layers=True)) if layers else self._form[1]
        with self.at.clock.at(t):
            b = dolfinx.fem.petsc.assemble_vector(form)
        b.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
        if not np.isfinite(b.norm()):
            raise InputError(": ".join([f"the loads are not finite at t = {t:g}", *self._not_finite(t)]))
        return b

    def _not_finite(self, t: float) -> list[str]:
        """The loads that are not finite at a time. Collective."""
        names = []
        for what, load, one, _ in self._loads:
            form = fem.form(ufl.inner(load, load) * one.measure)
            with self.at.clock.at(t):
                total = fem.assemble_scalar(form)
            if self.domain.comm.allreduce(int(not np.isfinite(total))):
                names.append(what)
        return names
