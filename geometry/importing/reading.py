"""Joints from mesh files, read by meshio or by the modules beside this one, and from DOLFINx meshes."""

from __future__ import annotations

import io
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from functools import partial
from itertools import takewhile
from os.path import isfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, Unpack
from unittest.mock import patch
from warnings import catch_warnings

import dolfinx
import numpy as np

from forms.base import InputError, import_optional, is_finite, require
from geometry.importing import abaqus, exodus
from geometry.importing.elements import cells_of, joined, shape_of, split, xdmf_blocks
from geometry.importing.gathering import gather_joint
from geometry.importing.naming import FileCells, GroupMasks, NamedGroups, SeamSides, SideArgs
from geometry.joint import Joint
from geometry.parallel import Comm, ResultType, on_root
from geometry.refusals import refuse, require_known
from geometry.topology import FACET_TYPES, IntArray, corner_count, positions

if TYPE_CHECKING:
    import meshio

# a file; a mesh; or a mesh, tags of its cells and tags of its facets
Source: TypeAlias = "str | Path | dolfinx.mesh.Mesh | Sequence[dolfinx.mesh.Mesh | dolfinx.mesh.MeshTags | None]"
Names = Mapping[str, Any]  # names as in `read`
GMSH_PHYSICAL = "gmsh:physical"
XDMF_TASK = "meshio.xdmf.main.translate_mixed_cells"  # function of meshio that `xdmf_blocks` replaces
READERS = {".inp": abaqus.load, ".e": exodus.load, ".exo": exodus.load, ".ex2": exodus.load}


def read(
    mesh: Source, *, names: Names | None = None, scale: float = 1.0, comm: Comm = None, **sides: Unpack[SideArgs]
) -> Joint:
    """Return a joint from a mesh file, or from a DOLFINx mesh with tags. Collective.

    Regions of the joint are named groups of cells, and facet sets are named groups of facets. Every cell must be in
    exactly one region. If groups of cells overlap, only those named in `upper` and `lower` become regions; a group of
    all cells becomes none if there are others.

    Groups and names in a file are gmsh's physical groups, or the file's sets. Without these, cell data number the
    groups: "gmsh:physical", or the only array of integers. The number of a group, as text, is then its name; negative
    numbers mean no group. A set of nodes names the facets with all vertices in it, unless this is a name already.

    Elements of 8, 15 or 20 nodes get the missing nodes. Wedges, pyramids, and elements of several shapes are split into
    triangles or tetrahedra, with a RangeWarning. A DOLFINx mesh may be distributed in any way, with or without ghosts.
    The joint does not depend on this, because its nodes and cells are sorted by their places.

    Args:
        mesh: path of a file; or a DOLFINx mesh; or (mesh, cell tags, facet tags) with None for missing tags. Cells are
            straight or of degree 2; in 2D they lie in a plane z = const.
        names: name of a facet set -> function of the coordinates (d, n) of n places that returns n times True or False,
            true at all its vertices; or (lower, upper) regions on its two sides. For DOLFINx tags also name ->
            (dimension of the tagged entities, tag, ...), as in gmsh's physical groups. In a dimension without such
            names, groups are named by their tags, as text. Facets with other tags are left out. Without cell tags there
            is one region, "BODY". The value on rank 0 is used.
        S: name of the group of facets that becomes the seam "S" (default: the group named "S"); None for all facets
            between the regions `lower` and `upper`; "all" for all facets between different regions; "pairs" for these
            with a seam "A-B" for each pair of regions. For several seams, the names of their groups, which keep these
            names, or {name: upper side}. The upper side is a vector that points there, or (lower, upper) with names of
            regions. None, and with "all": the upper side is in the region that comes later in `Joint.regions`.
        upper: name or names of the regions above a single S. Default: if S is on the outer boundary, all
            regions; with `direction` the regions `lower`, or all regions if `lower` is not given. Else it is required.
        lower: name or names of the regions below a single S. Default: if S is on the outer boundary, a rigid base; with
            `direction` the regions `upper`, or all regions if `upper` is not given; else all that are not in `upper`.
        direction: vector that points to the upper side, one component per dimension, for a single S inside one body.
        regions: name of the array of integers in the file that numbers the groups, if there are several.
        join: nodes closer than this fraction of the mesh's largest extent become one, e.g. 1e-6. Default: none do, and
            coincident nodes are refused.
        scale: factor on the coordinates, > 0, e.g. 1e3 from metre to millimetre.
        comm: communicator whose rank 0 reads the file, or that the mesh is distributed on (default: MPI.COMM_WORLD).

    Example:
        >>> from dolfinx.mesh import create_unit_square
        >>> from geometry import read
        >>> from mpi4py import MPI
        >>> square = create_unit_square(MPI.COMM_WORLD, 4, 4)
        >>> joint = read(square, direction=(0, 1), names={"S": lambda x: x[1] == 0.5})
        >>> len(joint.facets["S"])
        4

    Raises:
        InputError: the file cannot be read or lacks names; tags are of another mesh, a tag in `names` does not occur,
            or the mesh is on other ranks than `comm`; a name is unknown or ambiguous; cells are of a type that is not
            allowed, or of several degrees; the mesh is a surface in 3D; nodes or cells are duplicate, cells are flat or
            folded, there are hanging nodes, or cells overlap their neighbours; S does not fit `Joint`.
    """
    require(is_finite(scale) and scale > 0, "scale", scale, "it must be a number > 0")
    entries = names.items() if isinstance(names, Mapping) else ()
    named = {name: rule for name, rule in entries if callable(rule) or _are_regions(rule)}
    tags = {name: rule for name, rule in entries if name not in named} if named else names
    choice = SeamSides.of(**sides, named=named)
    if not isinstance(mesh, (str, Path)):
        require(choice.regions is None, "regions", choice.regions, "it is of files; give names of tags")
        return gather_joint(mesh, tags, scale, comm, choice)
    if tags:
        raise InputError("names: tags are of DOLFINx meshes; for a file give functions of the place, or two regions")
    return on_root(comm, partial(read_groups, Path(mesh), NamedGroups.make_joint, choice, scale))


