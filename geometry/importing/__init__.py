"""Joints from files and from meshes of DOLFINx."""
