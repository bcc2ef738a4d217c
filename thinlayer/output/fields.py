"""Files for ParaView: all that a state has, gathered on rank 0, or displacements alone, written by all ranks."""

from __future__ import annotations

import errno
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from xml.sax.saxutils import quoteattr

import dolfinx
import pyvista

from forms.base import InputError
from geometry.parallel import on_root, world
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.state import State
from thinlayer.output.blocks import blocks
from thinlayer.output.grid import nodal_displacement
from thinlayer.output.surface import Surface
from thinlayer.solving.history import History, Solution
from thinlayer.system.ranks import on_all, require_same

# approximate size of a node in a file: its mesh, once; its values, each time
BYTES = {".bp": (128, 24), ".pvd": (0, 200)}
VTX, VTK = ".bp", ".pvd"


def write(solution: Solution, path: str | Path, *, surface: Surface | None = None) -> None:
    """Write a state, or all states that a history keeps with their times, for ParaView. Collective.

    A path that ends in .pvd: all that is known. Rank 0 gathers it and writes "run.pvd" and the folder "run_pvd". Blocks:

    - "bodies": "u" at the nodes (those on S are double, so that jumps are kept); means over each cell: "stress",
      "von Mises", the internal variables of laws by their names; "region", its position in the field "regions".
    - "layer", of a full model: the same, and "seam", its position in the field "seams".
    - "S", of an interface model, or if a surface is given, facets whose nodes are their own. At the nodes: "traction",
      "jump", "normal", "u_upper", "u_lower", "u" (their mean, to warp S by), "t_N", "w_N", "t_T", "w_T" (in 2D the
      component along (n_2, -n_1), in 3D the vector in S); under contact laws "contact" (the field "contact codes" says
      what is what) and "slip". On facets: "seam", "status" (see `Surface.status` and the field "status codes"), means of
      the layer's internal variables, such as "phase".

    Vectors have three components, stresses and other tensors six: XX, YY, ZZ, XY, YZ, XZ. "von Mises" is that of the mean
    stress of a cell. Internal variables that a cell's law does not have are NaN there; where there are several points
    through the thickness on S (sublayers, order 1) they are numbered from below: "plastic 1", "plastic 2". In a periodic
    cell u is beside the motion by the mean strain (`State.mean_strain`); stresses are whole.

    A path that ends in .bp: displacements alone, written in parallel by ADIOS2's VTX; for meshes that rank 0 cannot hold.

    Args:
        solution: what to write.
        path: file.
        surface: S of an interface model of the same joint, to which a full model's traction and jump are brought, where
            S was before it was inflated; its layer's status and internal variables are in the block "layer".

    Raises:
        InputError: no state, no name of a file, or another ending; a surface of another joint, or beside a .bp file;
            this DOLFINx has no ADIOS2, which VTX needs.
        OSError: the files could not be written; on all ranks.
    """
    comm = solution.model.comm if isinstance(solution, (State, History)) else world()
    with on_all(comm):
        states = _states(solution)
        if not isinstance(path, (str, Path)):
            raise InputError(f"fields are written to a file, not to {path!r}; give its name, which ends in .pvd or .bp")
        path = Path(path)
        if path.suffix not in BYTES:
            raise InputError(f"cannot write {str(path)!r}; allowed endings: .pvd (VTK, all fields), .bp (VTX, u)")
        if path.suffix == VTX and not dolfinx.has_adios2:
            raise InputError("VTX needs a DOLFINx with ADIOS2; write a .pvd file instead")
        model = surface.model if isinstance(surface, Surface) else states[0].model
        if surface is not None and not (isinstance(surface, Surface) and isinstance(model, InterfaceModel)):
            raise InputError(f"surface is {surface!r:.80}; give Surface(limit.model), of an interface model")
        if surface is not None and (path.suffix == VTX or surface.model.joint is not states[0].model.joint):
            raise InputError("a surface is for .pvd files, and of an interface model of the same joint as the states")
    require_same(comm, models=states[0].model.mark, states=[state.t for state in states], path=str(path))
    nodes = states[0].u.function_space.dofmap.index_map.size_global
    once, each = BYTES[path.suffix]
    on_root(comm, lambda: _make_room(path, nodes * (once + each * len(states))))
    if path.suffix == VTX:
        _write_vtx(states, path)
        return
    _write_vtk(states, path, model if isinstance(model, InterfaceModel) else None)


