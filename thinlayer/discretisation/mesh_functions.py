"""Functions on a model's mesh: from values by cell of the joint, or from functions on other meshes."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, geometry
from dolfinx.mesh import Mesh

from forms.interface import Interface
from forms.kinematics import Expr
from geometry.domain import Domain
from geometry.inflating.parting import to_middle
from geometry.joint import Profile
from geometry.refusals import place
from geometry.seam import S
from thinlayer.errors import ModelError
from thinlayer.system.compat import interpolation_points
from thinlayer.system.exchange import communicator

Array = npt.NDArray[np.float64]
INWARDS = 1e-6  # way of a place towards the middle of its cell, so that it is on one side of S, over the distance


def cellwise(domain: Domain, element: tuple[Any, ...], values: npt.NDArray[np.float64]) -> fem.Function:
    """A function given by its degrees of freedom on each cell of the joint, (n_cells, dofs per cell, components)."""
    f = fem.Function(fem.functionspace(domain.mesh, element))
    dofs = f.function_space.dofmap.list
    f.x.array.reshape(-1, values.shape[2])[dofs.ravel()] = domain.on_cells(values).reshape(-1, values.shape[2])
    return f


def relative_thickness(domain: Domain, profile: Profile, name: str = S) -> fem.Function:
    """The thickness profile on a seam, or on S, of degree 1 between vertices; its values elsewhere have no meaning."""
    joint = domain.joint
    return cellwise(domain, ("Lagrange", 1), joint.relative_thickness(profile, name)[joint.corners][..., None])


def director(domain: Domain) -> Expr:
    """Unit normal of S in the cells of the meshed layer, (d,), from the lower to the upper body; zero in bodies."""
    joint, band = domain.joint, domain.joint.band
    assert band is not None
    values = np.zeros((*joint.corners.shape, joint.dim))
    values[-len(band.director) :] = band.director
    n = cellwise(domain, ("DG", 1, (joint.dim,)), values)
    return n / ufl.sqrt(ufl.dot(n, n))


def shift(domain: Domain) -> fem.Function:
    """Displacement (d,) of each place by inflating: rigid for the bodies, away from S for the layer."""
    joint = domain.joint
    return cellwise(domain, ("Lagrange", joint.degree, (joint.dim,)), (joint.points - joint.reference)[joint.cells])


class Middle:
    """S midway between bodies that stand apart.

    Args:
        domain: the mesh.

    Attributes:
        to_s: (d,) how far S is from the places of its facets, on either side.
    """

    def __init__(self, domain: Domain) -> None:
        joint = domain.joint
        self.to_s = cellwise(domain, ("DG", joint.degree, (joint.dim,)), to_middle(joint))

    def thickness(self, sides: Interface) -> Expr:
        """Distance of the bodies along n; S is half of it away from either."""
        return -2 * ufl.dot(sides.upper(self.to_s), sides.n)

    def slope(self, sides: Interface) -> Expr:
        """(d,) gradient of the thickness along S."""
        slope = -2 * ufl.dot(sides.n, sides.upper.gradient(self.to_s))
        return slope - ufl.dot(slope, sides.fibre) * sides.n


def sampled(f: fem.Function, mesh: Mesh, x: Expr, what: str) -> fem.Function:
    """A function on another mesh as one on this mesh, with the other's values at places x (d,) of UFL. Collective.

    It is right to 1e-6 of its changes in a cell.

    Raises:
        ModelError: it is not known at a place; `what` are the first words.
    """
    degree = min(2, f.function_space.element.basix_element.degree)
    own = fem.Function(fem.functionspace(mesh, ("DG", degree, f.ufl_shape)))
    places = places_in_cells(own.function_space, x)
    places = (places + INWARDS * (places.mean(axis=1, keepdims=True) - places)).reshape(-1, mesh.geometry.dim)
    values = _values(f, places)
    missing = communicator(mesh).allgather(places[np.isnan(values).any(axis=1)][:1])
    if any(map(len, missing)):
        raise ModelError(
            f"{what}: a function is unknown at {place(np.concatenate(missing)[0])}; its mesh must cover all"
        )
    own.x.array.reshape(values.shape)[np.asarray(own.function_space.dofmap.list).ravel()] = values
    return own


def places_in_cells(V: fem.FunctionSpace, x: Expr) -> Array:
    """(cells, n, d) what places x (d,) of UFL are at the points of a space in the cells of this rank."""
    mesh, d = V.mesh, V.mesh.geometry.dim
    cells = np.arange(len(V.dofmap.list), dtype=np.int32)
    points = fem.Expression(x + fem.Constant(mesh, np.zeros(d)), interpolation_points(V))
    return np.asarray(points.eval(mesh, cells).reshape(len(cells), -1, d))


def _values(f: fem.Function, x: Array) -> Array:
    """Values (n, m) of a function of m components at places (n, d) of this rank, on any rank; NaN outside its mesh."""
    mesh = f.function_space.mesh
    comm = communicator(mesh)
    every = comm.allgather(np.pad(x, ((0, 0), (0, 3 - x.shape[1]))))
    places = np.concatenate(every)
    tree = geometry.bb_tree(mesh, mesh.topology.dim)
    cells = geometry.compute_colliding_cells(mesh, geometry.compute_collisions_points(tree, places), places)
    first, inside = cells.offsets[:-1], np.diff(cells.offsets) > 0
    values = np.full((len(places), int(np.prod(f.ufl_shape))), np.nan)
    if inside.any():
        values[inside] = f.eval(places[inside], cells.array[first[inside]]).reshape(-1, values.shape[1])
    whole = np.fmax.reduce(comm.allgather(values))
    start = sum(map(len, every[: comm.rank]))
    return np.asarray(whole[start : start + len(x)])
