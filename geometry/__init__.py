"""Joints (meshes with named regions and facet sets): builders, import, meshing of layers, distribution over ranks."""

# ruff: noqa: F401
from geometry.builders import block, bond_cell, disc, faults, fibre, grains, ring, sandwich, wall
from geometry.importing.reading import read
from geometry.periodic import periodic
