"""Functions on other meshes, such as computed temperatures, at the places of a model."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, geometry
from ufl.algorithms.analysis import extract_coefficients

from forms.kinematics import Expr
from geometry.errors import place
from thinlayer.compiling.compat import interpolation_points
from thinlayer.discretisation.loads import Coordinates
from thinlayer.errors import ModelError
from thinlayer.parallel.communicator import communicator

Array = npt.NDArray[np.float64]
INWARDS = 1e-6  # way of a place towards the middle of its cell, so that it is on one side of S, over the distance


def on_mesh(given: Expr, at: Coordinates, what: str) -> Expr:
    """An expression in which functions on other meshes are replaced by functions on this one. Collective.

    Each has the values of the other at the places of the joint, to 1e-6 of its changes in a cell.

    Raises:
        ModelError: a function is not known at a place.
    """
    found = [f for f in extract_coefficients(given) if isinstance(f, fem.Function)]
    others = [f for f in found if f.function_space.mesh is not at.mesh]
    return ufl.replace(given, {f: _sampled(f, at, what) for f in others}) if others else given


def _sampled(f: fem.Function, at: Coordinates, what: str) -> fem.Function:
    mesh, d = at.mesh, at.mesh.geometry.dim
    V = fem.functionspace(mesh, ("DG", min(2, f.function_space.element.basix_element.degree)))
    sampled, cells = fem.Function(V), np.arange(len(V.dofmap.list), dtype=np.int32)
    points = fem.Expression(at.x + fem.Constant(mesh, np.zeros(d)), interpolation_points(V))
    x = points.eval(mesh, cells).reshape(len(cells), -1, d)
    x = x + INWARDS * (x.mean(axis=1, keepdims=True) - x)
    values = _values(f, x.reshape(-1, d))
    missing = communicator(mesh).allgather(x.reshape(-1, d)[np.isnan(values)][:1])
    if any(map(len, missing)):
        raise ModelError(
            f"{what}: a function is not known at {place(np.concatenate(missing)[0])}; its mesh must cover all"
        )
    sampled.x.array[np.asarray(V.dofmap.list).ravel()] = values
    return sampled


def _values(f: fem.Function, x: Array) -> Array:
    """Values (n,) of a scalar function at places (n, d) of this rank, on whatever rank they are; NaN outside its mesh."""
    mesh = f.function_space.mesh
    comm = communicator(mesh)
    every = comm.allgather(np.pad(x, ((0, 0), (0, 3 - x.shape[1]))))
    places = np.concatenate(every)
    tree = geometry.bb_tree(mesh, mesh.topology.dim)
    cells = geometry.compute_colliding_cells(mesh, geometry.compute_collisions_points(tree, places), places)
    first, here = cells.offsets[:-1], np.diff(cells.offsets) > 0
    values = np.full(len(places), np.nan)
    if here.any():
        values[here] = f.eval(places[here], cells.array[first[here]]).reshape(-1)
    whole = np.fmax.reduce(comm.allgather(values))
    start = sum(map(len, every[: comm.rank]))
    return np.asarray(whole[start : start + len(x)])
