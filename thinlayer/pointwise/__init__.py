"""Compiled laws, evaluated on arrays of quadrature points of bodies, of the meshed layer and of S."""
