"""BrokenMesh: a user's DOLFINx mesh with tags, whose bodies may separate on tagged facets."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import basix.ufl
import dolfinx.mesh
import numpy as np
import ufl
from dolfinx import cpp, fem, la
from dolfinx.mesh import Mesh, MeshTags
from mpi4py import MPI

from forms.base import Array, InputError, require
from forms.kinematics import KINEMATICS_BY_NAME, SCALAR_KINEMATICS_BY_NAME, Kinematics, ScalarField
from forms.law import BulkLaw
from forms.traction import TractionLaw
from forms.work import Interface, Term, s_terms
from geometry.domain import Element, create_connectivity
from geometry.refusals import unknown_name_message
from geometry.seam import Seam
from geometry.topology import Indices, turned_towards
from thinlayer.discretisation.boundary import AXIS_TOLERANCE
from thinlayer.discretisation.contact_nodes import ContactSurface
from thinlayer.discretisation.form_compilation import law_with_expressions
from thinlayer.discretisation.layer import InitialTangents, ThinLayer, law_of_terms, law_with_numbers
from thinlayer.discretisation.mesh_functions import SharedDofs, broken_space
from thinlayer.system.compat import integration_entities, interpolate
from thinlayer.system.ranks import communicator, errors_on_all

UpperSideRule = int | set[int] | frozenset[int] | Sequence[float] | None
TagRules = int | Iterable[int] | Mapping[int, UpperSideRule]


class BrokenMesh:
    """A DOLFINx mesh whose bodies may separate on tagged facets, S. Collective, as are all methods.

    Args:
        mesh: the mesh; on several ranks with ghost cells across facets, `ghost_mode=GhostMode.shared_facet`.
        bodies: tags of all cells, one value for each body; functions are continuous in a body. Bodies with the same
            value that touch on S are one body there, so give each brick of a wall its own value.
        facet_tags: tags of facets.
        S: mapping from each value of `facet_tags` where bodies may separate to a rule that chooses the upper side. A
            rule is one of these:

            - a vector, such as (0, 1): the side to which it points; for flat joints between many bodies, as in masonry
            - a value of `bodies`, or a set of values: the side of these bodies; for an S of any shape
            - None: the side of the body with the larger value.

            One value or several values without a mapping have the rule None. The upper side decides the sign of
            reported jumps and tractions, and which sublayer of a `Stack` is the lower one. S on the boundary of the
            mesh is a rigid base, and the body is above it.
        plane: "strain" (plane strain, and 3D), "stress" (plane stress) or "axisymmetric" (x is the distance from the
            axis of revolution). With this object as `broken`, the term of a body's law is
            `forms.work.body(broken.kinematics.law(law), measure, broken.kinematics)`. Multiply loads by
            `broken.kinematics.factor`, and prescribe u_x = 0 on the axis of revolution.

    Attributes:
        mesh, bodies, facet_tags: the arguments.
        kinematics: strains of displacements, and the factor of measures: 2 pi r in axisymmetry, else 1.
        dS: measure of the facets between bodies, dS(value); "+" is the upper side. DOLFINx allows one set of tags for
            all dS integrals of a form: use this measure also for its other terms on facets of S.

    Raises:
        InputError: cells without a body, bodies that meet outside S, or facets of S inside a body; facets whose upper
            side the rule does not determine; missing ghost cells. The message has numbers and places.

    Example:
        >>> import numpy as np
        >>> from dolfinx import mesh
        >>> from mpi4py import MPI
        >>> from thinlayer import BrokenMesh
        >>> square = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4)
        >>> cells = np.arange(32, dtype=np.int32)
        >>> upper = mesh.compute_midpoints(square, 2, cells)[:, 1] > 0.5
        >>> bodies = mesh.meshtags(square, 2, cells, upper.astype(np.int32))
        >>> middle = mesh.locate_entities(square, 1, lambda x: np.isclose(x[1], 0.5))
        >>> facets = mesh.meshtags(square, 1, middle, np.full(len(middle), 7, np.int32))
        >>> broken = BrokenMesh(square, bodies, facets, S=7)
        >>> V = broken.space(("Lagrange", 1, (2,)))
        >>> V.dofmap.index_map.size_global  # 25 vertices, and those of S twice
        30
    """

    def __init__(self, mesh: Mesh, bodies: MeshTags, facet_tags: MeshTags, S: TagRules, plane: str = "strain") -> None:
        self.kinematics = self._kinematics(mesh, plane)
        self.mesh, self.bodies, self.facet_tags, self.comm = mesh, bodies, facet_tags, communicator(mesh)
        self._dim = mesh.topology.dim
        rules = dict(S) if isinstance(S, Mapping) else dict.fromkeys([S] if isinstance(S, int) else S)
        create_connectivity(mesh, self._dim - 1)
        self._exterior = np.asarray(dolfinx.mesh.exterior_facet_indices(mesh.topology))
        tag_of_cells = self._body_tags_of_cells()
        self._body_tags = np.unique(np.concatenate(self.comm.allgather(np.unique(tag_of_cells))))
        self._body_of = np.searchsorted(self._body_tags, tag_of_cells)
        self._check_facets_of_S(np.concatenate([np.empty(0, np.int32), *(self._owned_facets(tag) for tag in rules)]))
        self._facet_sides: dict[int, Indices] = {}
        for tag, upper_rule in rules.items():
            facets = self._owned_facets(tag)
            counts = len(facets), int(np.isin(facets, self._exterior).sum())
            n_facets, outer = map(self.comm.allreduce, counts)
            if not n_facets:
                tags = np.unique(np.concatenate(self.comm.allgather(np.unique(facet_tags.values))))
                raise InputError(f"S: no facet has the tag {tag}; there are {', '.join(map(str, tags)) or 'none'}")
            if outer not in (0, n_facets):
                raise InputError(f"S: {outer} of {n_facets} facets with tag {tag} lie on the boundary; all or none may")
            on_base = integration_entities("exterior_facet", mesh, facets)
            self._facet_sides[tag] = on_base if outer else self._oriented_facets(tag, facets, upper_rule)
        # DOLFINx loses unsorted tags
        data = [(tag, sides.ravel()) for tag, sides in sorted(self._facet_sides.items()) if sides.shape[1] == 4]
        self.dS = ufl.Measure("dS", domain=mesh, subdomain_data=data)

    @staticmethod
    def _kinematics(mesh: Mesh, plane: str) -> Kinematics:
        if plane not in KINEMATICS_BY_NAME or (mesh.geometry.dim == 3 and plane != "strain"):
            raise InputError(f"{unknown_name_message('plane', plane, KINEMATICS_BY_NAME)}; in 3D leave it out")
        kinematics, x = KINEMATICS_BY_NAME[plane], mesh.geometry.x
        least_r = communicator(mesh).allreduce(float(kinematics.axis_distances(x).min(initial=0.0)), MPI.MIN)
        if least_r < -AXIS_TOLERANCE * communicator(mesh).allreduce(float(np.abs(x).max(initial=0.0)), MPI.MAX):
            raise InputError(f"plane={plane!r}: x is the distance from the axis, and the mesh has x = {least_r:g} < 0")
        return kinematics.on_mesh(mesh)

    # ---------------------------------------------------------------- for users
    def space(self, element: Element) -> fem.FunctionSpace:
        """Return a function space that is continuous in each body and jumps across S.

        Args:
            element: a basix.ufl element, or its arguments (family, degree) or (family, degree, shape).
        """
        if isinstance(element, tuple):
            family, degree, *shape = element
            element = basix.ufl.element(family, self.mesh.basix_cell(), degree, shape=shape[0] if shape else None)
        n_entities = partial(cpp.mesh.cell_num_entities, self.mesh.topology.cell_type)
        components = [np.tile(self._body_of, (n_entities(dim), 1)).T for dim in range(self._dim)]
        return broken_space(self.comm, SharedDofs.of_components(self.comm, self.mesh, element, components))

    def interface(self, tag: int) -> Interface:
        """Return the two sides of the facets of S with a tag: normal, jumps of functions, and measure of integrals."""
        self._require_tag(tag)
        if self._facet_sides[tag].shape[1] == 2:
            ds = ufl.Measure("ds", domain=self.mesh, subdomain_data=self.facet_tags)
            return Interface.on_rigid_base(ds(tag), self.kinematics)
        return Interface.between_bodies(self.dS(tag), self.kinematics)

    def layer(self, tag: int, layer: ThinLayer | TractionLaw) -> list[Term]:
        """Return the terms of a layer's law on the facets of S with a tag, for `work` or `StepProblem`.

        An interface law of order 1 requires that these facets are flat, which is not checked. Laws of a scalar field
        act on functions of a scalar space, `space(("Lagrange", 2))`.

        Args:
            tag: tag of the facets.
            layer: law and thickness, or a law of jumps (`TractionLaw`), which has no thickness.

        Raises:
            InputError: a contact law (see `contact_surface`), or a law with a pressure field; order 1 with a thickness
                that varies, or with lmbda/mu so large that the law locks; a layer with an eigenstrain, or with
                edges="free".
        """
        allowed = "allowed: ThinLayer, TractionLaw; a ContactLaw is for ContactPart"
        require(isinstance(layer, ThinLayer | TractionLaw), "layer", layer, allowed)
        thin = layer if isinstance(layer, ThinLayer) else None
        is_scalar = thin is not None and thin.law.unknown == ScalarField.unknown
        kinematics = (
            SCALAR_KINEMATICS_BY_NAME[self.kinematics.name].on_mesh(self.mesh) if is_scalar else self.kinematics
        )
        law = law_with_numbers(layer, kinematics)
        if law.traits.constrained:
            raise InputError(f"{type(law).__name__} needs a pressure of its own; use it in a Model")
        law.check_dimension(self._dim)
        eps, profile, order = (thin.eps, thin.profile, thin.order) if thin else (1.0, None, 0)
        if thin and (thin.edges == "free" or thin.eigenstrain is not None):
            option = "edges='free'" if thin.edges == "free" else "eigenstrain=..."
            raise InputError(f"{option} of a layer on a mesh of one's own is not known here; use it in a Model")
        if order == 2:
            raise InputError("order=2 has an unknown of its own on S; use it in a Model")
        if order and profile is not None:
            remedy = "use Structure.interface(layer, bodies='extended')"
            raise InputError(f"order=1 of a thickness that varies needs bodies at their true places; {remedy}")
        if order:
            self._require_no_locking(tag, law)
        on_facets = partial(self._law_on_facets, tag)
        sides = replace(self.interface(tag), kinematics=kinematics, law_on_surface=on_facets)
        thickness = fem.Constant(self.mesh, float(eps))
        if profile is not None:
            relative_thickness = fem.Function(fem.functionspace(self.mesh, ("Lagrange", 1)))  # linear between vertices
            with errors_on_all(self.comm):
                interpolate(relative_thickness, lambda x: profile(x[: self._dim]))
            thickness = thickness * sides.upper(relative_thickness)
        return [replace(term, law=law_of_terms(term.law, self.mesh)) for term in s_terms(law, sides, thickness, order)]

    def contact_surface(self, tag: int, V: fem.FunctionSpace) -> ContactSurface:
        """Return the facets of S with a tag and the cells on their two sides, for a contact law.

        `ContactPart(law, surface)` with this surface adds the contact forces to a `StepProblem`.

        Args:
            tag: tag of the facets.
            V: displacement space from `space`, Lagrange of degree 1, or of degree 2 except on tetrahedra.

        Raises:
            InputError: a tag that is not in S; a space on another mesh or with another element.
        """
        self._require_tag(tag)
        element, allowed = V.ufl_element(), f"contact laws act at nodes: space(('Lagrange', 1, ({self._dim},)))"
        suitable = V.mesh is self.mesh and element.reference_value_shape == (self._dim,) and element.family_name == "P"
        suitable = suitable and element.degree <= (1 if self.mesh.topology.cell_name() == "tetrahedron" else 2)
        require(suitable, "V", V, f"{allowed} of this mesh, or but for tetrahedra of degree 2")
        return ContactSurface(V, self.comm, self._facet_sides[tag], kinematics=self.kinematics)

    def _require_tag(self, tag: int) -> None:
        if tag not in self._facet_sides:
            raise InputError(f"S has no tag {tag}; give a tag of S: {', '.join(map(str, self._facet_sides))}")

    def _require_no_locking(self, tag: int, law: BulkLaw) -> None:
        """Raise InputError if lmbda/mu is so large somewhere on the facets with a tag that the law of order 1 locks."""
        with errors_on_all(self.comm):
            for local_law in law.at_places(self._new_vertex_function(tag)[2]) if law.fields else [law]:
                if violation := InitialTangents(local_law, np.eye(self._dim)[-1]).locking_violation():
                    raise violation.error()

    def _new_vertex_function(self, tag: int) -> tuple[fem.Function, Indices, Array]:
        """Return a new function of degree 1 on the mesh, and its dofs at the facets with a tag.

        Returns:
            The function, the local numbers (n,) of its dofs at vertices of these facets, and their coordinates (d, n).
        """
        f = fem.Function(fem.functionspace(self.mesh, ("Lagrange", 1)))
        dofs = fem.locate_dofs_topological(f.function_space, self._dim - 1, self.facet_tags.find(tag))
        return f, dofs, f.function_space.tabulate_dof_coordinates()[dofs, : self._dim].T

    def _law_on_facets(self, tag: int, law: BulkLaw) -> BulkLaw:
        """Return a law with UFL expressions as parameters, for integrals over the facets with a tag.

        A parameter that is a function of the place becomes its interpolant on S, linear between vertices. Numbers
        become Constants.
        """
        expressions = {}
        for name in law.fields:
            f, dofs, x = self._new_vertex_function(tag)
            with errors_on_all(self.comm):
                f.x.array[dofs] = law.fields_at(x)[name]
            f.x.scatter_forward()
            expressions[name] = self.interface(tag).upper(f)
        return law_with_expressions(law, self.mesh, expressions)

    # ---------------------------------------------------------------- the tags
    def _owned_facets(self, tag: int) -> Indices:
        """Return the local numbers, ascending, of the facets with a tag that this rank owns."""
        facets = self.facet_tags.find(tag)
        return np.sort(facets[facets < self.mesh.topology.index_map(self._dim - 1).size_local])

    def _body_tags_of_cells(self) -> Indices:
        """Return the tag of the body of each local cell (n_cells,), ghosts included.

        Raises:
            InputError: a cell has no tag.
        """
        imap = self.mesh.topology.index_map(self._dim)
        body_tags, is_owned = la.vector(imap, dtype=np.int32), self.bodies.indices < imap.size_local
        body_tags.array[self.bodies.indices[is_owned]] = self.bodies.values[is_owned]
        if n_untagged := self.comm.allreduce(imap.size_local - len(np.unique(self.bodies.indices[is_owned]))):
            raise InputError(f"bodies: {n_untagged} cells have no tag; each cell belongs to a body")
        body_tags.scatter_forward()
        return np.asarray(body_tags.array)

    def _check_facets_of_S(self, facets_of_S: Indices) -> None:
        """Raise InputError for missing ghost cells, bodies that meet outside S, and facets of S inside a body.

        `facets_of_S` are the local numbers of the facets of S that this rank owns.
        """
        topology = self.mesh.topology
        inner = np.setdiff1d(np.arange(topology.index_map(self._dim - 1).size_local, dtype=np.int32), self._exterior)
        cell_counts = np.diff(topology.connectivity(self._dim - 1, self._dim).offsets)
        if n_without_ghosts := self.comm.allreduce(np.count_nonzero(cell_counts[inner] < 2)):
            remedy = "create it, or a partitioner, with ghost_mode=dolfinx.mesh.GhostMode.shared_facet"
            raise InputError(f"the mesh has no ghost cells across {n_without_ghosts} facets between ranks; {remedy}")
        entities = integration_entities("interior_facet", self.mesh, inner)
        to_facets = topology.connectivity(self._dim, self._dim - 1)
        facets = to_facets.array[to_facets.offsets[entities[:, 0]] + entities[:, 1]]
        border = self._body_of[entities[:, 0]] != self._body_of[entities[:, 2]]
        cut = np.isin(facets, facets_of_S)
        self._refuse(facets[border & ~cut], "where two bodies meet are not in S: tag them, or give both one value")
        self._refuse(facets[cut & ~border], "of S lie inside a body: give the bodies on its two sides different values")

    def _refuse(self, facets: Indices, what: str) -> None:
        if count := self.comm.allreduce(len(facets)):
            places = dolfinx.mesh.compute_midpoints(self.mesh, self._dim - 1, facets[:1])[:, : self._dim]
            place = next(p[0] for p in self.comm.allgather(places) if len(p))
            raise InputError(f"{count} facets {what}; one is at ({', '.join(f'{c:g}' for c in place)})")

    def _oriented_facets(self, tag: int, facets: Indices, upper: UpperSideRule) -> Indices:
        """Return for each of n facets between bodies the cell on its upper and the cell on its lower side. Collective.

        Args:
            tag: tag of the facets, for messages.
            facets: (n,) local numbers of the facets.
            upper: rule that chooses the upper side, a value of the argument `S` of `BrokenMesh`.

        Returns:
            Rows (n, 4): upper cell, number of the facet in this cell, lower cell, number of the facet in this cell.
        """
        entities, midpoints = integration_entities("interior_facet", self.mesh, facets), dolfinx.mesh.compute_midpoints
        seam, bodies, d = _seam(upper), tuple(map(str, self._body_tags)), self._dim
        x = midpoints(self.mesh, d - 1, facets)
        to_second = midpoints(self.mesh, d, entities[:, 2]) - x
        normals = turned_towards(cpp.mesh.cell_normals(self.mesh._cpp_object, d - 1, facets), to_second)
        body = self._body_of[entities[:, ::2]]
        with errors_on_all(self.comm):
            seam.check(f"tag {tag} of S", bodies, d)
            is_upper = seam.second_is_upper(f"tag {tag} of S", x[:, :d], normals[:, :d], body, bodies)
        entities[is_upper] = entities[is_upper][:, [2, 3, 0, 1]]
        return entities


def _seam(upper: UpperSideRule) -> Seam:
    """Return the choice of an upper side by the rule `upper`, a value of the argument `S` of `BrokenMesh`."""
    bodies = {upper} if isinstance(upper, int | np.integer) else upper
    if isinstance(bodies, set | frozenset) and bodies:
        return Seam(upper=tuple(map(str, bodies)))
    return Seam(direction=None if upper is None else tuple(np.ravel(np.array(upper)).tolist()))
