"""Bounds of goals against the continuum, from stresses in exact equilibrium."""
