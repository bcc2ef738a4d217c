"""Names and vectors of a description against the mesh: what does not fit is refused before the mesh is distributed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from forms.base import unknown
from geometry.joint import Joint
from geometry.seam import LAYER, S
from geometry.topology import is_tensor
from thinlayer.describing.description import Description
from thinlayer.describing.section import DescriptionError

AXES = "xyzn"


def require_fit(given: Description, joint: Joint) -> None:
    """Raise DescriptionError for a name that the mesh does not have, or a vector of another dimension, with its place."""
    section, d = given.section, joint.dim
    sides = [name for name in joint.facets if name not in joint.seams]
    seams = [S, *joint.seams]

    def name(one: str | None, known: Iterable[str], kind: str, *keys: str) -> None:
        if one is not None and one not in known:
            section.refuse(unknown(kind, one, known), *keys)

    def side(one: str, *keys: str) -> None:
        whole, _, part = one.partition("/")
        if whole in seams:
            section.refuse(f"{whole!r} is where the layer is; name another set of facets", *keys)
        name(whole, sides, "set of facets", *keys)
        if part or "/" in one:
            name(part, [*joint.bodies, LAYER], f"part of {whole!r}", *keys)

    def vector(one: Any, *keys: str) -> None:
        if len(one) != d:
            section.refuse(f"{list(one)} has {len(one)} components; the mesh has {d} dimensions", *keys)

    for key, table, known in (("body", given.body, joint.bodies), ("layer", given.layer, [*joint.seams])):
        for one in table:
            name(one, known, "region" if key == "body" else "seam", key)
        missing = [one for one in known if one not in table]
        if missing and None not in table:
            section.refuse(f"{missing[0]!r} has no law; {key} needs one for each of {', '.join(known)}", key)
    for place, support in given.supports.items():
        shown = place if isinstance(place, str) else f"({', '.join(f'{c:g}' for c in place)})"
        if isinstance(place, str):
            side(place, "supports", place)
        else:
            vector(place, "supports", shown)
        for axis in support if isinstance(support, dict) else ():
            name(axis, [*AXES[:d], "n"], "component", "supports", shown)
    for one, load in given.tractions.items():
        side(one, "tractions", one)
        if not isinstance(load, dict):
            vector(load, "tractions", one)
    if isinstance(given.body_force, dict):
        for one, force in given.body_force.items():
            name(one, [*joint.bodies, *seams], "region or seam", "body_force")
            vector(force, "body_force", one)
    elif given.body_force is not None:
        vector(given.body_force, "body_force")
    for number, load in enumerate(given.loads, 1):
        keys = ("loads", str(number))
        for key in ("place", "force"):
            if key in load.arguments:
                vector(load.arguments[key], *keys, key)
        for key in ("first", "second"):
            if key in load.arguments:
                side(load.arguments[key], *keys, key)
        name(load.arguments.get("body"), joint.bodies, "region", *keys, "body")
    for one, goal in given.goals.items():
        for key in ("direction", "x"):
            if key in goal.arguments:
                vector(goal.arguments[key], "goals", one, key)
        name(goal.arguments.get("seam"), seams, "seam", "goals", one, "seam")
        _require_held(given, goal.arguments.get("place"), joint, ("goals", one, "place"))
    if d == 3 and given.plane not in (None, "strain"):
        section.refuse(f"plane = {given.plane!r} is for meshes in two dimensions", "plane")
    if given.element is not None and (given.element == "P2") == is_tensor(joint.cell_type):
        allowed = "Q2, S2" if is_tensor(joint.cell_type) else "P2"
        section.refuse(f"{given.element} is not for {joint.cell_type} cells; allowed: {allowed}", "element")


def _require_held(given: Description, place: str | None, joint: Joint, keys: tuple[str, ...]) -> None:
    """Raise DescriptionError unless something holds the place of a reaction."""
    if place is None:
        return
    held = [one for one in given.supports if isinstance(one, str)] + [*joint.base_seams]
    held += [S] if joint.base_seams else []
    if place not in held and not any(one.split("/")[0] == place for one in held):
        raise DescriptionError(f"{given.section.where(*keys)}: {unknown('support', place, held)}")
