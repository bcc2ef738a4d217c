"""Observed orders: of errors, and of the tangent of a model's balance of forces."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from thinlayer import Table
from thinlayer.parts.part import TimeStep
from thinlayer.solving.solve import Solver


def observed_orders(sizes: Iterable[float], errors: Iterable[float]) -> list[float | None]:
    """Order of errors between each size and the one before."""
    return Table.of({"h": list(sizes), "error": list(errors)}).orders("error", of="h")


def taylor_order(solver: Solver, size: float = 1e-2, theta: float = 1.0, longest: float = 1.0) -> float:
    """Smallest order in h of |R(x + h d) - R(x) - h A d| at some unknowns x, for a direction d; inf where it vanishes."""
    equations = solver.equations
    equations.begin(TimeStep(solver.rest_state(0.0), 0.1, 0.1, theta))
    random = np.random.default_rng(1)
    x, d, at, there, linear = (equations.create_vector() for _ in range(5))
    x.array[:] = size * random.standard_normal(x.getLocalSize())
    d.array[:] = size * random.standard_normal(d.getLocalSize())
    equations.residual(x, at)
    equations.tangent().mult(d, linear)
    errors = []
    for h in longest * np.array([1.0, 0.5, 0.25, 0.125]):
        moved = x.copy()
        moved.axpy(h, d)
        equations.residual(moved, there)
        there.axpy(-1.0, at)
        there.axpy(-h, linear)
        errors.append(there.norm() / linear.norm())
        moved.destroy()
    if max(errors) < 1e-12:
        return float("inf")
    return float(np.log2(np.array(errors[:-1]) / errors[1:]).min())