def _are_regions(rule: object) -> bool:
    return isinstance(rule, (tuple, list)) and all(isinstance(side, (str, tuple, list)) for side in rule)


def read_groups(
    path: Path, function: Callable[[NamedGroups], ResultType], sides: SeamSides | None = None, scale: float = 1.0
) -> ResultType:
    """Read the named groups of a mesh file and return what `function` returns for them. Not collective.

    Args:
        path: the file.
        function: function of the `NamedGroups` in the file.
        sides: choice of groups, of the facets of S and of its upper side; None: the facet set "S".
        scale: factor on the coordinates.

    Raises:
        InputError: the file or its groups are unsuitable; the message names the file, also for errors of `function`.
    """
    try:
        mesh, sides = _load(path, scale), sides or SeamSides.of()
        dim = max((block.dim for block in mesh.cells if len(block)), default=0)
        blocks = [block for block in mesh.cells if len(block) and block.dim == dim]
        if not blocks:
            raise InputError("the file has no cells")
        masters = joined(mesh.points, np.concatenate([block.data.ravel() for block in blocks]), sides.join)
        for block in mesh.cells if sides.join is not None else ():
            block.data = masters[block.data]
        mesh.points, nodes, cell_type, (elements, numbers) = cells_of(mesh.points, blocks)
        cells, (source, array_name) = FileCells.of(mesh.points, nodes, cell_type), _group_source(mesh, sides.regions)
        masks = _group_masks(mesh, dim, array_name)
        regions = {name: np.isin(np.arange(len(nodes)), numbers[mask[elements]]) for name, mask in masks.items()}
        if not regions:
            example = f'Physical {"Surface" if dim == 2 else "Volume"}("BODY") = {{...}}'
            raise InputError(f"no named groups of cells ({source}); in gmsh: {example}; saved with Mesh.SaveAll = 0")
        facets = _group_facets(mesh, cells, _group_masks(mesh, dim - 1, array_name))
        numbers_of_sets = {name: masters[of] for name, of in mesh.point_sets.items()}
        node_sets = {name: np.isin(cells.point_numbers, of) for name, of in numbers_of_sets.items()}
        return function(NamedGroups(cells, regions, facets, source, sides, node_sets))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _load(path: Path, scale: float) -> meshio.Mesh:
    """Return the mesh in the file `path` with coordinates multiplied by `scale`; what meshio prints is suppressed.

    Raises:
        InputError: the file is not readable, or two groups have the same physical name.
    """
    meshio, suffix = import_optional("meshio"), path.suffix.lower()
    if not isfile(path):
        raise InputError(f"the file does not exist in {path.parent.resolve()}")
    if not path.stat().st_size:  # some readers of meshio would wait for lines forever
        raise InputError("the file is empty")
    meshio._mesh.topological_dimension |= {"wedge15": 3, "pyramid13": 3}  # elements that meshio knows but cannot hold
    log = io.StringIO()
    try:
        with redirect_stdout(log), redirect_stderr(log), catch_warnings(action="ignore"), patch(XDMF_TASK, xdmf_blocks):
            mesh = READERS.get(suffix, meshio.read)(path)
    except InputError:
        raise
    except (Exception, SystemExit) as error:  # meshio exits Python when no reader succeeds
        text = " ".join(log.getvalue().split()) if isinstance(error, SystemExit) else f"{type(error).__name__}: {error}"
        advice = "in gmsh save with Mesh.SaveAll = 0, Mesh.SaveParametric = 0"
        if suffix != ".msh":
            advice = f"install {error.name}" if isinstance(error, ImportError) else "save it as .vtu or .msh"
        raise InputError(f"meshio cannot read this {path.suffix} file ({text}); {advice}") from None
    if suffix == ".msh":
        _require_single_names(path)
    mesh.points = np.asarray(mesh.points, float) * scale
    return mesh


