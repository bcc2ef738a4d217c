"""Structures whose layers are left out of the mesh, and what that costs, beside what the estimate says of it."""
