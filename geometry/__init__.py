"""Joints (meshes with named regions and facet sets): builders, import, meshing of layers, distribution over ranks."""

# ruff: noqa: E402, F401
from importlib.util import find_spec

if find_spec("dolfinx_solver"):  # the wheel of DOLFINx: MPI must be loaded before what is linked to it
    import dolfinx_solver

from forms.base import import_optional

_DOLFINX_VERSION = import_optional("dolfinx").__version__
# pip checks no version, as no wheel has the project's name
if tuple(map(int, _DOLFINX_VERSION.split(".")[:2])) < (0, 9):
    raise ImportError(f"DOLFINx {_DOLFINX_VERSION} is too old; thinlayer needs 0.9 or newer")

from geometry.builders import block, bond_cell, disc, faults, fibre, grains, ring, sandwich, wall
from geometry.importing.reading import read
from geometry.periodic import periodic
