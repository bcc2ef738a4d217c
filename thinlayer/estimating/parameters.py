"""Parameters of an interface model by name, and the models in which one of them is multiplied by a factor."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

from forms.base import InputError, is_number, require
from forms.elastic import LinearElastic
from forms.law import Law
from forms.series import Stack
from geometry.refusals import require_known
from thinlayer.discretisation.coefficient import times
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import ThinLayer
from thinlayer.parts.film import Film
from thinlayer.parts.inertia import Inertia

# function of a model and a factor that returns the model in which a parameter is multiplied by the factor
Change = Callable[[InterfaceModel, float], InterfaceModel]
# relative change of a parameter for central differences: their error is about 1e-8, and 1e-6 for nu near 1/2; rounding
# would be 4e-4 at 1e-5 for E of steel that moves on rubber
STEP = 1e-4
FACTORS = (1 + STEP, 1 - STEP)
# second difference of residuals, over the first, from which there is no derivative; the error of slopes of smooth laws is
# its square
BEND_TOLERANCE = 0.01
BEND_MESSAGE = (
    "derivative: a law has a kink in the step to t = {:g}, as where it yields and loads stay, or jumps; or it changes too "
    "fast with a parameter, as with nu near 1/2 (give lmbda and mu)"
)
SLOPE_ROUNDING = 1e-8  # first difference of residuals, over the forces, that is rounding


@dataclass(frozen=True)
class Datum:
    """A datum of a model or another object: how it is read, and how an object is made that differs in it alone.

    `datum / part` is the part of this datum that is a datum `part` of it.

    Attributes:
        read: function of the object that returns the datum.
        put: function of the object and a new datum that returns the new object.
    """

    read: Callable[[Any], Any]
    put: Callable[[Any, Any], Any]

    def __truediv__(self, part: Datum) -> Datum:
        return Datum(
            lambda owner: part.read(self.read(owner)),
            lambda owner, new: self.put(owner, part.put(self.read(owner), new)),
        )

    def __call__(self, owner: Any, factor: float) -> Any:
        """Return the object in which this datum is multiplied by a factor."""
        return self.put(owner, times(factor, self.read(owner)))


def entry(key: Any) -> Datum:
    """Return the entry of a list or dictionary as a datum of it."""

    def put(entries: Any, new: Any) -> Any:
        entries = copy(entries)
        entries[key] = new
        return entries

    return Datum(lambda entries: entries[key], put)


def attribute(name: str) -> Datum:
    """Return the attribute of an instance of a dataclass as a datum of it."""
    return Datum(lambda owner: getattr(owner, name), lambda owner, new: replace(owner, **{name: new}))


def with_layers(model: InterfaceModel, layers: Any) -> InterfaceModel:
    """Return a model with other layers; warnings issued before are not repeated.

    Args:
        model: the model.
        layers: one layer for all seams with a layer, or name of a seam -> its layer.
    """
    return model.with_interface_laws(layers if isinstance(layers, Mapping) else dict.fromkeys(model.layers, layers))


LAYERS = Datum(lambda model: {seam: layer.layer for seam, layer in model.layers.items()}, with_layers)
BODIES = Datum(lambda model: dict(model.body_laws), lambda model, laws: model.with_bodies(laws))
EIGENSTRAINS = Datum(
    lambda model: dict(model.structure.eigenstrains), lambda model, strains: model.with_bodies({}, strains)
)
TRACTIONS = Datum(
    lambda model: dict(model.structure.tractions or {}),
    lambda model, loads: model.with_loads(**{model.kinematics.quantities.load_arguments[0]: loads}),
)
BODY_FORCE = Datum(
    lambda model: model.structure.body_force,
    lambda model, force: model.with_loads(**{model.kinematics.quantities.load_arguments[1]: force}),
)
PARTS = Datum(lambda model: list(model.parts), lambda model, parts: model.with_parts(parts))
POINT_LOADS = Datum(lambda model: list(model.structure.loads), lambda model, loads: model.with_loads(loads=loads))
SUPPORTS = Datum(
    lambda model: {place: dict(components) for place, components in model.supports.user_entries},
    lambda model, supports: model.with_loads(supports=supports),
)


def require_independent(names: Sequence[str], of: Mapping[str, object]) -> None:
    """Raise InputError if a modulus of a law is to change with several parameters, as mu does with mu and E."""
    laws: dict[str, set[str]] = {}
    groups = [*([name] for name in names), *(list(tied) for tied in of.values() if isinstance(tied, Sequence))]
    for group in groups:
        for law, _, parameter in (name.rpartition(".") for name in group):
            both = {f"{law}.lmbda", f"{law}.mu"} <= {*group}  # multiplied together, they change as with E
            laws.setdefault(law, set()).add("E" if both else parameter)
    for law, parameters in laws.items():
        mixed = parameters & {"E", "nu"}, parameters & {"lmbda", "mu"}
        allowed = f"{law}.E and {law}.nu, or {law}.lmbda and {law}.mu: the others are functions of these"
        require(not all(mixed), f"the parameters of {law}", sorted(parameters), allowed)


class Parameters(dict[str, Datum]):
    """Parameters of an interface model by name.

    - "SEAM.p": parameter p of the law of the seam's layer, and "SEAM.eps", its thickness with real moduli;
      "SEAM/k.p": parameter of the sublayer k of a `Stack`, from 1.
    - "BODY.p": parameter of the law of a body. "E" and "nu" are parameters of all laws whose `lmbda` and `mu` are numbers.
    - "load PLACE", "body force", "body force NAME", and the names of loads at points and along lines; of a scalar field
      "flux PLACE", "source", "source NAME", and "film PLACE.h", "film PLACE.T" of a `Film`.
    - "support PLACE AXIS": a displacement that is prescribed and not zero.
    - "eigenstrain NAME": of a body, or of the layer on a seam.
    - "NAME.density": of a body or layer in `Inertia`, on which frequencies depend.

    Args:
        model: the model.

    Attributes:
        reasons: name of a parameter by which there is no derivative -> the reason.
        values_in_model: name of a parameter that is a number -> the number.
    """

    def __init__(self, model: InterfaceModel) -> None:
        super().__init__()
        if not isinstance(model, InterfaceModel):
            raise InputError("derivative: a full model; give an interface model (structure.interface)")
        self.reasons: dict[str, str] = {}
        self.values_in_model: dict[str, float] = {}
        for seam, layer in LAYERS.read(model).items():
            place = LAYERS / entry(seam)
            if not isinstance(layer, ThinLayer):
                self._add_law(seam, layer, place)
                continue
            self._add_law(seam, layer.law, place / attribute("law"))
            self._add_value(f"{seam}.eps", layer.eps, place / attribute("eps"))
            if model.domain.joint.parted is not None:
                self.reasons[f"{seam}.eps"] = (
                    "bodies made room for the layer, and their faces would move (bodies='extended')"
                )
            if layer.at is not None:
                self.reasons[f"{seam}.eps"] = "its moduli follow eps (at=...); give real moduli, and leave out `at`"
            if layer.eigenstrain is not None:
                self[f"eigenstrain {seam}"] = place / attribute("eigenstrain")
        for body, law in model.body_laws.items():
            self._add_law(body, law, BODIES / entry(body))
        self._add_entries("eigenstrain", EIGENSTRAINS, EIGENSTRAINS.read(model))
        names = model.kinematics.quantities
        self._add_entries(names.load, TRACTIONS, TRACTIONS.read(model))
        forces = model.structure.body_force
        if isinstance(forces, Mapping):
            self._add_entries(names.body_force, BODY_FORCE, forces)
        elif forces is not None:
            self[names.body_force] = BODY_FORCE
        for k, load in enumerate(model.structure.loads):
            if load.what in self:
                self.reasons[load.what] = "several loads have this name"
            self[load.what] = POINT_LOADS / entry(k) / attribute("force")
        for k, part in enumerate(model.parts):
            if isinstance(part, Film):
                for name in ("h", "T"):
                    self._add_value(f"{part.key}.{name}", getattr(part, name), PARTS / entry(k) / attribute(name))
            elif isinstance(part, Inertia):
                density = PARTS / entry(k) / attribute("density")
                for name, value in part.density.items():
                    self._add_value(f"{name}.density", value, density / entry(name))
                    if not value:
                        self.reasons[f"{name}.density"] = "it is 0; a relative change of it is nothing"
        for k, (support, components) in enumerate(model.supports.user_entries):
            values = {axis: model.supports.values[k, axis] for axis in components}
            moved = [axis for axis, value in values.items() if value.varies or value.value != 0]
            self._add_entries(f"support {support}", SUPPORTS / entry(support), moved)

    def change(self, name: str, what: str) -> Datum:
        """Return a parameter.

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

    def _add_entries(self, what: str, place: Datum, keys: Iterable[str]) -> None:
        self.update({f"{what} {key}": place / entry(key) for key in keys})

    def _add_value(self, name: str, value: Any, datum: Datum) -> None:
        self[name] = datum
        if is_number(value):
            self.values_in_model[name] = float(value)

    def _add_law(self, name: str, law: Law, place: Datum) -> None:
        """Add the parameters of the law at a place in the model."""
        if isinstance(law, Stack):
            for k, sublayer in enumerate(law.laws):
                self._add_law(f"{name}/{k + 1}" if len(law.laws) > 1 else name, sublayer, place / SUBLAYERS / entry(k))
            return
        data = {key: attribute(key) for key in law.parameters()}
        if all(is_number(law.parameters().get(key)) for key in ("lmbda", "mu")):  # not functions of the place
            data |= {key: ENGINEERING_CONSTANTS / entry(key) for key in ("E", "nu")}
        for key, datum in data.items():
            value = datum.read(law)
            self._add_value(f"{name}.{key}", value, place / datum)
            if value is None or (is_number(value) and value == 0):
                self.reasons[f"{name}.{key}"] = f"it is {value}; a relative change of it is nothing"
                continue
            if key == "nu" and 2 * STEP * abs(value) / (1 - 2 * value) > BEND_TOLERANCE:
                self.reasons[f"{name}.nu"] = "moduli change too fast with it, so near to 1/2; give lmbda and mu"
            try:
                for factor in FACTORS:
                    datum(law, factor)
            except (TypeError, ValueError) as error:  # a choice, or a number at the end of its range
                self.reasons[f"{name}.{key}"] = f"it cannot change both ways: {error}"


def _engineering_constants(law: Any) -> dict[str, float]:
    lmbda, mu = law.lmbda, law.mu
    return {"E": mu * (3 * lmbda + 2 * mu) / (lmbda + mu), "nu": lmbda / (2 * (lmbda + mu))}


def _with_engineering_constants(law: Any, constants: dict[str, float]) -> Any:
    moduli = LinearElastic.young(**constants)
    return replace(law, lmbda=moduli.lmbda, mu=moduli.mu)


ENGINEERING_CONSTANTS = Datum(_engineering_constants, _with_engineering_constants)
SUBLAYERS = Datum(
    lambda stack: list(stack.laws),
    lambda stack, laws: Stack(*((a, law) for (a, _), law in zip(stack.sublayers, laws, strict=True))),
)
