"""Template of an input file of `estimate`: it has the names in a mesh file, and a "?" for each value to fill in."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from string import Template

from geometry.importing.naming import NamedGroups
from geometry.importing.reading import read_groups
from geometry.parallel import default_comm, on_root

quoted = partial(json.dumps, ensure_ascii=False)  # a text as a string or a key of TOML


def template(mesh: Path) -> str:
    """Return the text of an input file in TOML that uses the names in a mesh file. Collective.

    A "?" stands for each value that the user must fill in; a file that still has one is refused when it is read.

    Args:
        mesh: path of the mesh file.

    Raises:
        InputError: the mesh file cannot be read.
    """
    return on_root(default_comm(), partial(read_groups, mesh, partial(_filled, mesh)))


def _filled(mesh: Path, named: NamedGroups) -> str:
    adjacent = {name: named.adjacent_cells(name) for name in named.facets}
    inside = {name: named.regions_at(cells) for name, cells in adjacent.items() if cells.size and (cells >= 0).all()}
    seam, words = _seam(inside, ", ".join(named.facets))
    layers = "\n\n".join(
        f'[layer{name}]\nlaw = "LinearElastic"\nE = "?"\nnu = "?"\neps = "?"  # thickness'
        for name in ([f".{quoted(name)}" for name in inside] if len(inside) > 1 else [""])
    )
    moduli, vector = 'E = "?"\nnu = "?"', ["?"] * named.cells.points.shape[1]
    sides = [quoted(name) for name in named.facets if name not in inside]
    bodies = "\n\n".join(f"[body.{quoted(name)}]\n{moduli}" for name in named.regions)
    supports, loaded = ("\n".join(f"{name} = {quoted(value)}" for name in sides) for value in ("?", vector))
    values = {"bodies": bodies, "layers": layers, "held": supports, "loaded": loaded, "seam": seam, "words": words}
    text = Path(__file__).with_suffix(".toml").read_text(encoding="utf-8").rstrip()
    return Template(text).substitute(values, path=quoted(str(mesh)))


def _seam(inside: dict[str, list[str]], names: str) -> tuple[str, str]:
    """Return the entries of the input file that say where the layer is, and a comment that explains them.

    Args:
        inside: name of a facet set that lies wholly inside the bodies -> names of the regions that it touches.
        names: names of all facet sets, joined by commas.

    Returns:
        The entries, which are arguments of `geometry.read` in TOML; and the comment.
    """
    if len(inside) == 1:
        ((name, touched),) = inside.items()
        side = f"upper = {quoted(touched[-1])}" if len(touched) > 1 else 'direction = "?"'
        words = f"S is the only facet set inside the bodies; it touches {', '.join(touched)}"
        return f"S = {quoted(name)}, {side}", words
    if inside:
        pairs = {name: quoted(touched if len(touched) == 2 else "?") for name, touched in inside.items()}
        sides = ", ".join(f"{quoted(name)} = {pair}" for name, pair in pairs.items())
        words = "S has the facet sets inside the bodies: [lower region, upper region], or a vector upwards"
        return f"S = {{{sides}}}", words
    candidates = names or "none; with lower and upper alone S is all between these regions"
    return 'S = "?", upper = "?"', f"S is where the layer is, upper a region above it; facet sets: {candidates}"
