"""Meshes with names: builders, joints, inflating S into a layer, distributing over MPI ranks."""

from geometry.builders import block, sandwich
from geometry.domain import Domain
from geometry.inflation import inflate
from geometry.joint import GeometryError, Joint

__all__ = ["Domain", "GeometryError", "Joint", "block", "inflate", "sandwich"]