def _states(solution: Solution) -> list[State]:
    """The states to write."""
    if not isinstance(solution, (State, History)):
        raise InputError(f"fields are written of a state or a history, as solve and march return, not of {solution!r}")
    states = [solution] if isinstance(solution, State) else list(solution)
    if not states:
        raise InputError(f"there is nothing to write: {solution!r} has no state")
    return states


def _make_room(path: Path, size: int) -> None:
    """Make the folder of files of about this size; raises OSError where they cannot be written."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if shutil.disk_usage(path.parent).free < size or not os.access(path.parent, os.W_OK):
        raise OSError(errno.ENOSPC, "the disk is full, or not to be written", str(path))
    if path.suffix == VTK:
        path.open("ab").close()
    elif path.exists() and not path.is_dir():
        raise FileExistsError(errno.EEXIST, "there is a file of this name, not a folder of a writer", str(path))


# ---------------------------------------------------------------- displacements, in parallel
def _write_vtx(states: list[State], path: Path) -> None:
    comm, u = states[0].model.comm, nodal_displacement(states[0])
    problem = None
    try:
        with dolfinx.io.VTXWriter(comm, path, [u]) as file:
            for state in states:
                u.x.array[:] = nodal_displacement(state).x.array
                file.write(state.t)
    except Exception as error:
        problem = f"{type(error).__name__}: {error}"
    if problem := next(filter(None, comm.allgather(problem)), None):
        raise OSError(f"{path} could not be written: {problem}")


# ---------------------------------------------------------------- all fields, gathered
def _write_vtk(states: list[State], path: Path, model: InterfaceModel | None) -> None:
    comm, folder = states[0].model.comm, path.with_name(f"{path.stem}_pvd")
    on_root(comm, lambda: _clear(folder))
    digits = max(4, len(str(len(states))))
    names = [folder / f"{number:0{digits}}.vtm" for number in range(len(states))]
    for state, name in zip(states, names, strict=True):
        found = blocks(state, model)
        on_root(comm, _saving(found, name))
    times = {name.relative_to(path.parent): state.t for name, state in zip(names, states, strict=True)}
    on_root(comm, lambda: _list(path, times))


def _clear(folder: Path) -> None:
    """Make the folder, without the files of an earlier writing."""
    folder.mkdir(exist_ok=True)
    for old in folder.iterdir():
        if re.fullmatch(r"\d+", old.name) and old.is_dir():
            shutil.rmtree(old)
        elif re.fullmatch(r"\d+\.vtm", old.name):
            old.unlink()


def _saving(found: pyvista.MultiBlock | None, name: Path) -> Callable[[], None]:
    def save() -> None:
        assert found is not None, "rank 0"
        found.save(name)
        _require_whole(name)

    return save


def _list(path: Path, times: dict[Path, float]) -> None:
    """The file that names those of all times."""
    rows = [f'    <DataSet timestep="{t!r}" file={quoteattr(name.as_posix())}/>' for name, t in times.items()]
    lines = ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="0.1">', "  <Collection>", *rows]
    path.write_text("\n".join([*lines, "  </Collection>", "</VTKFile>", ""]))
    _require_whole(path)


def _require_whole(path: Path) -> None:
    """Raise OSError unless a file and those that it names end as they should: VTK does not notice a full disk."""
    names = re.findall(r'file="([^"]*)"', _whole(path))
    for name in names if path.suffix != VTK else ():
        _whole(path.parent / name)


def _whole(path: Path) -> str:
    """The text of a file of VTK's, but for one with data, which is not looked for names."""
    with path.open("rb") as file:
        end = file.seek(0, os.SEEK_END)
        file.seek(max(end - 100, 0))
        if not file.read().rstrip().endswith(b"</VTKFile>"):
            raise OSError(errno.EIO, "the file is not whole", str(path))
        file.seek(0)
        return "" if path.suffix == ".vtu" else file.read().decode()
