"""Parameters of an interface model by name, and the models in which one of them is multiplied by a factor."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any

from forms.base import InputError, is_number
from forms.law import Law
from geometry.refusals import require_known
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import ThinLayer

# function of a model and a factor that returns the model in which a parameter is multiplied by the factor
Change = Callable[[InterfaceModel, float], InterfaceModel]
# relative change of a parameter for central differences: their error is about 1e-8, and 1e-6 for nu near 1/2; rounding
# would be 4e-4 at 1e-5 for E of steel that moves on rubber
STEP = 1e-4
FACTORS = (1 + STEP, 1 - STEP)


class Parameters(dict[str, Change]):
    """Parameters of an interface model: name -> function that multiplies the parameter by a factor.

    - "SEAM.p": parameter p of the law of the seam's layer, and "SEAM.eps", its thickness with real moduli;
      "SEAM/k.p": parameter of the sublayer k of a `Stack`, from 1.
    - "BODY.p": parameter of the law of a body. "E" and "nu" are parameters of all laws whose `lmbda` and `mu` are numbers.
    - "load PLACE", "body force", "body force NAME", and the names of loads at points and along lines.
    - "support PLACE AXIS": a displacement that is prescribed and not zero.
    - "eigenstrain NAME": of a body, or of the layer on a seam.

    Args:
        model: the model.

    Attributes:
        reasons: name of a parameter by which there is no derivative -> the reason.
        values_in_model: name of a parameter that is a number -> the number.
    """

    def __init__(self, model: InterfaceModel) -> None:
        super().__init__()
        self.reasons: dict[str, str] = {}
        self.values_in_model: dict[str, float] = {}
        structure = model.structure
        for seam, layer in model.layers.items():
            content = layer.layer
            self._add_law(seam, content.law if isinstance(content, ThinLayer) else content, _layer_change(seam))
            if isinstance(content, ThinLayer):
                self[f"{seam}.eps"] = _layer_change(seam, lambda thin, factor: replace(thin, eps=thin.eps * factor))
                self.values_in_model[f"{seam}.eps"] = content.eps
                if content.at is not None:
                    self.reasons[f"{seam}.eps"] = "its moduli follow eps (at=...); give real moduli, and leave out `at`"
                if content.eigenstrain is not None:
                    self[f"eigenstrain {seam}"] = _layer_change(seam, _scale_eigenstrain)
        for body, law in model.body_laws.items():
            self._add_law(body, law, _body_change(body))
        for body in structure.eigenstrains:
            self[f"eigenstrain {body}"] = _eigenstrain_change(body)
        for place in structure.tractions or {}:
            self[f"load {place}"] = _load_change("tractions", place)
        forces = structure.body_force
        if isinstance(forces, Mapping):
            self.update({f"body force {name}": _load_change("body_force", name) for name in forces})
        elif forces is not None:
            self["body force"] = lambda model, f: model.with_loads(body_force=scaled(model.structure.body_force, f))
        for k, load in enumerate(structure.loads):
            if load.what in self:
                self.reasons[load.what] = "several loads have this name"
            self[load.what] = _point_load_change(k)
        for k, (support_place, components) in enumerate(model.supports.user_entries):
            for axis in components:
                coefficient = model.supports.values[k, axis]
                if coefficient.varies or coefficient.value != 0:
                    self[f"support {support_place} {axis}"] = _support_change(support_place, axis)

    def change(self, name: str, what: str) -> Change:
        """Return the function of one parameter.

        Args:
            name: name of the parameter.
            what: first words of an error message.

        Raises:
            InputError: no such parameter, or one by which there is no derivative.
        """
        require_known("parameter", name, self, what)
        if name in self.reasons:
            raise InputError(f"{what}: no derivative by {name!r}: {self.reasons[name]}")
        return self[name]

    def _add_law(self, place: str, law: Law, change_law: Callable[[Callable[[Any, float], Any]], Change]) -> None:
        sublayers = getattr(law, "sublayers", ((1.0, law),))
        if len(sublayers) > 1:
            for k, (_, sublayer) in enumerate(sublayers):
                self._add_law(f"{place}/{k + 1}", sublayer, _of_sublayer(change_law, k))
            return
        values = law.parameters()
        lmbda, mu = (values.get(name) for name in ("lmbda", "mu"))
        if is_number(lmbda) and is_number(mu):  # not functions of the place
            values |= {"E": mu * (3 * lmbda + 2 * mu) / (lmbda + mu), "nu": lmbda / (2 * (lmbda + mu))}
        for name, value in values.items():
            self[f"{place}.{name}"] = change_law(_law_scaling(name))
            if is_number(value):
                self.values_in_model[f"{place}.{name}"] = float(value)
            if value is None or (is_number(value) and value == 0):
                self.reasons[f"{place}.{name}"] = f"it is {value}; a relative change of it is nothing"
                continue
            try:
                for factor in FACTORS:
                    _law_scaling(name)(law, factor)
            except (TypeError, ValueError) as error:  # a choice, or a number at the end of its range
                self.reasons[f"{place}.{name}"] = f"it cannot change both ways: {error}"


def scaled(value: Any, factor: float) -> Any:
    """Return a load, strain or parameter times a factor: numbers, tables, functions, or objects that have them."""
    if is_dataclass(value):
        first = fields(value)[0].name
        return replace(value, **{first: scaled(getattr(value, first), factor)})  # type: ignore[type-var]
    if callable(value) and not hasattr(value, "ufl_shape"):
        return lambda *place_and_time: scaled(value(*place_and_time), factor)
    if isinstance(value, (list, tuple)):
        return type(value)(scaled(entry, factor) for entry in value)
    return factor * value


def _law_scaling(name: str) -> Callable[[Law, float], Law]:
    def scale(law: Any, factor: float) -> Law:
        parameters = law.parameters()
        if name in parameters:
            values = {name: scaled(parameters[name], factor)}
        else:
            lmbda, mu = parameters["lmbda"], parameters["mu"]
            E, nu = mu * (3 * lmbda + 2 * mu) / (lmbda + mu), lmbda / (2 * (lmbda + mu))
            E, nu = (E * factor, nu) if name == "E" else (E, nu * factor)
            values = {"lmbda": E * nu / ((1 + nu) * (1 - 2 * nu)), "mu": E / (2 * (1 + nu))}
        new: Law = replace(law, **values)
        return new

    return scale


def _of_sublayer(change_law: Callable[..., Change], k: int) -> Callable[..., Change]:
    def change(scale: Callable[[Any, float], Any]) -> Change:
        def scale_stack(stack: Any, factor: float) -> Any:
            sublayers = [(a, scale(law, factor) if j == k else law) for j, (a, law) in enumerate(stack.sublayers)]
            return type(stack)(*sublayers)

        return change_law(scale_stack)

    return change


def with_layers(model: InterfaceModel, layers: Any) -> InterfaceModel:
    """Return a model with other layers; warnings issued before are not repeated.

    Args:
        model: the model.
        layers: one layer for all seams with a layer, or name of a seam -> its layer.
    """
    return model.with_interface_laws(layers if isinstance(layers, Mapping) else dict.fromkeys(model.layers, layers))


def _layer_change(seam: str, scale: Callable[[Any, float], Any] | None = None) -> Any:
    """Return the change of a layer, or, without `scale`, a function from the change of its law to that of the model."""

    def of_layer(scale_layer: Callable[[Any, float], Any]) -> Change:
        return lambda model, factor: with_layers(model, {seam: scale_layer(model.layers[seam].layer, factor)})

    def of_law(scale_law: Callable[[Any, float], Any]) -> Change:
        def scale_layer(layer: Any, factor: float) -> Any:
            if isinstance(layer, ThinLayer):
                return replace(layer, law=scale_law(layer.law, factor))
            return scale_law(layer, factor)

        return of_layer(scale_layer)

    return of_law if scale is None else of_layer(scale)


def _scale_eigenstrain(layer: ThinLayer, factor: float) -> ThinLayer:
    return replace(layer, eigenstrain=scaled(layer.eigenstrain, factor))


def _body_change(body: str) -> Callable[[Callable[[Any, float], Any]], Change]:
    return lambda scale: lambda model, factor: model.with_bodies({body: scale(model.body_laws[body], factor)})


def _eigenstrain_change(body: str) -> Change:
    def change(model: InterfaceModel, factor: float) -> InterfaceModel:
        return model.with_bodies({}, {body: scaled(model.structure.eigenstrains[body], factor)})

    return change


def _load_change(kind: str, name: str) -> Change:
    def change(model: InterfaceModel, factor: float) -> InterfaceModel:
        loads = dict(getattr(model.structure, kind))
        changed: dict[str, Any] = {kind: loads | {name: scaled(loads[name], factor)}}
        return model.with_loads(**changed)

    return change


def _point_load_change(k: int) -> Change:
    def change(model: InterfaceModel, factor: float) -> InterfaceModel:
        loads: Sequence[Any] = model.structure.loads
        new = [replace(load, force=scaled(load.force, factor)) if j == k else load for j, load in enumerate(loads)]
        return model.with_loads(loads=new)

    return change


def _support_change(place: Any, axis: str) -> Change:
    def change(model: InterfaceModel, factor: float) -> InterfaceModel:
        supports = {where: dict(components) for where, components in model.supports.user_entries}
        supports[place][axis] = scaled(supports[place][axis], factor)
        return model.with_loads(supports=supports)

    return change
