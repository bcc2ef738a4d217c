"""Names and vectors of a description against the mesh: what does not fit is refused before the mesh is distributed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from forms.base import unknown
from geometry.joint import Joint
from geometry.seam import LAYER, S
from geometry.topology import is_tensor
from thinlayer.describing.description import Description
from thinlayer.describing.section import History, Section

LEAST_EPS = 1e-9  # thickness over the size of the bodies: below, rounding is larger than its effect


def require_fit(given: Description, joint: Joint) -> None:
    """Raise DescriptionError for a name that the mesh does not have, or a vector of another dimension, with its place."""
    fit = _Fit(given.section, joint)
    fit.laws("body", "region", given.body, joint.bodies)
    fit.laws("layer", "seam", given.layer, [*joint.seams])
    _thicknesses(fit, given)
    _supports(fit, given)
    _loads(fit, given)
    _goals(fit, given)
    if given.tolerance and None not in given.layer:
        fit.section.refuse("a thickness is sought of one layer for all seams; give [layer] without names", "tolerance")
    if joint.dim == 3 and given.plane not in (None, "strain"):
        fit.section.refuse(f"{given.plane} is for meshes in two dimensions", "plane")
    allowed = ("Q2", "S2") if is_tensor(joint.cell_type) else ("P2",)
    if given.element not in (None, *allowed):
        fit.section.refuse(
            f"{given.element} is not for {joint.cell_type} cells; allowed: {', '.join(allowed)}", "element"
        )


def _thicknesses(fit: _Fit, given: Description) -> None:
    """Refuse thicknesses that are nothing beside the bodies, or larger than these."""
    size = float(np.ptp(fit.joint.points, axis=0).max())
    for name, one in given.layer.items():
        if one.eps is not None and not LEAST_EPS * size <= one.eps <= size:
            where = ("layer", *([name] if name else []), "eps")
            fit.section.refuse(
                f"{one.eps:g}; allowed beside bodies of {size:.4g}: {LEAST_EPS * size:.2g} to {size:.4g}", *where
            )


@dataclass(frozen=True)
class _Fit:
    """A description's table, and the joint whose names it uses."""

    section: Section
    joint: Joint

    def name(self, one: str | None, known: Iterable[str], kind: str, *keys: str) -> None:
        """Refuse a name that is not known."""
        if one is not None and one not in known:
            self.section.refuse(unknown(kind, one, known), *keys)

    def side(self, one: str, *keys: str) -> None:
        """Refuse what is not the name of a set of facets of the outer boundary, or of a part of one."""
        whole, slash, part = one.partition("/")
        if whole == S or whole in self.joint.seams:
            self.section.refuse(f"{whole!r} is where the layer is; name another set of facets", *keys)
        self.name(whole, [name for name in self.joint.facets if name not in self.joint.seams], "set of facets", *keys)
        if slash:
            self.name(part, [*self.joint.bodies, LAYER], f"part of {whole!r}", *keys)

    def vector(self, one: Sequence[float] | History, *keys: str) -> None:
        """Refuse a vector of another dimension, or a history of such vectors."""
        if isinstance(one, History):
            for value in one.values.values():
                self.vector(value, *keys)
            return
        if len(one) != self.joint.dim:
            what = f"{[*one]} has {len(one)} components; the mesh has {self.joint.dim} dimensions"
            self.section.refuse(what, *keys)

    def laws(self, key: str, kind: str, given: Mapping[str | None, object], known: Sequence[str]) -> None:
        """Refuse laws of unknown regions or seams, and those without a law."""
        for one in given:
            self.name(one, known, kind, key, str(one))
        missing = [one for one in known if one not in given]
        if missing and None not in given:
            self.section.refuse(f"{missing[0]!r} has no law; there are: {', '.join(known)}", key)


def _supports(fit: _Fit, given: Description) -> None:
    for place, support in given.supports.items():
        if isinstance(place, str):
            shown = place
            fit.side(place, "supports", shown)
        else:
            shown = f"({', '.join(f'{c:g}' for c in place)})"
            fit.vector(place, "supports", shown)
        for axis in support if isinstance(support, Mapping) else ():
            fit.name(axis, [*"xyz"[: fit.joint.dim], "n"], "component", "supports", shown)


def _loads(fit: _Fit, given: Description) -> None:
    for one, traction in given.tractions.items():
        fit.side(one, "tractions", one)
        if not isinstance(traction, Mapping):
            fit.vector(traction, "tractions", one)
    if isinstance(given.body_force, Mapping):
        for one, force in given.body_force.items():
            fit.name(one, {*fit.joint.bodies, S, *fit.joint.seams}, "region or seam", "body_force", one)
            fit.vector(force, "body_force", one)
    elif given.body_force is not None:
        fit.vector(given.body_force, "body_force")
    for number, load in enumerate(given.loads, 1):
        for key, value in load.arguments.items():
            keys = ("loads", str(number), key)
            if key == "body":
                fit.name(value, fit.joint.bodies, "region", *keys)
            elif isinstance(value, str):
                fit.side(value, *keys)
            else:
                fit.vector(value, *keys)


def _goals(fit: _Fit, given: Description) -> None:
    seams = {S, *fit.joint.seams}
    bases = [*fit.joint.base_seams, *([S] if fit.joint.base_seams else [])]
    held = [one for one in given.supports if isinstance(one, str)]
    held = [*dict.fromkeys([*held, *(one.partition("/")[0] for one in held), *bases])]
    for one, goal in given.goals.items():
        for key, value in goal.arguments.items():
            keys = ("goals", one, key)
            if key == "seam":
                fit.name(value, seams, "seam", *keys)
            elif key == "place":
                fit.name(value, held, "support", *keys)
            elif key != "side":
                fit.vector(value, *keys)