def _require_single_names(path: Path) -> None:
    """Raise InputError if two groups in gmsh's file `path` have one physical name: meshio would drop one of them."""
    with path.open(encoding="utf-8", errors="replace", newline="\n") as file:
        head = "".join(takewhile(lambda line: not line.startswith(("$EndPhysicalNames", "$Nodes", "$Elements")), file))
    physical_names = re.findall(r'^\s*(\d)\s+(\d+)\s+"(.*)"\s*$', head.partition("$PhysicalNames")[2], re.MULTILINE)
    for name, count in Counter(name for *_, name in physical_names).items():
        if count > 1:
            groups = " and ".join(f"{tag} of dimension {dim}" for dim, tag, other in physical_names if other == name)
            raise InputError(f"the physical name {name!r} stands for the groups {groups}; each needs its own name")


def _group_source(mesh: meshio.Mesh, regions: str | None) -> tuple[str, str | None]:
    """Return where the mesh has its named groups: a noun phrase for messages, and the name of the cell data.

    These cell data have the number of each cell's group. The name is None if groups are cell sets or there are none.

    Args:
        mesh: the mesh.
        regions: name of the cell data that the user has chosen; None: not specified.

    Raises:
        InputError: several arrays of integers could number the groups, or the chosen one does not exist.
    """
    cell_data = {name: data for name, data in mesh.cell_data.items() if name != "gmsh:geometrical"}
    arrays = [name for name, data in cell_data.items() if all(np.ndim(x) == 1 and x.dtype.kind in "iu" for x in data)]
    if regions is not None:
        require_known("array of integers", regions, arrays, "regions")
        mesh.cell_sets.clear()
        return f"numbers in the cell data {regions!r}", regions
    if GMSH_PHYSICAL in mesh.cell_data:
        return "physical names" if mesh.field_data else f"numbers in the cell data {GMSH_PHYSICAL!r}", GMSH_PHYSICAL
    if getattr(mesh, "cell_tags", None):
        return "families", "cell_tags"
    if any(not name.startswith("gmsh:") for name in mesh.cell_sets):
        return "cell sets", None
    if len(arrays) > 1:
        raise InputError(f"several arrays of integers could number the groups: {', '.join(arrays)}; give regions")
    return (f"numbers in the cell data {arrays[0]!r}", arrays[0]) if arrays else ("no cell sets, no numbers", None)


