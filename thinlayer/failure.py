"""The error of a solve that did not converge."""

from __future__ import annotations

from typing import Any


class SolveError(RuntimeError):
    """A solve that did not converge: the reason, the last residual, and what to try.

    Attributes:
        history: of a march, its accepted steps.
        residuals: of a contact solve, the residual at every step over the forces.
    """

    def __init__(self, message: str, history: Any = None, residuals: tuple[float, ...] = ()) -> None:
        super().__init__(message)
        self.history, self.residuals = history, residuals
