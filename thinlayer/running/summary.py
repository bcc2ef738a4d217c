"""Summary of an input file of `estimate` and its mesh, printed without a solve: sizes, laws, supports, loads."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from dolfinx import fem

from geometry.seam import S
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.running.case import DescribedCase
from thinlayer.running.materials import Materials
from thinlayer.surface.surface_mesh import surface_of
from thinlayer.system.compat import compiled


def summarise(case: DescribedCase) -> str:
    """Summarise bodies, layers, supports, loads and goals in a text, with the names in the input file. Collective.

    The text also has the resultant force and moment of the loads at the last time, about the origin. For bodies of
    revolution, areas, volumes and resultants are those of the whole revolution.

    Args:
        case: structure, layer and goals, with the content of the input file.

    Raises:
        InputError: the interface law does not suit the layer, or a goal cannot be evaluated.
    """
    data, model, values = case.description, case.make_model(), case.description.file_table.values
    joint, measures, t = model.joint, _measures(model), data.times[-1] if data.times else 0.0
    of_body, of_layer = ("volume", "area") if joint.dim == 3 or data.plane == "axisymmetric" else ("area", "length")
    names = {S: data.mesh.get("S") or S}  # the only seam has another name in the file
    about = "" if joint.dim == 3 else f", plane {model.plane}"
    lines = [f"mesh {data.mesh['path']}: {len(joint.cells)} {joint.cell_type} cells, element {model.element}{about}"]
    lines += ["lengths in {}, stresses in {}".format(*data.units)] if data.units else []
    for name in joint.bodies:
        lines.append(f"body {name}: {_law_text(values['body'], data.body, name)}, {of_body} = {measures[name]:.6g}")
    for name, seam in joint.seams.items():
        sides = f"from {', '.join(seam.lower) or 'a rigid base'} to {', '.join(seam.upper)}"
        size = f"{of_layer} = {measures[name]:.6g}, {len(joint.rows_of(name))} facets"
        lines.append(f"layer {names.get(name, name)}: {_law_text(values['layer'], data.layer, name)}, {size}, {sides}")
    lines += [f"support {place}: {_value_text(support)}" for place, support in values.get("supports", {}).items()]
    lines += [f"{key}: {_value_text(values[key])}" for key in ("tractions", "body_force", "loads") if key in values]
    lines.append(f"loads in all, at t = {t:g}: {model.applied(t).at(np.zeros(joint.dim))}")
    return "\n".join([*lines, *(f"goal {goal.name}" for goal in case.goals)])


def _law_text(values: Mapping[str, Mapping[str, object]], materials: Materials, name: str) -> str:
    """Return a text with the name of a body's or layer's law, and with its parameters as the user wrote them.

    Args:
        values: the table [body] or [layer] of the input file.
        materials: the materials that were read from this table.
        name: name of the region or seam.
    """
    key = name if name in materials else None
    return _entries_text({"law": type(materials[key].law).__name__, **(values[key] if key else values)})


def _measures(model: InterfaceModel) -> dict[str, float]:
    """Return name -> volume of each body and area of each seam. Collective.

    In plane models these are areas and lengths, in models of bodies of revolution those of the whole revolution.
    """
    density = fem.Constant(model.domain.mesh, 1.0) * model.kinematics.factor
    forms = {name: compiled(density * model.dx(model.domain.region_tags(name))) for name in model.joint.bodies}
    volumes = {name: float(model.comm.allreduce(fem.assemble_scalar(form))) for name, form in forms.items()}
    return volumes | {name: surface_of(model, name).integral(1.0) for name in model.joint.seams}


def _entries_text(table: Mapping[str, object]) -> str:
    return ", ".join(f"{key} = {_value_text(value)}" for key, value in table.items())


def _value_text(value: object) -> str:
    """Return the text of a value of the input file (number, text, list or table) in one line."""
    if isinstance(value, Mapping):
        return f"{{{_entries_text(value)}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(_value_text, value))}]"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
