"""Orders of nodes: along the pieces of S, and through the bodies for a factorisation."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import linalg

from thinlayer.discretisation.contact_nodes import Array
from thinlayer.solving.contact.problem import ContactProblem

Indices = npt.NDArray[Any]

SLOPE = 1.2  # slope, relative to S, of the front along which nodes are numbered
SAMPLE = 64  # number of nodes whose edges show the diagonals of the cells


def chains_of(problem: ContactProblem, moving: Indices) -> list[tuple[Indices, Array]]:
    """For each piece of S, its moving nodes in order and their arc lengths; [] in three dimensions."""
    nodes, joint = problem.nodes, problem.equations.model.joint
    if nodes.dim != 2:
        return []
    number = dict(zip(nodes.numbers[moving].tolist(), range(len(moving)), strict=True))
    neighbours: list[list[int]] = [[] for _ in number]
    edges: list[list[int]] = joint.table.vertices[joint.surface_rows].tolist()  # type: ignore[assignment]
    for a, b in edges:
        if a in number and b in number:
            neighbours[number[a]].append(number[b])
            neighbours[number[b]].append(number[a])
    x, chains = nodes.x[moving], []
    left = set(range(len(moving)))
    ends = [k for k, near in enumerate(neighbours) if len(near) != 2]
    for first in [*ends, *range(len(moving))]:  # rings have no ends
        if first not in left:
            continue
        left.discard(first)
        chain, here = [first], first
        while (following := next((k for k in neighbours[here] if k in left), None)) is not None:
            left.discard(following)
            chain.append(following)
            here = following
        places = np.array(chain)
        steps = np.linalg.norm(np.diff(x[places], axis=0), axis=1)
        chains.append((places, np.concatenate([[0.0], np.cumsum(steps)]).astype(float)))
    return chains


def oblique_order(problem: ContactProblem) -> Indices:
    """Nodes of the bodies in the order of a front that is oblique to S and moves away from it.

    With a Schur complement MUMPS orders by minimum degree and decides ties by the numbers. On grids bad numbers cost twice
    the work; these come close to the best ordering without a complement. The front follows the diagonals of the cells.
    """
    nodes = problem.nodes
    n = problem.A.getSize()[0] // nodes.dim
    x = nodes.surface.V.tabulate_dof_coordinates()[:n, : nodes.dim]
    normal = nodes.weights @ nodes.frames[:, -1]
    size = float(np.linalg.norm(normal))
    normal = np.asarray(normal / size if size > 1e-6 * nodes.weights.sum() else np.eye(nodes.dim)[-1])
    tangents = linalg.null_space(normal[None]).T
    height = (x - nodes.x.mean(axis=0)) @ normal
    key = SLOPE * np.abs(height)
    rows = np.linspace(0, n - 1, min(n, SAMPLE)).astype(int)
    edges = np.concatenate([x[problem.A.getRow(int(r) * nodes.dim)[0][:: nodes.dim] // nodes.dim] - x[r] for r in rows])
    for tangent in tangents:
        lean = np.sign((edges @ tangent) @ (edges @ normal)) or 1.0
        key += lean * np.sign(height) * (x @ tangent)
    return np.argsort(key, kind="stable")
