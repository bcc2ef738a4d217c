"""Shapes of joints, which are drawn and meshed with gmsh, or meshed as grids; cells are smaller near S."""
