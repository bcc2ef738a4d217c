"""Shapes that are drawn and meshed with gmsh or on grids, with smaller cells towards S."""
