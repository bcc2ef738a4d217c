"""Shapes that gmsh draws and meshes: boxes, rings and discs, graded towards S."""
