"""Cells as VTK has them: types and the order of nodes."""

from __future__ import annotations

import dolfinx
import numpy as np
import numpy.typing as npt

from geometry.topology import geometry_degree

STRAIGHT = {"interval": 3, "triangle": 5, "quadrilateral": 9, "tetrahedron": 10, "hexahedron": 12}
LAGRANGE = {"interval": 68, "triangle": 69, "quadrilateral": 70, "tetrahedron": 71, "hexahedron": 72}  # of any degree


def vtk_type(cell_type: str, n_nodes: int) -> int:
    """VTK's number of a type of cells with that many nodes."""
    return (STRAIGHT if geometry_degree(cell_type, n_nodes) == 1 else LAGRANGE)[cell_type]


def vtk_order(cell_type: str, n_nodes: int) -> npt.NDArray[np.int64]:
    """(n_nodes,) the nodes of a cell, numbered as DOLFINx does, in the order that VTK wants."""
    order = dolfinx.cpp.io.perm_vtk(dolfinx.mesh.to_type(cell_type), n_nodes)
    return np.argsort(np.asarray(order, np.int64))
