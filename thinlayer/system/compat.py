"""Functions that hide the differences between DOLFINx 0.9 and 0.11 in spaces and forms.

They try the signatures of the releases in turn, and do not ask for the version. Meshes: `geometry/domain.py`.
"""

from __future__ import annotations

from typing import Any

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from dolfinx import cpp, fem
from dolfinx.mesh import Mesh

import thinlayer.system.compilation  # noqa: F401  # before any form is compiled
from geometry.domain import first_that_fits


def space_with_dofmap(V: fem.FunctionSpace, dofs: npt.NDArray[np.int32], imap: Any) -> fem.FunctionSpace:
    """A function space like V whose cells' (block) dofs are the rows of `dofs`, numbered by an index map."""
    old, base = V._cpp_object, V.dofmap
    layout = base._cpp_object.dof_layout if hasattr(base, "_cpp_object") else base.dof_layout
    rows = cpp.graph.AdjacencyList_int32(np.ascontiguousarray(dofs, np.int32))
    arguments = (old.mesh, old.element, cpp.fem.DofMap(layout, imap, base.index_map_bs, rows, base.bs))
    space = first_that_fits(lambda: type(old)(*arguments), lambda: type(old)(*arguments, old.value_shape))
    return fem.FunctionSpace(V.mesh, V.ufl_element(), space)


def interior_facet_entities(mesh: Mesh, facets: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """(cell, local facet, cell, local facet) of interior facets, (n, 4); facets with one local cell are left out."""
    return _facet_entities(fem.IntegralType.interior_facet, mesh, facets).reshape(-1, 4)


def exterior_facet_entities(mesh: Mesh, facets: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """(cell, local facet) of exterior facets, (n, 2)."""
    return _facet_entities(fem.IntegralType.exterior_facet, mesh, facets).reshape(-1, 2)


def _facet_entities(kind: Any, mesh: Mesh, facets: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    topology = mesh.topology
    entities = first_that_fits(
        lambda: fem.compute_integration_domains(kind, topology, facets),
        lambda: cpp.fem.compute_integration_domains(kind, topology._cpp_object, facets, topology.dim - 1),
    )
    return np.array(entities, dtype=np.int32)


def interpolation_points(V: fem.FunctionSpace) -> npt.NDArray[np.float64]:
    """Interpolation points of a space's element on the reference cell."""
    points = V.element.interpolation_points
    return points() if callable(points) else points


def create_submesh(mesh: Mesh, dim: int, entities: npt.NDArray[np.int32]) -> tuple[Mesh, Any, npt.NDArray[np.int32]]:
    """Mesh of entities, entity maps for fem.form, and the entity of each of its cells. Collective."""
    sub, entity_map = dolfinx.mesh.create_submesh(mesh, dim, entities)[:2]
    if hasattr(entity_map, "sub_topology_to_topology"):
        imap = sub.topology.index_map(sub.topology.dim)
        cells = np.arange(imap.size_local + imap.num_ghosts, dtype=np.int32)
        return sub, [entity_map], entity_map.sub_topology_to_topology(cells, False)
    parents, imap = np.asarray(entity_map, np.int32), mesh.topology.index_map(dim)
    inverse = np.full(imap.size_local + imap.num_ghosts, -1, np.int32)
    inverse[parents] = np.arange(len(parents), dtype=np.int32)
    return sub, {sub: inverse}, parents


def belongs_to(bc: fem.DirichletBC, V: fem.FunctionSpace) -> bool:
    """Whether the degrees of freedom of a condition are those of a space, or of a component of it."""
    space = bc.function_space  # of C++ in DOLFINx 0.9
    return bool(V._cpp_object.contains(getattr(space, "_cpp_object", space)))
