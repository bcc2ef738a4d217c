"""A linear solver that keeps its factor, or the symbolic part of it, for later steps and models."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any

from petsc4py import PETSc

from thinlayer.solving.options import PREFIX


class Factor:
    """A KSP and the matrix that it has factored. Collective.

    Attributes:
        ksp: the solver; None: there is none.
        of: what the factored matrix depends on; None: not known.
    """

    def __init__(self) -> None:
        self.ksp: PETSc.KSP | None = None
        self.of: Hashable = None
        self._options: dict[str, Any] = {}

    def renew(self, A: PETSc.Mat, of: Hashable, tell: Callable[[PETSc.KSP, PETSc.Mat], None]) -> bool:
        """Take another matrix, which is factored by the next solve.

        Args:
            A: the matrix.
            of: what it depends on.
            tell: function that tells a solver what is known of the matrix, see `Equations.tell`.

        Returns:
            Whether the solver stays: it then orders the unknowns anew only if A has another nonzero pattern.
        """
        options = {name: value for name, value in PETSc.Options().getAll().items() if name.startswith(PREFIX)}
        stays = self.ksp is not None and options == self._options and self.ksp.getPC().getType() != "fieldsplit"
        if not stays:
            self.destroy()
            self.ksp = PETSc.KSP().create(A.comm)
            self.ksp.setOptionsPrefix(PREFIX)
        assert self.ksp is not None
        self.ksp.setOperators(A)
        if not stays:
            self.ksp.setFromOptions()
        tell(self.ksp, A)
        self._options, self.of = options, of
        return stays

    def destroy(self) -> None:
        """Free the solver and its factor."""
        if self.ksp is not None:
            self.ksp.destroy()
        self.ksp = self.of = None
