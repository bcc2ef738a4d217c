"""Mesh files for tests, drawn with gmsh or written cell by cell."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace

import basix
import gmsh
import meshio
import numpy as np

from geometry.joint import Joint
from geometry.seam import Seam
from geometry.topology import FacetTable, geometry_degree, lagrange, node_jacobians

CELLS = {"triangle": (2, False), "quadrilateral": (2, True), "tetrahedron": (3, False), "hexahedron": (3, True)}
MESHIO = {"triangle": ("triangle", "line"), "quadrilateral": ("quad", "line"), "hexahedron": ("hexahedron", "quad")}
ORDER = {"line": [0, 1], "triangle": [0, 1, 2], "quad": [0, 1, 3, 2], "hexahedron": [0, 1, 3, 2, 4, 5, 7, 6]}
GRID = np.array([[x, y] for y in (-1.0, 0.0, 1.0) for x in (0.0, 1.0, 2.0)])
QUADS = np.array([[0, 1, 4, 3], [1, 2, 5, 4], [3, 4, 7, 6], [4, 5, 8, 7]])
LINES = np.array([[3, 4], [4, 5], [6, 7], [7, 8]])
SPACE = np.vstack([np.pad(GRID, ((0, 0), (0, 1))), [[0, 0, 1]]])
NAMES = {"LOW": (1, 2), "UP": (2, 2), "S": (1, 1), "TOP": (2, 1)}


@contextmanager
def drawing():
    """gmsh's OpenCASCADE kernel, in a session of its own."""
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        yield gmsh.model.occ
    finally:
        gmsh.finalize()


def save(path, dim, groups, h=0.6, version=4.1, binary=1, **options):
    """Mesh what was drawn and write it, unless path is None; groups: (dim, name) -> tags."""
    gmsh.model.occ.synchronize()
    for (d, name), tags in groups.items():
        gmsh.model.addPhysicalGroup(d, tags, name=name)
    for name, value in {"MeshSizeMax": h, "MshFileVersion": version, "Binary": binary, **options}.items():
        gmsh.option.setNumber(f"Mesh.{name}", value)
    gmsh.model.mesh.generate(dim)
    if path is not None:
        gmsh.write(str(path))
    return path


def model_to_mesh(comm, gdim):
    """The model that rank 0 has drawn as DOLFINx distributes it: mesh, cell tags, facet tags, (dim, number) -> name."""
    try:
        from dolfinx.io import gmshio
    except ImportError:  # DOLFINx 0.10
        from dolfinx.io import gmsh as gmshio
    names = {}
    if comm.rank == 0:
        names = {group: gmsh.model.getPhysicalName(*group) for group in gmsh.model.getPhysicalGroups()}
    return *gmshio.model_to_mesh(gmsh.model, comm, 0, gdim=gdim)[:3], names


def boxes(occ, *shapes, dim=2, shared=True):
    """Rectangles or boxes (x, y, width, height), of thickness 1 in 3D, that share their sides or not; their tags."""
    add = occ.addRectangle if dim == 2 else occ.addBox
    tags = [add(x, y, 0, w, h, *([] if dim == 2 else [1])) for x, y, w, h in shapes]
    if shared and len(tags) > 1:
        occ.fragment([(dim, tags[0])], [(dim, tag) for tag in tags[1:]])
    occ.synchronize()
    return tags


def sides(x, y, w, h, dim=2):
    """Tags of the curves or surfaces in a rectangle (x, y, width, height)."""
    low, high = (x - 1e-3, y - 1e-3, -1e-3), (x + w + 1e-3, y + h + 1e-3, 1 + 1e-3)
    return [tag for _, tag in gmsh.model.getEntitiesInBoundingBox(*low, *high, dim - 1)]


def stack(occ, path, dim=2, **options):
    """LOWER (0, 2) x (-1, 0), UPPER (0, 2) x (0, 1), S between, TOP above."""
    low, up = boxes(occ, (0, -1, 2, 1), (0, 0, 2, 1), dim=dim)
    groups = {(dim, "LOWER"): [low], (dim, "UPPER"): [up]}
    facets = {(dim - 1, "S"): sides(0, 0, 2, 0, dim), (dim - 1, "TOP"): sides(0, 1, 2, 0, dim)}
    return save(path, dim, groups | facets, **options)


