"""Finders of equilibria under contact laws: condensed, multigrid and the relaxation of the paper."""
