"""Names in the code: nouns of the field, one meaning each; those of version 1.0 that users' scripts have still work."""

from __future__ import annotations

import ast
from collections import Counter
from importlib import import_module
from pathlib import Path

import pytest

from forms import LinearElastic
from geometry import block
from thinlayer import Structure, ThinLayer
from thinlayer.discretisation.part_definition import PartDefinition
from thinlayer.parts.part import FieldPart

CLONE = Path(__file__).parents[1]
FOLDERS = ("forms", "geometry", "thinlayer", "studies", "tests", ".ci/benchmarks")
NO_NAMES = {
    "one",
    "found",
    "told",
    "given",
    "known",
    "held",
    "own",
    "apart",
    "beside",
}  # say nothing of what a thing is
FORMER = [
    ("thinlayer.discretisation.constraints", "Tied", "MultiPointConstraint"),
    ("thinlayer.discretisation.addition", "Addition", "PartDefinition"),
    ("thinlayer.parts.part", "Interval", "TimeStep"),
    ("thinlayer.parts.part", "Outcome", "StepOutcome"),
    ("thinlayer.parts.form_part", "matrix", "assemble_plain_matrix"),
    ("forms.elastic", "lame", "lame_stress"),
]


def definitions(tree):
    """(name, line) of all that a file defines: variables, parameters, functions, classes, attributes."""
    for node in ast.walk(tree):
        match node:
            case ast.Name(ctx=ast.Store()):
                yield node.id, node.lineno
            case ast.Attribute(ctx=ast.Store()):
                yield node.attr, node.lineno
            case ast.arg():
                yield node.arg, node.lineno
            case ast.FunctionDef() | ast.ClassDef():
                yield node.name, node.lineno


def test_names_say_what_things_are():
    nameless, classes = [], Counter()
    for path in [path for folder in FOLDERS for path in sorted((CLONE / folder).rglob("*.py"))]:
        place, tree = path.relative_to(CLONE), ast.parse(path.read_text(encoding="utf-8"))  # all trees at once are slow
        nameless += [f"{place}:{line}: {name}" for name, line in definitions(tree) if name in NO_NAMES]
        if place.parts[0] not in ("tests", ".ci"):
            classes.update(node.name for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
    assert nameless == []
    assert [name for name, count in classes.items() if count > 1] == []


@pytest.mark.parametrize(("module", "former", "name"), FORMER)
def test_former_names_are_deprecated(module, former, name):
    with pytest.warns(DeprecationWarning, match=f"{module}.{former} is deprecated since thinlayer 1.1; use .*{name}"):
        assert getattr(import_module(module), former).__name__ == name


def test_former_methods_are_deprecated():
    def tied(self, model):
        """As in version 1.0."""

    with pytest.warns(DeprecationWarning, match="Own.tied is deprecated .*; call it multi_point_constraint"):
        part = type("Own", (PartDefinition,), {"tied": tied})
    assert part.multi_point_constraint is tied
    with pytest.warns(DeprecationWarning, match="Own.own_held is deprecated .*; call it own_prescribed"):
        assert type("Own", (FieldPart,), {"own_held": tied}).own_prescribed is tied
    with pytest.warns(DeprecationWarning, match="Own.eased is deprecated since thinlayer 1.1; call it homotopy"):
        law = type("Own", (LinearElastic,), {"eased": lambda self, ease: LinearElastic(9.0, 8.0)})
    assert law(1.0, 2.0).homotopy(0.5) == LinearElastic(9.0, 8.0)
    with pytest.warns(DeprecationWarning, match="Own.quadratic is deprecated .*; call it has_quadratic_energy"):
        assert not type("Own", (LinearElastic,), {"quadratic": False}).has_quadratic_energy
    structure = Structure(block(1.0, 1.0, 0.5), body=LinearElastic(1.0, 2.0), supports={})
    model = structure.interface(ThinLayer(LinearElastic(0.3, 0.2), 0.1))
    with pytest.warns(DeprecationWarning, match="Coordinates.given is deprecated since thinlayer 1.1; use coefficient"):
        assert model.coordinates.given(2.5, "a load", ()).at_time(0.0) == 2.5
