"""Template of an input file of `estimate`: it has the names in a mesh file, and a "?" for each value to fill in."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from string import Template

from geometry.importing.naming import NamedGroups
from geometry.importing.reading import read_groups
from geometry.parallel import default_comm, on_root

quote = partial(json.dumps, ensure_ascii=False)  # a text as a string or a key of TOML


def template_text(mesh: Path) -> str:
    """Return the text of an input file in TOML that uses the names in a mesh file. Collective.

    A "?" stands for each value that the user must fill in; a file that still has one is refused when it is read.

    Args:
        mesh: path of the mesh file.

    Raises:
        InputError: the mesh file cannot be read.
    """
    return on_root(default_comm(), partial(read_groups, mesh, partial(_fill_template, mesh)))


def _fill_template(mesh: Path, groups: NamedGroups) -> str:
    groups = groups.with_described_facets()
    adjacent = ((name, groups.adjacent_cells(name)) for name in groups.facets)
    inside = {name: groups.region_names_of_cells(cells) for name, cells in adjacent if cells.size and cells.min() >= 0}
    seam_text, hint = _seam_entries(inside, ", ".join(groups.facets))
    layers = "\n\n".join(
        f'[layer{name}]\nlaw = "LinearElastic"\nE = "?"\nnu = "?"\neps = "?"  # thickness'
        for name in ([f".{quote(name)}" for name in inside] if len(inside) > 1 else [""])
    )
    moduli_text, empty_vector = 'E = "?"\nnu = "?"', ["?"] * groups.cells.points.shape[1]
    outer_names = [quote(name) for name in groups.facets if name not in inside]
    bodies = "\n\n".join(f"[body.{quote(name)}]\n{moduli_text}" for name in groups.region_masks)
    supports, loaded = ("\n".join(f"{name} = {quote(value)}" for name in outer_names) for value in ("?", empty_vector))
    values = {"bodies": bodies, "layers": layers, "held": supports, "loaded": loaded, "seam": seam_text, "words": hint}
    text = Path(__file__).with_suffix(".toml").read_text(encoding="utf-8").rstrip()
    return Template(text).substitute(values, path=quote(str(mesh)))


def _seam_entries(inner_regions: dict[str, list[str]], names: str) -> tuple[str, str]:
    """Return the entries of the input file that say where the layer is, and a comment that explains them.

    Args:
        inner_regions: name of a facet set that lies wholly inside the bodies -> names of the regions that it touches.
        names: names of all facet sets, joined by commas.

    Returns:
        The entries, which are arguments of `geometry.read` in TOML; and the comment.
    """
    if len(inner_regions) == 1:
        ((name, regions),) = inner_regions.items()
        side_text = f"upper = {quote(regions[-1])}" if len(regions) > 1 else 'direction = "?"'
        comment = f"S is the only facet set inside the bodies; it touches {', '.join(regions)}"
        return f"S = {quote(name)}, {side_text}", comment
    if inner_regions:
        regions_texts = {name: quote(regions if len(regions) == 2 else "?") for name, regions in inner_regions.items()}
        sides_text = ", ".join(f"{quote(name)} = {regions_text}" for name, regions_text in regions_texts.items())
        comment = "S has the facet sets inside the bodies: [lower region, upper region], or a vector upwards"
        return f"S = {{{sides_text}}}", comment
    candidates = names or "none; with lower and upper alone S is all between these regions"
    return 'S = "?", upper = "?"', f"S is where the layer is, upper a region above it; facet sets: {candidates}"
