"""Summary of an input file of `estimate` and its mesh, printed without a solve: sizes, laws, supports, loads."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import ufl
from dolfinx import fem

from geometry.seam import S
from thinlayer.discretisation.form_compilation import unit_values
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.running.case import DescribedCase
from thinlayer.running.materials import Materials


def summarise(case: DescribedCase) -> str:
    """Summarise bodies, layers, supports, loads and goals in a text, with the names in the input file. Collective.

    The text also has the resultant force and moment of the loads at the last time, about the origin. For bodies of
    revolution, areas, volumes and resultants are those of the whole revolution.

    Args:
        case: structure, layer and goals, with the content of the input file.

    Raises:
        InputError: the interface law does not suit the layer, or a goal cannot be evaluated.
    """
    entries, model, values = case.description, case.model(), case.description.section.values
    joint, sizes, t = model.joint, _sizes(model), entries.times[-1] if entries.times else 0.0
    of_body, of_layer = ("volume", "area") if joint.dim == 3 or entries.plane == "axisymmetric" else ("area", "length")
    names = {S: entries.mesh.get("S") or S}  # the only seam has another name in the file
    about = "" if joint.dim == 3 else f", plane {model.plane}"
    lines = [f"mesh {entries.mesh['path']}: {len(joint.cells)} {joint.cell_type} cells, element {model.element}{about}"]
    lines += ["lengths in {}, stresses in {}".format(*entries.units)] if entries.units else []
    for name in joint.bodies:
        lines.append(f"body {name}: {_law(values['body'], entries.body, name)}, {of_body} = {sizes[name]:.6g}")
    for name, seam in joint.seams.items():
        sides = f"from {', '.join(seam.lower) or 'a rigid base'} to {', '.join(seam.upper)}"
        size = f"{of_layer} = {sizes[name]:.6g}, {len(joint.rows_of(name))} facets"
        lines.append(f"layer {names.get(name, name)}: {_law(values['layer'], entries.layer, name)}, {size}, {sides}")
    lines += [f"support {place}: {_shown(support)}" for place, support in values.get("supports", {}).items()]
    lines += [f"{key}: {_shown(values[key])}" for key in ("tractions", "body_force", "loads") if key in values]
    lines.append(f"loads in all, at t = {t:g}: {model.applied(t).at(np.zeros(joint.dim))}")
    return "\n".join([*lines, *(f"goal {goal.name}" for goal in case.goals)])


def _law(values: Mapping[str, Mapping[str, object]], materials: Materials, name: str) -> str:
    """Return a text with the name of a body's or layer's law, and with its parameters as the user wrote them.

    Args:
        values: the table [body] or [layer] of the input file.
        materials: the materials that were read from this table.
        name: name of the region or seam.
    """
    key = name if name in materials else None
    return _entries({"law": type(materials[key].law).__name__, **(values[key] if key else values)})


def _sizes(model: InterfaceModel) -> dict[str, float]:
    """Return name -> volume of each body and area of each seam. Collective.

    In plane models these are areas and lengths, in models of bodies of revolution those of the whole revolution.
    """
    places = {name: (model.kinematics.factor, model.dx(model.domain.cell_values(name))) for name in model.joint.bodies}
    sides = {name: model.sides_of(name) for name in model.joint.seams}
    places |= {name: (interface.factor, interface.measure) for name, interface in sides.items()}
    chosen = fem.Constant(model.domain.mesh, np.zeros(len(places)))
    parts = (chosen[k] * factor * measure for k, (factor, measure) in enumerate(places.values()))
    return dict(zip(places, map(float, unit_values(model.comm, sum(parts, ufl.Form([])), chosen)), strict=True))


def _entries(table: Mapping[str, object]) -> str:
    return ", ".join(f"{key} = {_shown(value)}" for key, value in table.items())


def _shown(value: object) -> str:
    """Return the text of a value of the input file (number, text, list or table) in one line."""
    if isinstance(value, Mapping):
        return f"{{{_entries(value)}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(_shown, value))}]"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