def rings(occ, path, cell, degree, **options):
    """A disc CORE of radius 1 in a RING of radius 2, S between, in 3D of height 1."""
    dim, tensor = CELLS[cell]
    discs = [(2, occ.addDisk(0, 0, 0, radius, radius)) for radius in (1, 2)]
    occ.fragment(discs[:1], discs[1:])
    bodies = [tag for _, tag in occ.getEntities(2)]
    if dim == 3:
        drawn = occ.extrude([(2, tag) for tag in bodies], 0, 0, 1, numElements=[2], recombine=tensor)
        bodies = [tag for d, tag in drawn if d == 3]
    occ.synchronize()
    core = min(bodies, key=lambda tag: occ.getMass(dim, tag))
    (ring,) = set(bodies) - {core}
    around = [{tag for _, tag in gmsh.model.getBoundary([(dim, body)], oriented=False)} for body in (core, ring)]
    groups = {(dim, "CORE"): [core], (dim, "RING"): [ring], (dim - 1, "S"): sorted(around[0] & around[1])}
    if tensor:
        options |= {"RecombineAll": 1, "SubdivisionAlgorithm": 1 if dim == 2 else 0, "RecombinationAlgorithm": 2}
    return save(path, dim, groups, ElementOrder=degree, **options)


def write(path, points, blocks, tags, names):
    """A file of gmsh, version 2.2, with these physical groups; names: name -> (number, dimension)."""
    data = {"gmsh:physical": [np.asarray(t) for t in tags], "gmsh:geometrical": [np.asarray(t) for t in tags]}
    points = np.pad(points, ((0, 0), (0, 3 - np.shape(points)[1])))
    names = {name: np.array(value) for name, value in names.items()}
    mesh = meshio.Mesh(points, blocks, cell_data=data, field_data=names)
    meshio.write(path, mesh, file_format="gmsh22", binary=False)
    return path


def blocks_of(joint):
    """Cells and sets of facets of a joint, as meshio has them, and the numbers of regions and of sets from 1 on."""
    kind, side = MESHIO[joint.cell_type]
    sets = list(joint.facets.values())
    tags = [joint.region + 1, *(np.full(len(rows), k) for k, rows in enumerate(sets, 1))]
    return [(kind, joint.corners[:, ORDER[kind]]), *((side, rows[:, ORDER[side]]) for rows in sets)], tags


def squares(path, points=GRID, cells=QUADS, lines=LINES, regions=(1, 1, 2, 2), more=(), names=NAMES, kind="quad"):
    """Two squares LOW below two squares UP, in between S, above TOP."""
    blocks, tags = [("line", lines), (kind, cells)], [[1, 1, 2, 2][: len(lines)], regions]
    for name, rows, tag in more:
        blocks.append((name, np.array(rows)))
        tags.append([tag] * len(rows))
    return write(path, points, blocks, tags, names)


def volumes(joint: Joint) -> np.ndarray:
    """(n_cells,) by quadrature that is exact enough for curved cells; no Jacobian may differ in sign within a cell."""
    element = lagrange(joint.cell_type, geometry_degree(joint.cell_type, joint.cells.shape[1]))
    x, weights = basix.make_quadrature(basix.CellType[joint.cell_type], 6)
    gradients = element.tabulate(1, x)[1:, :, :, 0]
    jacobian = np.linalg.det(np.einsum("tqn,cnd->cqtd", gradients, joint.points[joint.cells]))
    assert ((jacobian > 0).all(axis=1) | (jacobian < 0).all(axis=1)).all()
    return np.abs(jacobian @ weights)


def volume(joint: Joint) -> float:
    """Of all cells."""
    return float(volumes(joint).sum())


