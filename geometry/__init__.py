"""Joints, meshes with named parts: builders, import of files, inflating S into layers, distribution over MPI ranks."""

# ruff: noqa: F401
from geometry.builders import block, bond_cell, disc, faults, fibre, grains, ring, sandwich, wall
from geometry.importing.reading import read
from geometry.periodic import periodic
