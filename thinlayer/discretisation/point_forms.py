"""Virtual work of loads at points and along lines, as forms: densities on single cells whose work is that of the load."""

from __future__ import annotations

from collections.abc import Iterable

import basix
import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl

from forms.kinematics import Expr
from geometry.domain import Domain
from geometry.joint import Joint
from thinlayer.discretisation.given import Coordinates
from thinlayer.discretisation.joint_fields import cellwise
from thinlayer.discretisation.point_loads import Concentrated, Nodes

Array = npt.NDArray[np.float64]


class ConcentratedForms:
    """Virtual work of loads at points, a UFL form: sum over cells of int F . v g dX = F . v at the load's place.

    g is the element's polynomial on the reference cell for which that holds for all displacements v of the cell.

    Args:
        domain: the domain.
        joint: the joint before inflating, whose cells are the first of the domain's.
        degree: of the displacements.
        at: coordinates and time.
    """

    def __init__(self, domain: Domain, joint: Joint, degree: int, at: Coordinates) -> None:
        self.domain, self.joint, self.at, self._degree = domain, joint, at, degree
        kind = basix.CellType[joint.cell_type]
        self._ufl = basix.ufl.element("DG", domain.mesh.basix_cell(), degree)
        self._element = self._ufl.basix_element
        X, w = basix.make_quadrature(kind, 2 * degree)
        phi = self._element.tabulate(0, X)[0, :, :, 0]
        self._inverse = np.linalg.inv(phi.T @ (w[:, None] * phi))
        mesh = domain.mesh
        dx = ufl.Measure("dx", domain=mesh, subdomain_data=domain.cell_tags, metadata={"quadrature_degree": 2 * degree})
        self._dx = dx(domain.cell_values(*joint.bodies))
        self._jacobian = abs(ufl.JacobianDeterminant(mesh))

    def terms(self, load: Concentrated) -> list[tuple[Expr, ufl.Measure]]:
        """Pairs of a load per volume (d,) and a measure. Collective."""
        nodes, d = load.nodes(self.joint), self.joint.dim
        along = nodes.in_space(self.joint, self.domain.joint.cell_points)[1]
        lengths = (
            np.ones((*along.shape[:2], 1)) if nodes.along is None else np.linalg.norm(along, axis=2, keepdims=True)
        )
        given = self.at.given(load.force, load.what, (d,))
        return [
            (at.given(load.force, load.what, (d,)).expression * g[0], measure)
            for at, g, measure in self.at_nodes(nodes, lengths, given.varies)
        ]

    def at_nodes(self, nodes: Nodes, weights: Array, split: bool) -> list[tuple[Coordinates, Expr, ufl.Measure]]:
        """Places, densities g (c,) and measures: the sum over them of int g f dX is that over nodes of weights times f.

        Args:
            nodes: the nodes, without `along`.
            weights: (n, k, c).
            split: whether nodes in one cell are parted, so that each has its place as the argument of loads; else the
                places have no meaning.
        """
        n, k, c = weights.shape
        d, joint, found = self.joint.dim, self.domain.joint, []
        kept = joint.band is not None and joint.band.bodies == "kept"
        x = nodes.in_space(joint, joint.reference[joint.cells] if kept else joint.cell_points)[0]
        wholes = [(np.arange(n), slice(None))]
        for some, column in [(r, slice(j, j + 1)) for r in _rounds(nodes.cells) for j in range(k)] if split else wholes:
            one = Nodes(nodes.cells[some], nodes.points[some, column])
            element = basix.ufl.blocked_element(self._ufl, shape=(c,))
            g = cellwise(self.domain, element, self._densities(one, weights[some, column])) / self._jacobian
            places = np.zeros((len(self.domain.joint.cells), 1, d))
            places[one.cells] = x[some, column][:, :1]
            at = self.at.moved(cellwise(self.domain, ("DG", 0, (d,)), places)) if split else self.at
            found.append((at, g, self._dx))
        return found

    def _densities(self, nodes: Nodes, weights: Array) -> Array:
        """(n_cells, m, ...) degrees of freedom of g times weights (n, k, ...), summed over the nodes of each cell."""
        out = np.zeros((len(self.domain.joint.cells), len(self._inverse), *weights.shape[2:]))
        phi = self._element.tabulate(0, nodes.points.reshape(-1, self.joint.dim))[0, :, :, 0]
        g = (phi @ self._inverse.T).reshape(*nodes.points.shape[:2], -1)
        np.add.at(out, nodes.cells, np.einsum("nk...,nkm->nm...", weights, g))
        return out


def _rounds(cells: npt.NDArray[np.int64]) -> Iterable[npt.NDArray[np.int64]]:
    """Rows of nodes in groups in which each cell is at most once."""
    order = np.argsort(cells, kind="stable")
    first = np.searchsorted(cells[order], cells[order])
    turn = np.arange(len(cells)) - first
    return [order[turn == k] for k in range(int(turn.max(initial=-1)) + 1)]
