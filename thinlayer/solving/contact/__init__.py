"""Solvers of models with contact laws: by condensation, by multigrid, and by the relaxation method of the paper."""
