"""Functions on function spaces and forms that work with DOLFINx 0.9 to 0.11, whose interfaces differ.

Each function tries the arguments of one release after those of another. `geometry/domain.py` does the same for meshes.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy
from weakref import proxy

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import cpp, fem
from dolfinx.common import IndexMap
from dolfinx.mesh import Mesh

import thinlayer.system.compilation  # noqa: F401  # before any form is compiled
from geometry.domain import call_first_accepted, create_connectivity

IntArray = npt.NDArray[np.int32]
Tags = int | str | tuple[int | str, ...]  # tags of a measure
EntityMaps = list[object] | dict[Mesh, IntArray]  # for fem.form, of DOLFINx 0.10 and later, and of 0.9


def space_with_dofmap(V: fem.FunctionSpace, dofs: IntArray, imap: IndexMap) -> fem.FunctionSpace:
    """Make a function space with the mesh and element of V and another numbering of its degrees of freedom.

    Degrees of freedom at one node, such as components of a vector, form a block with one number.

    Args:
        V: the function space.
        dofs: (cells, blocks per cell) numbers of the blocks of each cell of this rank, ghost cells included.
        imap: DOLFINx's index map of the blocks, which says what rank owns each of them.
    """
    old, base = V._cpp_object, V.dofmap
    dof_layout = base._cpp_object.dof_layout if hasattr(base, "_cpp_object") else base.dof_layout
    block_lists = cpp.graph.AdjacencyList_int32(np.ascontiguousarray(dofs, np.int32))
    arguments = (old.mesh, old.element, cpp.fem.DofMap(dof_layout, imap, base.index_map_bs, block_lists, base.bs))
    cpp_space = call_first_accepted(lambda: type(old)(*arguments), lambda: type(old)(*arguments, old.value_shape))
    return fem.FunctionSpace(V.mesh, V.ufl_element(), cpp_space)


def integration_entities(integral_type: str, mesh: Mesh, entities: IntArray) -> IntArray:
    """Return what DOLFINx needs to integrate over cells or facets.

    Cells and facets of other ranks are left out, and interior facets with only one cell on this rank.

    Args:
        integral_type: type of integral, "cell", "exterior_facet" or "interior_facet".
        mesh: the mesh.
        entities: numbers of the cells or facets on this rank.

    Returns:
        (n, 1) numbers of n cells; (n, 2) for each of n facets on the boundary its cell, and the number of the facet
        among the facets of this cell; (n, 4) for each of n interior facets both for one and then for the other cell.
    """
    dim = mesh.topology.dim - (integral_type != "cell")
    create_connectivity(mesh, dim)
    arguments = getattr(fem.IntegralType, integral_type), getattr(mesh.topology, "_cpp_object", mesh.topology), entities
    compute = cpp.fem.compute_integration_domains
    flat = call_first_accepted(lambda: compute(*arguments), lambda: compute(*arguments, dim))
    return np.array(flat, np.int32).reshape(-1, {"cell": 1, "exterior_facet": 2, "interior_facet": 4}[integral_type])


def integrals_by_domain(form: ufl.Form) -> dict[tuple[str, int, Tags], list[ufl.Integral]]:
    """Group the integrals of a form by where they integrate: by type of integral, subdomain data and tags.

    Integrals that differ only in their tags become one integral, whose tag is the tuple of their tags.

    Returns:
        (type of integral, `id` of its subdomain data, tag or tuple of tags) -> integrals.
    """
    tags_by_integral: dict[tuple[object, ...], tuple[ufl.Integral, list[int | str]]] = {}
    for integral in form.integrals():
        for tag in np.atleast_1d(np.array(integral.subdomain_id(), object)):
            rule, data = repr(sorted(integral.metadata().items())), id(integral.subdomain_data())
            key: tuple[object, ...] = (integral.integral_type(), data, isinstance(tag, str), integral.integrand(), rule)
            while tag in tags_by_integral.setdefault(key, (integral, []))[1]:
                key = (*key, "once more")
            tags_by_integral[key][1].append(tag)
    domains: dict[tuple[str, int, Tags], list[ufl.Integral]] = {}
    for integral, tags in tags_by_integral.values():
        ids = tuple(tags) if len(tags) > 1 else tags[0]
        domain = integral.integral_type(), id(integral.subdomain_data()), ids
        domains.setdefault(domain, []).append(integral.reconstruct(subdomain_id=ids))
    return domains


def compiled(form: ufl.Form, maps: EntityMaps | None = None) -> fem.Form:
    """Compile a form. Unlike `fem.form`, it allows tags that overlap, and measures with different subdomain data.

    The sets of tags are replaced by the numbers 1, 2, ..., so that forms which differ only in tags share one compiled
    code. DOLFINx itself refuses different subdomain data. Its release 0.9 loses integrals if tags overlap and
    quadrature degrees differ.

    Args:
        form: the form.
        maps: entity maps for coefficients on other meshes, in the type that `fem.form` of the installed release takes;
            None: the form has no such coefficients.
    """
    numbered_lists: dict[str, list[tuple[int, IntArray]]] = {}
    integrals = []
    for (integral_type, _, ids), domain_group in integrals_by_domain(form).items():
        data, entity_lists = domain_group[0].subdomain_data(), numbered_lists.setdefault(integral_type, [])
        if not isinstance(ids, str):
            tags = np.atleast_1d(ids)
            if hasattr(data, "indices"):
                tagged = data.indices[np.isin(data.values, tags)]
                flat: IntArray = integration_entities(integral_type, form.ufl_domain().ufl_cargo(), tagged).ravel()
            else:
                entity_arrays = [np.asarray(rows, np.int32).ravel() for tag, rows in data if tag in tags]
                flat = np.concatenate([np.empty(0, np.int32), *entity_arrays])
            ids = len(entity_lists) + 1
            entity_lists.append((ids, flat))
        for integral in domain_group:  # UFL would join integrals with equal integrand and metadata over several numbers
            metadata = {**integral.metadata(), "part": str(ids)}
            integrals.append(integral.reconstruct(subdomain_id=ids, subdomain_data=entity_lists, metadata=metadata))
    entity_maps = copy(maps or {})  # a copy: DOLFINx leaves it in a reference cycle with the form
    compiled_form = fem.form(ufl.Form(integrals), entity_maps=entity_maps)
    entity_maps.clear()
    return compiled_form


def interpolation_points(V: fem.FunctionSpace) -> npt.NDArray[np.float64]:
    """Return the interpolation points (n, d) of the element of V, in its reference cell of dimension d."""
    points = V.element.interpolation_points
    return points() if callable(points) else points


def create_submesh(mesh: Mesh, dim: int, entities: IntArray) -> tuple[Mesh, EntityMaps, IntArray]:
    """Make a submesh of cells, facets, edges or vertices of a mesh. Collective.

    Args:
        mesh: the mesh.
        dim: dimension of these entities.
        entities: their numbers on this rank.

    Returns:
        The submesh; its entity maps, in the type that `fem.form` of the installed release takes; and for each of its
        cells the number of the entity.
    """
    sub, entity_map = dolfinx.mesh.create_submesh(mesh, dim, entities)[:2]
    if hasattr(entity_map, "sub_topology_to_topology"):
        imap = sub.topology.index_map(sub.topology.dim)
        cells = np.arange(imap.size_local + imap.num_ghosts, dtype=np.int32)
        return sub, [entity_map], entity_map.sub_topology_to_topology(cells, False)
    parent_entities, imap = np.asarray(entity_map, np.int32), mesh.topology.index_map(dim)
    cells_of_entities = np.full(imap.size_local + imap.num_ghosts, -1, np.int32)
    cells_of_entities[parent_entities] = np.arange(len(parent_entities), dtype=np.int32)
    return sub, {sub: cells_of_entities}, parent_entities


def belongs_to(bc: fem.DirichletBC, V: fem.FunctionSpace) -> bool:
    """Return whether a Dirichlet condition constrains degrees of freedom of the function space V.

    Those of a component of V count, too.
    """
    space = bc.function_space  # a C++ object in DOLFINx 0.9
    return bool(V._cpp_object.contains(getattr(space, "_cpp_object", space)))


# ---------------------------------------------------------------- reference cycles, which keep meshes alive until
# Python's garbage collector runs: long runs would exceed MPI's limit of communicators
def interpolate(f: fem.Function, values: object) -> None:
    """Interpolate `values` (a function of points, an Expression or a Function) into f.

    Unlike `f.interpolate`, this leaves no reference cycle that keeps f alive.
    """
    fem.Function.interpolate(proxy(f), values)


@contextmanager
def without_cycles() -> Iterator[None]:
    """Context manager that at its end frees recent objects which are unused but refer to each other.

    UFL's algorithms leave such cycles, which would keep functions and their meshes alive.
    """
    try:
        yield
    finally:
        gc.collect(1)  # young objects only, in less than a millisecond


expand_derivatives = without_cycles()(ufl.algorithms.expand_derivatives)
ufl_replace = without_cycles()(ufl.replace)
