"""A lap joint as a mesh file and its description, and the same structure made in a script."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from forms import LinearElastic
from geometry import sandwich
from geometry.joint import Joint
from tests.meshes import blocks_of, write
from thinlayer import Structure, ThinLayer

EPS = 0.4
TEXT = """
mesh = {path = "lap.msh", S = "GLUE", upper = "UPPER"}
units = "mm, MPa"
body = {LOWER = {E = 200e3, nu = 0.3}, UPPER = {E = 70e3, nu = 0.2}}
layer = {E = 3e3, nu = 0.35, eps = 0.4}
[supports]
"RIGHT/LOWER" = 0
"LEFT/UPPER" = {y = 0.001}
[tractions]
"LEFT/UPPER" = [-60, 5]
"LEFT/LAYER" = [0, 0]
[goals]
compliance = true
pull = {kind = "reaction", place = "LEFT", direction = [0, 1]}
"""


def joint() -> Joint:
    """Two plates."""
    return sandwich(20.0, 3.0, 4.0, 3.0, h_S=1.5, cell="quadrilateral")


def save(folder: Path, text: str = TEXT) -> Path:
    """The mesh file lap.msh, and lap.toml; the path of the latter."""
    plates = joint()
    plates = replace(plates, facets={name: plates.facets[name] for name in ("S", "LEFT", "RIGHT")})
    blocks, tags = blocks_of(plates)
    facets = ["GLUE" if name == "S" else name for name in plates.facets]
    names = {name: (k, d) for d, of in ((1, facets), (2, plates.regions)) for k, name in enumerate(of, 1)}
    write(folder / "lap.msh", plates.points, blocks, tags, names)
    (folder / "lap.toml").write_text(text)
    return folder / "lap.toml"


def structure() -> Structure:
    """The structure."""
    steel, other = LinearElastic.young(200e3, 0.3), LinearElastic.young(70e3, 0.2)
    supports = {"RIGHT/LOWER": 0.0, "LEFT/UPPER": {"y": 0.001}}
    body, tractions = {"LOWER": steel, "UPPER": other}, {"LEFT/UPPER": (-60.0, 5.0), "LEFT/LAYER": (0.0, 0.0)}
    return Structure(joint(), body=body, supports=supports, tractions=tractions)


def layer(eps: float = EPS, E: float = 3e3, eigenstrain: float | None = None) -> ThinLayer:
    """The glue."""
    return ThinLayer(LinearElastic.young(E, 0.35), eps, eigenstrain=eigenstrain)
