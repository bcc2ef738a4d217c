"""The parts of a model's balance of forces, those that another model of the same joint makes among them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from petsc4py import PETSc

from forms.work import Term
from geometry.inflating.parting import points_on_middle
from thinlayer.discretisation.contact_nodes import ContactSurface
from thinlayer.discretisation.layer import BY_LAW
from thinlayer.discretisation.measures import compiled_terms
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import Configuration, transfer
from thinlayer.parts.compiled import CompiledPart
from thinlayer.parts.contact_part import ContactPart
from thinlayer.parts.forms import FormPart
from thinlayer.parts.law_forms import LawForms
from thinlayer.parts.mean_stress import MeanStressPart
from thinlayer.parts.part import Array, Block, FileOrder, Interval, Memory, Outcome, Part, PartTraits
from thinlayer.parts.pressure_part import PressurePart, has_flow


def body_parts(model: Model) -> list[Part]:
    """The parts of a model that depend on its mesh and bodies alone, each with another key. Collective.

    The first has a matrix with the nonzero pattern of the bodies.
    """
    parts: list[Part] = [LawForms("forms", model.V, model.bodies), *_compiled(model, model.bodies)]
    if model.stress:
        parts.append(MeanStressPart(model.V, model.solids, model.stress, model.comm))
    return parts


def layer_parts(model: Model, held: npt.NDArray[np.int32], bodies: Sequence[Part]) -> list[Part]:
    """The parts of a model's layers, each with another key. Collective.

    Args:
        model: the model.
        held: displacements of this rank that supports prescribe (local, unrolled).
        bodies: those of `body_parts`.
    """
    in_forms = [p for p in model.layer_terms if not p.law.traits.compiled]
    parts: list[Part] = [LawForms("forms of layers", model.V, in_forms)] if in_forms else []
    parts += _compiled(model, model.layer_terms)
    if constrained := [p for p in model.layer_terms if p.law.traits.constrained]:
        diagonal = diagonal_at_rest(bodies)
        largest = float(diagonal.max()[1])
        diagonal.destroy()
        if not largest:  # no law of the bodies is linear, or compiled
            largest = max(part.largest_at_rest() for part in bodies if isinstance(part, LawForms))
        joint = model.domain.joint  # whose vertices are those of the mesh
        masters = joint.masters if joint.periods else None
        for p in constrained:
            parts.append(PressurePart(model.V, p, largest, model.origin, _free(model, p), masters))
    parts += _elsewhere(model)
    for name, law in model.contacts.items():
        parts.append(ContactPart(law, ContactSurface.of(model, name), held, model.layers[name].key))
    return parts


def _elsewhere(model: Model) -> list[Part]:
    """The parts of interface laws where a layer is not meshed, made by the interface model and carried to the model."""
    found = model.law_elsewhere()
    if found is None:
        return []
    other, terms = found
    carrier, in_forms = Carrier(model, other), [p for p in terms if not p.law.traits.compiled]
    keys = list(dict.fromkeys(p.key for p in in_forms))
    parts: list[FormPart | CompiledPart] = [
        LawForms(key, other.V, [p for p in in_forms if p.key == key]) for key in keys
    ]
    return [Carried(part, carrier, f"{part.key}/{BY_LAW}") for part in [*parts, *_compiled(other, terms)]]


def _compiled(model: Model, terms: Iterable[Term]) -> list[CompiledPart]:
    return [
        CompiledPart(key, model.V, term, model.origin, symmetric=model.symmetric)
        for key, term in compiled_terms(terms).items()
    ]


def diagonal_at_rest(parts: Sequence[Part]) -> PETSc.Vec:
    """Diagonal of K and of the tangents at rest of bodies that are not in K; the caller destroys it. Collective."""
    of_K = [part.K.getDiagonal() for part in parts if part.K is not None]
    of_parts = (part.diagonal_at_rest() for part in parts if hasattr(part, "diagonal_at_rest"))
    first, *others = of_K + [diagonal for diagonal in of_parts if diagonal is not None]
    for other in others:
        first.axpy(1.0, other)
        other.destroy()
    return first


def _free(model: Model, term: Term) -> npt.NDArray[np.float64] | None:
    """Vertices of S where the pressure of a layer of order 1 is zero; None for other terms."""
    if not has_flow(term):
        return None
    one = next(one for one in model.layers.values() if one.key == term.key)
    known = model.reductions[one.name]
    return points_on_middle(model.domain.joint)[np.unique(known.loose[~known.coarse].vertices)]


# ---------------------------------------------------------------- parts of another model
# Optional methods and attributes of parts that have no displacements, see `Part`.
SAME = {
    *("stress_width", "failure", "at_time", "parameters", "ease", "excess", "switch", "undeclared_softening"),
    *("takes_time", "answers_at_once", "unit_jump_measure", "comms"),
}


class Carrier:
    """Displacements and nodal forces of one model as those of another model of the same joint. Collective.

    Body cells of both models have the same degrees of freedom, so that this is a change of numbers.

    Args:
        model: the model that solvers see.
        other: the one whose parts act.

    Attributes:
        V: space of the other model.
        matrix: displacements of the other model by those of the first one.
    """

    def __init__(self, model: Model, other: Model) -> None:
        self.V = other.V
        (n, first), (rows, _) = (_range(one.V) for one in (model, other))
        numbers = fem.Function(model.V)
        numbers.x.array[:n] = first + np.arange(n)
        numbers.x.scatter_forward()
        columns = np.rint(transfer(numbers, model, other.V, other).x.array[:rows]).astype(PETSc.IntType)
        starts = np.arange(rows + 1, dtype=PETSc.IntType)
        csr = (starts, columns, np.ones(rows))
        self.matrix = PETSc.Mat().createAIJ(((rows, None), (n, None)), csr=csr, comm=model.comm)

    def displacements(self, u: fem.Function) -> fem.Function:
        """Displacements in the other model."""
        out = fem.Function(self.V)
        self.matrix.mult(u.x.petsc_vec, out.x.petsc_vec)
        out.x.scatter_forward()
        return out


def _range(V: fem.FunctionSpace) -> tuple[int, int]:
    """Number of this rank's degrees of freedom, and the first of them."""
    dofmap = V.dofmap
    first, last = dofmap.index_map.local_range
    return (last - first) * dofmap.index_map_bs, first * dofmap.index_map_bs