def grid(axes, inside, cell, keep=lambda x: np.ones(len(x), bool)):
    """A joint on the grid of the axes' points: region IN (above S) where `inside` holds of the cells' centres, else OUT."""
    dim, shape = len(axes), [len(axis) for axis in axes]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, dim)
    number = np.arange(len(points)).reshape(shape)
    corner = [
        number[tuple(slice(c >> k & 1, shape[k] - 1 + (c >> k & 1)) for k in range(dim))].ravel() for c in range(2**dim)
    ]
    cells = np.stack(corner, axis=1)
    cells = cells[keep(points[cells].mean(axis=1))]
    region = inside(points[cells].mean(axis=1)).astype(np.int64)
    if cell in ("triangle", "tetrahedron"):
        paths = {2: [(0, 1, 3), (0, 2, 3)], 3: [(0, a, a | b, 7) for a in (1, 2, 4) for b in (1, 2, 4) if a != b]}[dim]
        region, cells = np.repeat(region, len(paths)), cells[:, paths].reshape(-1, dim + 1)
    used, cells = np.unique(cells, return_inverse=True)
    points, cells = points[used], cells.reshape(len(region), -1)
    table = FacetTable.of(cells, cell)
    outer = table.cells[:, 1] < 0
    facets = {"S": table.vertices[~outer & (region[table.cells[:, 0]] != region[table.cells[:, 1]])]}
    for k, name in enumerate(("LEFT", "BOTTOM", "BACK")[:dim]):
        facets[name] = table.vertices[outer & np.isclose(points[table.vertices][..., k], axes[k][0]).all(axis=1)]
    facets["TOP"] = table.vertices[outer & np.isclose(points[table.vertices][..., 1], axes[1][-1]).all(axis=1)]
    return Joint(points, cells, cell, region, ("OUT", "IN"), facets, {"S": Seam(("OUT",), ("IN",))})


def check_sound(joint, sides, base=None):
    """No cell is folded, or turned round from what it is in base, and the sides' facets are the outer ones, each once."""
    signs = np.sign(node_jacobians(joint.points, joint.cells, joint.cell_type))
    assert (signs == signs[:, :1]).all()
    if base is not None:
        before = np.sign(node_jacobians(base.points, base.cells, base.cell_type))
        assert (signs[: len(before), 0] == before[:, 0]).all()
    rows = np.sort(joint.table.index(np.concatenate([joint.facets[name] for name in sides])))
    assert np.array_equal(rows, np.flatnonzero(joint.table.cells[:, 1] < 0))


def part_of(joint, kept, **changes):
    """The joint without some of its cells (kept: (n_cells,) whether each stays), and with other changes."""
    used, cells = np.unique(joint.cells[kept], return_inverse=True)
    new = np.full(len(joint.points), -1)
    new[used] = np.arange(len(used))
    around = {name: joint.table.cells[joint.table.index(rows)] for name, rows in joint.facets.items()}
    kept_facets = {name: ((adjacent >= 0) & kept[adjacent]).any(axis=1) for name, adjacent in around.items()}
    facets = {name: new[rows[kept_facets[name]]] for name, rows in joint.facets.items() if kept_facets[name].any()}
    present, region = np.unique(joint.region[kept], return_inverse=True)
    regions = tuple(joint.regions[k] for k in present)
    parts = dict(points=joint.points[used], cells=cells.reshape(len(region), -1), facets=facets)
    return replace(joint, **parts | dict(region=region, regions=regions) | changes)


def parted(whole, region):
    """A mesh with S between all cells of different regions; the outer facets are OUT."""
    table = whole.table
    first, second = table.cells.T
    facets = {"S": table.vertices[(second >= 0) & (region[first] != region[second])], "OUT": table.vertices[second < 0]}
    names = tuple(f"B{k}" for k in range(region.max() + 1))
    return Joint(whole.points, whole.cells, whole.cell_type, region, names, facets, {"S": Seam()})


def upper_cells(joint):
    """(n_cells,) whether each cell is part of a body above S."""
    pieces = joint.split_mesh.pieces
    return np.isin(pieces, pieces[joint.surface_cells[:, 1]])


def in_layer(joint):
    """(n_cells,) whether each cell of an inflated joint is in the layer."""
    return np.isin(joint.region, [joint.regions.index(name) for name in joint.band.regions])


def renumbered(joint, seed=3):
    """The joint with its nodes and cells in another order."""
    random = np.random.default_rng(seed)
    nodes, cells = random.permutation(len(joint.points)), random.permutation(len(joint.cells))
    points = np.empty_like(joint.points)
    points[nodes] = joint.points
    facets = {name: nodes[rows] for name, rows in joint.facets.items()}
    return replace(joint, points=points, cells=nodes[joint.cells[cells]], region=joint.region[cells], facets=facets)
