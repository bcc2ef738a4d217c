"""Compiled laws on arrays of quadrature points of the meshed layer and of S."""
