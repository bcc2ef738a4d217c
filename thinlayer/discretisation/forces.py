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

from forms.kinematics import Expr
from forms.planes import LIFTED, Kinematics
from geometry.domain import Domain
from geometry.errors import unknown
from geometry.seam import LAYER, S
from geometry.sheet import Sheet
from thinlayer.discretisation.axis import refuse_axis, refuse_periodic, refuse_seam
from thinlayer.discretisation.given import Coordinates, Load, Pressure
from thinlayer.discretisation.measures import compiled
from thinlayer.discretisation.point_forms import ConcentratedForms
from thinlayer.discretisation.point_loads import Concentrated
from thinlayer.errors import ModelError, warn

BodyForce = Load | Mapping[str, Load]

WEIGHT = "body force in the layer {!r}"  # the words for it, by the name of the seam


@dataclass(frozen=True)
class Weighted:
    """A place of a layer's volume, or of its side.

    Attributes:
        measure: of its cells, or of its seam.
        weight: factor of the measure, times the thickness on S.
        value: how a function of place and time is taken there.
        mean: mean over the thickness of displacements there; of a side what its load does work in.
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
        tractions: facet name -> traction on the outer boundary.
        body_force: force per volume in the bodies, or region name -> force.
        at: coordinates for loads that are functions.
        loads: loads at points and along lines.
        forms: makes the forms of these.
        kinematics: of the mesh; all measures have their factor.

    Attributes:
        given: description of kind and place -> the load as given.
        loaded: names of the facet sets with tractions.

    Raises:
        GeometryError, ModelError: unknown names, a traction on S or inside, loads that are no vectors.
    """

    def __init__(
        self,
        domain: Domain,
        tractions: Mapping[str, Load | Pressure] | None,
        body_force: BodyForce | None,
        at: Coordinates,
        loads: Sequence[Concentrated] = (),
        forms: Callable[[], ConcentratedForms] | None = None,
        kinematics: Kinematics = LIFTED,
    ) -> None:
        self.domain, self.at, self._kinematics = domain, at, kinematics
        self.given: dict[str, Any] = {}
        self.loaded: list[str] = []
        self._loads: list[tuple[str, Expr, ufl.Measure]] = []
        self._in_layers: list[tuple[str, Expr, Weighted]] = []
        self._seams: list[str] = []
        self._form: tuple[fem.FunctionSpace, fem.Form] | None = None  # of the work in a space
        self._concentrated: list[tuple[str, Expr, ufl.Measure]] = []  # whole forces: their measures have no factor
        ds = ufl.Measure("ds", domain=domain.mesh, subdomain_data=domain.facet_tags)
        dx = ufl.Measure("dx", domain=domain.mesh, subdomain_data=domain.cell_tags)
        if tractions is not None and not isinstance(tractions, Mapping):
            raise ModelError(f"tractions is {tractions!r}; it must be {{facet name: traction}}")
        tractions = tractions or {}
        for name in sorted(tractions, key=str):  # in the same order on all ranks
            load = tractions[name]
            values = self._outer(name)
            self._add(f"traction on {name!r}", load, ds(values) if values else None)
            self.loaded += [name] if values else []
            self._warn_of_gaps(name)
            side = f"{name.split('/')[0]}/{LAYER}"
            if side not in tractions:
                self._refuse_end(name, side)
            if side not in tractions and (share := self._share(name)):
                what, loaded, _ = self._loads[-1]
                self._loads.append((what, share * loaded, ds(domain.values(side))))
        for name, load in self._by_region(body_force).items():
            self._add(f"body force in {name!r}", load, dx(domain.cell_values(name)))
        for one in loads:
            self.given[f"{one.what}, {len(self.given)}"] = one
            assert forms is not None
            self._concentrated += [(one.what, density, measure) for density, measure in forms().terms(one)]
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

    def weighs(self, name: str) -> bool:
        """Whether a body force acts in the layer of a seam."""
        return WEIGHT.format(name) in self.given

    def add_weighted(self, name: str, what: str, force: Expr, place: Weighted) -> None:
        """Add a force, a UFL vector, at a place of the layer of a seam."""
        self._in_layers.append((what, place.value(force) * place.weight, place))
        self._seams.append(name)

    def _add(self, what: str, load: Load | Pressure, measure: ufl.Measure | None) -> None:
        self.given[what] = load
        if isinstance(load, Pressure) and what.startswith("body force"):
            raise ModelError(f"{what} is {load!r}: there is no normal inside a body; give a vector")
        checked = self.at.traction(load, what, ufl.FacetNormal(self.domain.mesh))
        if measure is not None:
            self._loads.append((what, checked, measure))

    def _outer(self, name: str) -> tuple[int, ...]:
        """Facet values of a traction's place; () for the side of a layer that is not meshed."""
        if not isinstance(name, str):
            raise ModelError(
                f"traction on {name!r}: tractions act on facet sets, given by their name; known: "
                + ", ".join(sorted(self.domain.joint.facets.keys() - {S}))
            )
        what = S if name.split("/")[0] == S else repr(name)
        refuse_seam(self.domain.joint, name, f"a traction on {what} is what the model computes; load another facet set")
        values = self.domain.values(name)
        refuse_periodic(self.domain.joint, name, "traction")
        refuse_axis(self._kinematics, self.domain.joint, name, "a traction")
        if not self.domain.is_outer(name):
            raise ModelError(f"traction on {name!r}: its facets lie inside; tractions act on the outer boundary")
        if not values and not name.endswith(f"/{LAYER}"):
            raise ModelError(f"traction on {name!r}: this facet set is empty")
        return values

    def _warn_of_gaps(self, name: str) -> None:
        """Warn where a gap ends that bodies gave up a part of their loaded faces to."""
        band, whole = self.domain.joint.band, name.split("/")[0]
        if band is None or band.bodies == "kept" or whole not in band.base.facets:
            return
        for seam in band.eps.keys() - band.of_seam.keys():
            if Sheet(band.base, seam).rim.on(band.base.facets[whole]).any():
                warn(
                    f"traction on {name!r}: the gap {seam!r} ends there, and bodies gave up a part of their faces to it; "
                    "the load is smaller than the interface model's. Use bodies='kept'",
                    self.domain.comm,
                )

    def _refuse_end(self, name: str, side: str) -> None:
        """Raise ModelError if bodies gave up a part of a loaded face to the side of a layer without cells."""
        joint, whole = self.domain.joint, name.split("/")[0]
        if joint.parted is not None and whole in joint.facets and Sheet(joint).rim.on(joint.facets[whole]).any():
            raise ModelError(
                f"traction on {name!r}: S ends there, and bodies='extended' gave a part of this face to the side of the "
                f"layer, which has no facets to carry it; give {side!r} a traction of its own, zero if that side is free"
            )

    def _share(self, name: str) -> float:
        """Share of a traction on bodies that also acts on the layer's side: the room that these bodies gave up.

        It is 0 for kept bodies. With it the full and the interface model have the same total load.
        """
        band = self.domain.joint.band
        whole, _, region = name.partition("/")
        if (
            band is None
            or band.bodies == "kept"
            or region == LAYER
            or f"{whole}/{LAYER}" not in self.domain.facet_values
        ):
            return 0.0
        joint = band.base
        facets = joint.facets[whole]
        cells = joint.table.cells[joint.table.index(facets), 0]
        loaded = joint.region[cells] == joint.regions.index(region) if region else np.ones(len(cells), bool)
        rim = Sheet(joint).rim
        ends = rim[rim.on(facets)]
        splitting = joint.splitting
        around = splitting.copies[1][cells]
        sides = [
            np.isin(around, splitting.copies[1][beside]).any(axis=1)
            for beside in joint.surface_cells.T
            if (beside >= 0).all()
        ]
        covered = [ends.on(facets[loaded & side]) for side in sides]
        if any(some.any() and not some.all() for some in covered):
            warn(
                f"traction on {name!r}: other bodies than {region!r} end at the layer's side too, which carries no part of "
                f"it; the load is smaller than the interface model's. Load {whole!r}, or {whole + '/' + LAYER!r} as well",
                self.domain.comm,
            )
        return sum(bool(some.all()) for some in covered) / len(sides)

    def _by_region(self, body_force: BodyForce | None) -> dict[str, Load]:
        joint = self.domain.joint
        regions, seams = joint.bodies, [*(joint.band.base if joint.band else joint).seams, S]
        if body_force is None:
            return {}
        forces = dict(body_force) if isinstance(body_force, Mapping) else dict.fromkeys(regions, body_force)
        for name in forces:
            if name not in regions and name not in seams:
                raise ModelError(unknown("body", name, regions))
        return {name: forces[name] for name in regions if name in forces}

    def work(self, v: Expr) -> Expr:
        """Virtual work of the loads, a UFL form linear in v that reads the clock."""
        form = ufl.inner(fem.Constant(self.domain.mesh, np.zeros(self.domain.joint.dim)), v) * self._everywhere
        for _, load, measure in self._loads:
            form += ufl.inner(load, v) * self._kinematics.factor * measure
        for _, load, measure in self._concentrated:
            form += ufl.inner(load, v) * measure
        for _, load, one in self._in_layers:
            form += ufl.inner(load, one.mean(v)) * one.measure
        return form

    def work_on_bases(self, v: Expr) -> dict[str, Expr]:
        """Virtual work of what goes to rigid bases by itself, in motions v that move them, by seam; see `work`."""
        works: dict[str, Expr] = {}
        for name, (_, load, one) in zip(self._seams, self._in_layers, strict=True):
            if one.on_base:
                work = ufl.inner(load, one.on_base(v)) * one.measure
                works[name] = works[name] + work if name in works else work
        return works

    def nodal_at(self, V: fem.FunctionSpace, t: float) -> PETSc.Vec:
        """Nodal forces of the loads at a time, in a space; the caller destroys the vector. Collective.

        Raises:
            ModelError: loads that are not finite.
        """
        if self._form is None or self._form[0] is not V:
            self._form = V, compiled(self.work(ufl.TestFunction(V)))
        with self.at.clock.at(t):
            b = dolfinx.fem.petsc.assemble_vector(self._form[1])
        b.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
        if not np.isfinite(b.norm()):
            raise ModelError(": ".join([f"the loads are not finite at t = {t:g}", *self._not_finite(t)]))
        return b

    def _not_finite(self, t: float) -> list[str]:
        """The loads that are not finite at a time. Collective."""
        names = []
        for what, load, measure in [
            *self._loads,
            *self._concentrated,
            *((what, load, one.measure) for what, load, one in self._in_layers),
        ]:
            form = fem.form(ufl.inner(load, load) * measure)
            with self.at.clock.at(t):
                total = fem.assemble_scalar(form)
            if self.domain.comm.allreduce(int(not np.isfinite(total))):
                names.append(what)
        return names
