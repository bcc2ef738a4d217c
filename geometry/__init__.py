"""Meshes with names: builders, joints, inflating S into a layer, distributing over MPI ranks."""

from geometry.builders import block, disc, ring, sandwich, wall
from geometry.domain import Domain
from geometry.gathering import from_dolfinx
from geometry.inflation import inflate
from geometry.joint import GeometryError, Joint, Seam
from geometry.reading import read

__all__ = [
    "Domain",
    "GeometryError",
    "Joint",
    "Seam",
    "block",
    "disc",
    "from_dolfinx",
    "inflate",
    "read",
    "ring",
    "sandwich",
    "wall",
]
