"""Files for ParaView with all results of a state or a history, written by rank 0."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from xml.sax.saxutils import quoteattr

import pyvista
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

from forms.base import InputError, require
from geometry.parallel import default_comm, on_root
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.state import State
from thinlayer.output.paraview.blocks import make_vtk_blocks
from thinlayer.output.surface import Surface
from thinlayer.solving.history import History, Solution
from thinlayer.system.folder import replace_file
from thinlayer.system.ranks import errors_on_all, require_same

COLLECTION_SUFFIX = ".pvd"


def write(solution: Solution, path: str | Path, *, surface: Surface | None = None) -> None:
    """Write a state, or all states that a history keeps with their times, to files for ParaView. Collective.

    Rank 0 gathers all results and, for the path "run.pvd", writes this file and the folder "run_pvd". Each state has
    these blocks:

    - "bodies": the cells of the bodies. Data of nodes: the displacement "u"; each side of S has its own nodes, so that
      jumps are kept. Data of cells: means of "stress" and of the laws' internal variables, each by its name, with the
      word "internal" before it if the name is that of other data; "von Mises"; "region", the position of the region's
      name in the list "regions" of the field data.
    - "layer", only for a full model: the cells of the meshed layers, with the same data. Also for each cell "seam", the
      position of the seam's name in the list "seams" of the field data.
    - "S", for an interface model, or with `surface`: facets of S, each with its own nodes. Data of nodes: "traction",
      "jump", "normal", the displacements "u_upper" and "u_lower" of both sides, and their mean "u", by which ParaView
      can warp S. "t_N" and "w_N" are the normal components of traction and jump. "t_T" and "w_T" are their tangential
      parts: in 2D the component along (n_2, -n_1), in 3D the vector in S. Under contact laws there are also "slip" and
      the code "contact" of the contact status, which the field data "contact codes" explain. Data of facets: "seam";
      the code "status" of `Surface.status`, which "status codes" explain; means of the layer's internal variables, such
      as "phase".

    Of a scalar field such as a temperature, nodes have "T", and "T_upper" and "T_lower" on S, in place of "u"; cells have
    the vector "flux" in place of "stress"; "flux" and "jump" on S are numbers, without components.

    Vectors have three components, stresses and other tensors six: XX, YY, ZZ, XY, YZ, XZ. "von Mises" is computed from
    the mean stress of a cell. Internal variables that a cell's law does not have are NaN there. A layer with sublayers,
    or with an interface law of order 1, has several points through its thickness on each facet of S. The names of its
    variables are then numbered from the lower face on: "plastic 1", "plastic 2". In a periodic cell, "u" lacks the
    linear displacement of the mean strain (`State.mean_strain`); stresses include the effect of this strain.

    For meshes that do not fit on rank 0, `dolfinx.io.VTXWriter(comm, "run.bp", [state.u])` writes only displacements.

    Args:
        solution: a state or a history.
        path: name of the file, which ends in .pvd.
        surface: for a full model, the surface S of an interface model of the same joint. The block "S" then has the
            traction and jump of the meshed layer. It shows S as drawn, before the joint is opened to the layer's
            thickness. None: a full model has no block "S".

    Raises:
        InputError: not a state or a history; a path that does not end in .pvd; a surface of another joint.
        OSError: the files could not be written; on all ranks.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, fields, solve
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> state = solve(plates.interface(ThinLayer(glue, eps=0.05)))
        >>> fields.write(state, "glue.pvd")  # for ParaView
    """
    comm = solution.model.comm if isinstance(solution, (State, History)) else default_comm()
    with errors_on_all(comm):
        advice = "give a state or a history, as solve and march return"
        require(isinstance(solution, (State, History)), "solution", solution, advice)
        states = [solution] if isinstance(solution, State) else list(solution)
        if not states:
            raise InputError(f"there is nothing to write: {solution!r} has no state")
        advice = "it must be the name of a file that ends in .pvd"
        require(isinstance(path, (str, Path)) and Path(path).suffix == COLLECTION_SUFFIX, "path", path, advice)
        surface_model = surface.model if isinstance(surface, Surface) else states[0].model
        if surface is not None and not (isinstance(surface, Surface) and isinstance(surface_model, InterfaceModel)):
            raise InputError(f"surface is {surface!r:.80}; give Surface(state.model) of an interface model")
        if surface_model.joint is not states[0].model.joint:
            raise InputError("surface is of another joint than the states; give one of the same joint")
    require_same(comm, models=states[0].model.data_hash, states=[state.t for state in states], path=str(path))
    path = Path(path)
    folder = path.with_name(f"{path.stem}_pvd")
    on_root(comm, lambda: _empty_folder(folder))
    paths = [folder / f"{number:0{max(4, len(str(len(states))))}}.vtm" for number in range(len(states))]
    for state, vtm_path in zip(states, paths, strict=True):
        multiblock = make_vtk_blocks(state, surface_model if isinstance(surface_model, InterfaceModel) else None)
        on_root(comm, partial(_write_blocks, multiblock, vtm_path))
    file_attributes = [quoteattr(vtm_path.relative_to(path.parent).as_posix()) for vtm_path in paths]
    entries = [f'timestep="{state.t!r}" file={file}' for state, file in zip(states, file_attributes, strict=True)]
    on_root(comm, lambda: _write_listing(path, "Collection", entries))


def _empty_folder(folder: Path) -> None:
    """Make `folder`, in which `write` stores the files of the states, and delete files that it stored there earlier."""
    folder.mkdir(parents=True, exist_ok=True)
    for old_file in folder.iterdir():
        if re.fullmatch(r"\d+", old_file.name) and old_file.is_dir():
            shutil.rmtree(old_file)
        elif re.fullmatch(r"\d+\.vtm", old_file.name):
            old_file.unlink()


def _write_blocks(multiblock: pyvista.MultiBlock | None, path: Path) -> None:
    """Write the VTK file `path` (.vtm), which lists the blocks, and a file .vtu for each block in a folder next to it.

    VTK composes the files in memory, and Python writes them, as VTK may end the process if the disk is full.
    """
    assert multiblock is not None, "rank 0"
    entries = []
    for number, block in enumerate(multiblock.keys()):
        writer = vtkXMLUnstructuredGridWriter()
        writer.SetInputData(multiblock[block])
        writer.SetDataModeToBinary()
        writer.WriteToOutputStringOn()
        writer.Write()
        file = path.with_suffix("") / f"{path.stem}_{number}.vtu"
        with replace_file(file) as out:
            out.write(writer.GetOutputString().encode())
        entries.append(f'index="{number}" name={quoteattr(block)} file={quoteattr(f"{path.stem}/{file.name}")}')
    _write_listing(path, "vtkMultiBlockDataSet", entries)


def _write_listing(path: Path, list_type: str, entries: Iterable[str]) -> None:
    """Write an XML file in which VTK lists other files.

    Args:
        path: name of the file.
        list_type: VTK's type of the list, "Collection" or "vtkMultiBlockDataSet".
        entries: for each listed file a text with its XML attributes, such as `timestep="0" file="run_pvd/0000.vtm"`.
    """
    xml_lines = "".join(f"    <DataSet {entry}/>\n" for entry in entries)
    text = f'<VTKFile type="{list_type}" version="1.0">\n  <{list_type}>\n{xml_lines}  </{list_type}>\n</VTKFile>\n'
    with replace_file(path) as file:
        file.write(f'<?xml version="1.0"?>\n{text}'.encode())
