"""Laws that act at points: compiled, on arrays of quadrature points of the meshed layer and of S."""
