"""Joints from mesh files and from DOLFINx meshes."""
