"""Reader of Exodus II files, of which meshio reads neither side sets nor the names of blocks."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.io import netcdf_file

from forms.base import InputError, import_optional
from geometry.importing.elements import FACES, add_face, mesh_of, shape_of
from geometry.topology import IntArray

if TYPE_CHECKING:
    import meshio

# start of an element's type -> meshio's name of this element without further nodes, and its number of vertices
TYPES = {
    "TRI": ("triangle", 3), "QUAD": ("quad", 4), "SHELL": ("quad", 4), "TET": ("tetra", 4), "PYR": ("pyramid", 5),
    "WEDGE": ("wedge", 6), "HEX": ("hexahedron", 8), "BAR": ("line", 2), "BEAM": ("line", 2), "TRUSS": ("line", 2),
}  # fmt: skip
UP = [*range(12), 16, 17, 18, 19, 12, 13, 14, 15]
ORDERS = {15: [*range(9), 12, 13, 14, 9, 10, 11], 20: UP, 27: [*UP, 23, 24, 25, 26, 21, 22, 20]}  # of nodes, for VTK
BASES = {"tetrahedron": 1, "pyramid": 1, "prism": 2, "hexahedron": 2}  # faces that come first in `FACES`, here last


def load(path: Path) -> meshio.Mesh:
    """Return the mesh in an Exodus II file with its blocks, side sets and node sets.

    A set without a name is named by its number, as text.

    Args:
        path: the file, in NetCDF 3, or with h5py in NetCDF 4.

    Raises:
        InputError: the file is of another kind.
    """
    with path.open("rb") as file:
        magic = file.read(4)
    if magic not in (b"\x89HDF", b"CDF\x01", b"CDF\x02"):
        raise InputError("this is no Exodus II file in NetCDF 3 or 4; save it as one, or as .msh or .vtu")
    is_hdf = magic == b"\x89HDF"
    variables = import_optional("h5py").File(path) if is_hdf else netcdf_file(path, mmap=False).variables
    elements, sets = list[tuple[str, Any]](), defaultdict[str, set[int]](set)

    def groups(kind: str) -> list[tuple[str, str]]:
        """Return the names of all blocks ("eb"), side sets ("ss") or node sets ("ns"), and their numbers in the file."""
        ids = variables[f"{kind}_prop1"][:] if f"{kind}_prop1" in variables else []
        rows = variables[f"{kind}_names"][:] if f"{kind}_names" in variables else [b""] * len(ids)
        texts = [np.asarray(row).tobytes().decode().strip("\0 ") for row in rows]
        return [(text or str(id_), str(k)) for k, (text, id_) in enumerate(zip(texts, ids, strict=True), 1)]

    for name, k in groups("eb"):
        block = variables[f"connect{k}"]
        kind = str(np.ravel((block.attrs if is_hdf else vars(block))["elem_type"]).astype(str)[0]).upper()
        base, n_vertices = next((of for start, of in TYPES.items() if kind.startswith(start)), (kind, 0))
        nodes: IntArray = np.asarray(block[:], np.int64) - 1
        n = nodes.shape[1]
        sets[name] |= {*range(len(elements), len(elements) + len(nodes))}
        elements += [(base + str(n) * (n != n_vertices), row) for row in nodes[:, ORDERS.get(n, [*range(n)])]]
    for name, k in groups("ss"):
        for element, side in zip(variables[f"elem_ss{k}"][:] - 1, variables[f"side_ss{k}"][:] - 1, strict=True):
            shape = shape_of(elements[element][0])
            face = (side + BASES.get(shape, 0)) % len(FACES.get(shape, "?"))
            sets[name].add(add_face(elements, element, face))
    node_sets = {name: (variables[f"node_ns{k}"][:] - 1).tolist() for name, k in groups("ns")}
    axes = [variables[name][:] for name in ("coordx", "coordy", "coordz") if name in variables]
    return mesh_of(np.transpose(axes or variables["coord"][:]).astype(float), elements, sets, node_sets)
