"""Solvers under contact laws: condensed, multigrid and the relaxation of the paper."""