class Carried(Part):
    """A part without own unknowns of another model, on the displacements of this one.

    Args:
        part: the part.
        carrier: between both models.
        key: key of the part here.
    """

    def __init__(self, part: FormPart | CompiledPart, carrier: Carrier, key: str) -> None:
        self.key, self._part, self._carrier = key, part, carrier
        self.traits = part.traits
        self.K = None if part.K is None else part.K.ptap(carrier.matrix)
        self._values = fem.Function(carrier.V)  # whose memory the vector has
        self._forces = self._values.x.petsc_vec

    # ---------------------------------------------------------------- a step
    def _old(self, old: Configuration) -> Configuration:
        """A configuration of this model as one of the other, of this part alone."""
        u, kept = self._carrier.displacements(old.u), (old.memory, old.stored, old.stresses)
        own: list[Any] = [{self._part.key: values[self.key]} if self.key in values else {} for values in kept]
        return Configuration(u, old.t, own[0], {}, own[1], old.at_rest, stresses=own[2])

    def begin(self, interval: Interval) -> None:
        super().begin(interval)
        self._part.begin(replace(interval, old=self._old(interval.old)))

    def evaluate(self, u: fem.Function, mid: fem.Function) -> None:
        self._part.evaluate(self._carrier.displacements(u), self._carrier.displacements(mid))
        self.failed = self._part.failed

    def _carried(self, add: Callable[[PETSc.Vec], Any], out: PETSc.Vec) -> Any:
        """Add nodal forces that are added to a vector of the other model; returns what this returns."""
        self._forces.set(0.0)
        size = add(self._forces)
        self._carrier.matrix.multTransposeAdd(self._forces, out, out)
        return size

    def add_forces(self, out: PETSc.Vec) -> float:
        return float(self._carried(self._part.add_forces, out))

    def add_fixed(self, out: PETSc.Vec) -> None:
        if isinstance(self._part, FormPart):
            self._carried(self._part.add_fixed, out)

    def add_forces_in(self, state: Configuration, out: PETSc.Vec) -> None:
        self._carried(partial(self._part.add_forces_in, self._old(state)), out)

    def tangents(self, relative_residual: float) -> list[Block]:
        found = []
        for block in self._part.tangents(relative_residual):
            if self.K is not None and block.matrix == self._part.K:
                found.append(replace(block, matrix=self.K))
                continue
            found.append(replace(block, matrix=block.matrix.ptap(self._carrier.matrix), kept=False))
            if not block.kept:
                block.matrix.destroy()
        return found

    def commit(self) -> Outcome:
        return replace(self._part.commit(), kept=True)

    # ---------------------------------------------------------------- what does not depend on displacements
    def __getattr__(self, name: str) -> Any:
        if name in SAME:
            return getattr(self._part, name)
        raise AttributeError(name)

    def rest(self) -> Memory | None:
        return self._part.rest()

    def named(self) -> dict[str, PartTraits]:
        return self._part.named()

    @property
    def file_order(self) -> FileOrder | None:
        return self._part.file_order

    def error_measure(self, u: fem.Function) -> Array:
        """As in `Part`; empty if the part measures nothing."""
        measure = getattr(self._part, "error_measure", None)
        return measure(self._carrier.displacements(u)) if measure else np.empty(0)

    def destroy(self) -> None:
        if self.K is not None:
            self.K.destroy()
        self._part.destroy()