def _group_masks(mesh: meshio.Mesh, dim: int, array_name: str | None) -> GroupMasks:
    """Return the nonempty groups of entities as name -> (n,) whether each of the n entities is in the group.

    Args:
        mesh: the mesh; its entities are numbered in the order of the file's blocks.
        dim: dimension of the entities.
        array_name: name of the cell data with the number of each entity's group; None: only cell sets are groups.
    """
    block_numbers = [k for k, block in enumerate(mesh.cells) if block.dim == dim]
    groups: GroupMasks = {}
    if not block_numbers:
        return groups
    for name, members in mesh.cell_sets.items():
        if not name.startswith("gmsh:"):
            members_by_block = ((len(mesh.cells[k]), [] if members[k] is None else members[k]) for k in block_numbers)
            groups[name] = np.concatenate([np.isin(np.arange(n), indices) for n, indices in members_by_block])
    if array_name is not None:
        group_numbers = np.concatenate([mesh.cell_data[array_name][k] for k in block_numbers]).astype(np.int64)
        for number in np.unique(group_numbers):
            for name in _group_names(mesh, dim, array_name, int(number)):
                groups[name] = groups.get(name, False) | (group_numbers == number)
    return {name: mask for name, mask in groups.items() if mask.any()}


def _group_names(mesh: meshio.Mesh, dim: int, array_name: str, number: int) -> Sequence[str]:
    """Return the names of one group; () if its number means no group.

    Args:
        mesh: the mesh.
        dim: dimension of the group's entities.
        array_name: name of the cell data with the number of each entity's group.
        number: the number of the group.
    """
    if array_name == "cell_tags":
        return tuple(mesh.cell_tags.get(number, ()))
    if array_name == GMSH_PHYSICAL:
        number = abs(number) or -1  # negative where gmsh reversed the cells; zero: no group
        names = [name for name, value in mesh.field_data.items() if tuple(np.ravel(value)) == (number, dim)]
        return names or ([str(number)] if number > 0 else ())
    return [str(number)] if number >= 0 else ()


def _group_facets(mesh: meshio.Mesh, cells: FileCells, groups: GroupMasks) -> dict[str, IntArray]:
    """Return the groups of facets as name -> (n, k) vertices of each of its n facets, each facet once.

    Vertices are row numbers in `cells.points`, ascending in each facet.

    Args:
        mesh: the mesh in the file.
        cells: its cells of the highest dimension, with their points.
        groups: name -> (n_facets,) whether each facet in the file is in this group.

    Raises:
        InputError: facets have a type that these cells lack, or are not part of the cells' mesh.
    """
    if not groups:
        return {}
    kind, dim = FACET_TYPES[cells.type], cells.points.shape[1]
    is_split = any(shape_of(block.type) != cells.type for block in mesh.cells if len(block) and block.dim == dim)
    rows, elements, n_elements = list[IntArray](), list[IntArray](), 0
    for block in (block for block in mesh.cells if block.dim == dim - 1):
        shape = shape_of(block.type)
        corners: IntArray = block.data[:, : corner_count(shape)].astype(np.int64)
        element: IntArray = np.arange(len(corners))
        if shape != kind and not is_split:
            raise InputError(f"the file has {block.type} facets, but its {cells.type} cells have {kind} facets")
        if shape != kind:
            element, corners = split(corners[:, [0, 1, 3, 2]], shape)
        rows.append(corners)
        elements.append(n_elements + element)
        n_elements += len(block)
    vertices, element = np.concatenate(rows), np.concatenate(elements)
    new_numbers = positions(cells.point_numbers, len(mesh.points))
    is_foreign, x = (new_numbers[vertices] < 0).any(axis=1), mesh.points[vertices, :dim]
    for name, mask in groups.items():
        is_bad = mask[element] & is_foreign
        if is_bad.any():
            place, cell_x = x[is_bad.argmax()].mean(axis=0), cells.points[cells.corners]
            is_near = (cell_x.min(axis=1) <= place) & (place <= cell_x.max(axis=1))
            advice = "fragment bodies with them, or embed them (gmsh)"
            advice = advice if is_near.all(axis=1).any() else "the body there has no named group"
            named = f"{mask[element].sum()} facets named {name!r}"
            refuse(is_bad, x, f"{{bad}} of {named} are not part of the bodies' mesh, the first at {{at}}: {advice}")
    sorted_rows = np.sort(new_numbers[vertices], axis=1)
    return {name: np.unique(sorted_rows[mask[element]], axis=0) for name, mask in groups.items()}
