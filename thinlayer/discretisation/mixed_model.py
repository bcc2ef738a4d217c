"""Mixed models: layers meshed on a part of S, replaced by their interface laws on the rest."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Self

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from scipy.spatial import cKDTree

from forms import work as forms
from forms.base import Array, InputError
from forms.interface import Interface
from geometry.domain import Domain
from geometry.parallel import world
from geometry.refusals import place
from geometry.seam import BASE, CUT, LAYER, LOWER_FACE, UPPER_FACE, S
from geometry.topology import BoolArray, IntArray
from thinlayer.discretisation.constraints import Followers
from thinlayer.discretisation.full_model import FullModel
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import Layers, SeamLayer, layers_of, on_seams, seam_entities
from thinlayer.discretisation.mesh_functions import cellwise, shift
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.reduction import Reduction
from thinlayer.discretisation.setup import Setup
from thinlayer.errors import warn
from thinlayer.system.compat import exterior_facet_entities
from thinlayer.system.identity import described
from thinlayer.system.ranks import on_all

SAME_PLACE = 1e-9  # distance before inflating, relative to the size of the joint, of nodes above one another
Where = BoolArray | Callable[[Array], Any]
UPRIGHT = 1e-4  # shift of bodies along S, over that across it, that counts as none: S is planar to 1e-5
REACH = 3.0  # largest width, over the thickness, of the strips on which a law has the constants of a free end


def at_cuts(domain: Domain, V: fem.FunctionSpace, layers: Mapping[str, SeamLayer]) -> Followers | None:
    """The nodes between both faces of a layer where its cells end and it goes on; None: it does nowhere.

    They move as the interface law of order 1 has it, by <u> + Phi [u] (`AtRest.through`).

    Args:
        domain: the mesh.
        V: displacements, of nodes.
        layers: name of a seam -> its layer.

    Raises:
        InputError: a node of a cut that is above none of the faces. Collective.
    """
    if CUT not in domain.joint.facets:
        return None
    d, first = domain.joint.dim, V.dofmap.index_map.local_range[0]
    x, moved = V.tabulate_dof_coordinates()[:, :d], fem.Function(V)
    moved.interpolate(shift(domain))
    before = x - moved.x.array.reshape(x.shape)
    at_cut = _owned(domain, V, CUT)
    known = domain.joint.facets
    faces = [
        [_owned(domain, V, next(n for n in (f"{name}/{face}", face, BASE) if n in known)) for name in layers]
        for face in (LOWER_FACE, UPPER_FACE)
    ]
    rows = np.setdiff1d(at_cut, np.concatenate([nodes for face in faces for nodes in face]))
    ends, size = [], domain.joint.size
    for face in faces:
        each = [np.intersect1d(at_cut, nodes) for nodes in face]
        own, seam = np.concatenate(each), np.arange(len(each)).repeat([*map(len, each)])
        table = np.column_stack([before[own], x[own], own + first, seam])
        everywhere = np.concatenate(domain.comm.allgather(table))
        distance, at = cKDTree(everywhere[:, :d]).query(before[rows])
        with on_all(domain.comm):
            if (distance > SAME_PLACE * size).any():
                raise InputError(f"a node at a cut has no face above or below it, {place(x[rows][distance.argmax()])}")
        ends.append(everywhere[at, d:])
    apart, nodes = ends[1][:, :d] - ends[0][:, :d], [end[:, d].astype(np.int64) for end in ends]
    across = np.linalg.norm(apart, axis=1)
    share = np.linalg.norm(x[rows] - ends[0][:, :d], axis=1) / across
    n, upper = apart / across[:, None], np.zeros((len(rows), d, d))  # part of the upper face's displacements
    for number, one in enumerate(layers.values()):
        here = ends[0][:, -1] == number
        normal, tangential = (0.5 + phi[:, None, None] for phi in one.at_rest.through(share[here] - 0.5))
        upper[here] = tangential * np.eye(d) + (normal - tangential) * n[here][:, :, None] * n[here][:, None]
    every = np.arange(d)
    of = np.concatenate([(one[:, None] * d + every) for one in nodes], axis=1).repeat(d, axis=0)
    shares = np.concatenate([np.eye(d) - upper, upper], axis=2).reshape(-1, 2 * d)
    return Followers((rows[:, None] * d + every).ravel(), of, shares)


def _owned(domain: Domain, V: fem.FunctionSpace, name: str) -> IntArray:
    """Nodes of this rank on the facets of a name, by their local numbers. Collective."""
    found = fem.locate_dofs_topological(V, V.mesh.topology.dim - 1, domain.facets(name))
    return np.unique(found[found < V.dofmap.index_map.size_local]).astype(np.int64)


class MixedModel(FullModel):
    """The model whose layers are meshed on a part of S, and replaced by their interface laws on the rest.

    The bodies stand where those of the full model do. Where there are no cells laws act between the sides of a gap: their
    nodal forces are those of an interface model with the same bodies. Where cells end their nodes between both faces move
    as the law of order 1 has it.

    Attributes:
        by_law: the interface model of the same layers; of order 0 where seams meet.
    """

    name = "mixed"
    meshed: BoolArray

    def __init__(self, structure: Setup, layer: Layers, where: Where, *, bodies: str, cells_through: int) -> None:
        with on_all(structure.comm):
            self.meshed = _facets(structure, where)
            _require(structure, layer, self.meshed, bodies)
        self._bodies, self._cells_through, self._junctions = bodies, cells_through, None
        self.by_law = InterfaceModel(structure, _on_all_of_s(structure, layer), bodies=bodies, meshed=self.meshed)
        options = {"bodies": bodies, "cells_through": cells_through, "meshed": described(self.meshed)}
        super(FullModel, self).__init__(structure, layer, **options)
        self._follow()

    def _data(self) -> dict[str, Any]:
        return super()._data() | {"meshed": described(self.meshed)}

    def with_layer(self, layer: Layers) -> Self:
        """As in other models. Collective."""
        with on_all(self.comm):
            _require(self.structure, layer, self.meshed, self._bodies)
        new = super().with_layer(layer)
        new.by_law = self.by_law.with_layer(_on_all_of_s(self.structure, layer))
        new._follow()
        return new

    def _follow(self) -> None:
        """Let nodes at cuts follow both faces. Collective."""
        self.followers = at_cuts(self.domain, self.V, self.layers)
        self.constraints = self._constrained()

    def law_elsewhere(self) -> tuple[Model, list[forms.Term]] | None:
        """The terms of the interface laws on the facets without cells, and the interface model. Collective."""
        model = self.by_law
        if self.meshed.all():
            return None
        terms = []
        for name, one in model.layers.items():
            measure, of_order = self._without_cells(name), model.terms_of(self.layers[name], self._sides(one))
            terms += [replace(p, measure=measure(1, metadata=p.measure.metadata())) for p in of_order]
        return model, terms

    def _sides(self, one: SeamLayer) -> Interface:
        """The sides of a seam in the interface model, with the fibres of its layer.

        Bodies that are kept may also shift along S as they make room for several layers, so that fibres are oblique.
        """
        model, joint = self.by_law, self.joint
        sides = model.sides_of(one.name)
        if model.domain.joint.parted is not None or one.name in joint.base_seams:  # these know their fibres; upright
            return sides
        inflated, count = self.domain.joint, len(joint.cells)
        moved = (inflated.points - inflated.reference)[inflated.cells[:count]].mean(axis=1)
        lower, upper = joint.surface_cells[one.sheet.facets].T
        n = joint.interface_normals[one.sheet.facets]
        apart = moved[upper] - moved[lower]
        along = apart - (apart * n).sum(axis=1, keepdims=True) * n
        if np.abs(along).max() <= UPRIGHT * np.abs(apart).max():
            return sides
        by_cell = cellwise(model.domain, ("DG", 0, (joint.dim,)), moved[:, None])
        way = by_cell("+") - by_cell("-")
        return replace(sides, fibre=way / ufl.dot(way, sides.n))

    def _without_cells(self, name: str) -> ufl.Measure:
        """The measure of the interface model over the facets of a seam without cells; its part 1. Collective."""
        domain, joint = self.by_law.domain, self.joint
        mesh, below = domain.mesh, joint.surface_cells[:, 0]
        count = len(joint.cells)
        pairs = joint.surface_cells[~self.meshed] @ [1, count]
        if name in joint.base_seams:
            facets = np.sort(domain.facets(name))
            facets = facets[facets < mesh.topology.index_map(joint.dim - 1).size_local]
            found = exterior_facet_entities(mesh, facets)
            based = joint.surface_cells[~self.meshed & (below < 0), 1]
            chosen = found[np.isin(domain.original_cells[found[:, 0]], based)]
            return ufl.Measure("ds", domain=mesh, subdomain_data=[(1, np.ascontiguousarray(chosen).ravel())])
        found = seam_entities(domain, name)
        chosen = found[np.isin(domain.original_cells[found[:, [2, 0]]] @ [1, count], pairs)]
        return ufl.Measure("dS", domain=mesh, subdomain_data=[(1, np.ascontiguousarray(chosen, np.int32).ravel())])


def _facets(structure: Setup, where: Where) -> BoolArray:
    """(n_S,) the facets that get cells.

    Raises:
        InputError: `where` gives no truth values, or chooses none of the facets.
    """
    joint = structure.joint
    centres = joint.points[joint.table.vertices[joint.surface_rows]].mean(axis=1)
    n = len(centres)
    try:
        found = np.asarray(where(centres.T) if callable(where) else where)
    except Exception as error:
        raise InputError(f"where is no numpy function of places x (d, n): {error}") from error
    if found.dtype != bool or found.shape != (n,):
        raise InputError(
            f"where gives shape {found.shape} and type {found.dtype}; it must say for each of the {n} facets of S whether "
            "the layer is meshed there, as lambda x: abs(x[0] - 20) > 16 does, or an array of truth values"
        )
    if not found.any():
        raise InputError("where holds on no facet of S: no part of the layer is meshed; use structure.interface")
    return found


def _require(structure: Setup, layer: Layers, meshed: BoolArray, bodies: str) -> None:
    """Raise InputError for what a mixed model cannot have, with the reason."""
    joint = structure.joint
    if joint.base_seams and len(joint.seams) > 1:
        raise InputError("a mixed model on a rigid base needs one seam")
    if joint.periods or structure.strain is not None or structure.stress is not None:
        raise InputError("a mixed model is not for periodic cells")
    if structure.element[0] == "S":
        raise InputError("a mixed model needs nodal displacements, not elements S2")
    for name, one in layers_of(on_seams(joint, layer)).items():
        known = Reduction(SeamLayer(name, one, structure), bodies, meshed)
        known.require("mixed", "a mixed model: ")
        _warn_of_reach(known, meshed, structure.comm or world())
    rim = structure.sheet.rim
    by_law = rim[~meshed[structure.sheet.parts[0][rim.simplex]]]
    for name in structure.tractions or {}:
        outer = joint.facets.get(name.removesuffix(f"/{LAYER}")) if name.endswith(f"/{LAYER}") else None
        if outer is not None and by_law.on(outer).any():
            remedy = "mesh all of the layer there, as its law does not know the load"
            raise InputError(f"the traction on {name!r} acts on the side of the layer; {remedy}")
    if isinstance(structure.body_force, Mapping) and {S, *joint.seams} & set(structure.body_force):
        raise InputError("a mixed model has no weight of the layer itself; give the bodies theirs")


def _on_all_of_s(structure: Setup, layer: Layers) -> Layers:
    """The layers of the interface model: of order 0 where seams meet, as junctions, which have cells, know no order 1."""
    if not structure.joint.seams_meet:
        return layer
    given = layers_of(on_seams(structure.joint, layer)).items()
    return dict.fromkeys(structure.joint.seams) | {name: replace(one, order=0, edges=None) for name, one in given}


def _warn_of_reach(known: Reduction, meshed: BoolArray, comm: MPI.Intracomm) -> None:
    """Warn where a law of order 1 acts beside a free end with cells."""
    one, sheet, ends, x = known.one, known.one.sheet, known.rim("meshed"), known.one.sheet.joint.points
    by_law = np.unique(sheet.joint.table.vertices[sheet.joint.surface_rows[sheet.facets][~meshed[sheet.facets]]])
    if one.thin and one.thin.order and len(by_law):
        near = ends.distance(x, x[by_law])
        if (width := near.min() / one.thin.eps) < REACH:
            warn(
                "meshed end",
                f"{one} is meshed over {width:.2g} thicknesses at its free end, up to {place(x[by_law[near.argmin()]])}: "
                f"the end's stresses reach the law beyond; mesh {REACH:g} or more",
                comm,
            )
