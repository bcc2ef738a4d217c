"""The API reference has all that users import, get and call, with arguments and examples; no page of it is empty."""

from __future__ import annotations

import doctest
import html
import importlib
import inspect
import itertools
import re
import tomllib
from functools import cache

import pytest

import forms
import geometry
import thinlayer
from tests.documents import CLONE, DOCS, PAGES
from tests.test_pages import PUBLIC
from thinlayer import fields, goals, plotting
from thinlayer.running.catalogue import studies

GROUPS = {path.stem: path.read_text() for path in (DOCS / "reference/api").glob("*.md")}
TEMPLATES = DOCS / "_templates/autosummary"
USED = dict(re.findall(r'^  "([\w.]+)": "(.*)",$', (TEMPLATES / "class.rst").read_text(), re.MULTILINE))
BUILT = CLONE / "out/docs/reference/generated"
OURS = ("thinlayer", "forms", "geometry")
SOURCES = {path: path.read_text() for package in OURS for path in (CLONE / package).rglob("*.py")}
MIN_WORDS = 20
CONSTRUCTORS = ("young", "shear", "springs", "graded", "of_layer")
DRAWING = ("deformed", "on_surface", "zoomed", "movie")  # by VTK: slow
VARIABLES = {
    "history": "History PointHistory", "joint": "Joint", "model": "Model InterfaceModel", "probe": "Probe",
    "problem": "StepProblem", "broken": "BrokenMesh", "state": "State", "surface": "Surface", "table": "Table",
    "zoom": "Zoom",
}  # fmt: skip


def entries() -> dict[str, object]:
    """Full name -> object, for all names in the groups of the reference."""
    objects = {}
    for text in GROUPS.values():
        for module, block in re.findall(r"currentmodule:: (\w+)\n(.*?)(?=\.\. current|\Z)", text, re.DOTALL):
            for name in re.findall(r"^   ~?([A-Za-z][\w.]*)$", block, re.MULTILINE):
                objects[f"{module}.{name}"] = resolve(f"{module}.{name}")
    return objects


def resolve(name: str) -> object:
    """The object with a name, in the deepest module that the name has."""
    parts = name.split(".")
    for n in range(len(parts) - 1, 0, -1):
        try:
            value = importlib.import_module(".".join(parts[:n]))
        except ModuleNotFoundError:
            continue
        for part in parts[n:]:
            value = getattr(value, part)
        return value
    raise AssertionError(name)


ENTRIES = entries()
CLASSES = {name.rpartition(".")[2]: value for name, value in ENTRIES.items() if inspect.isclass(value)}


@cache
def shown(cls: type) -> dict[str, object]:
    """Name -> function or property, for the members on the page of a class."""
    key = f"goals.{cls.__name__}" if cls.__module__.endswith("goals") else cls.__name__
    if key in USED:
        names = [name for name in USED[key].split(", ") if name]
    elif cls.__module__.startswith("forms"):
        names = [name for name in CONSTRUCTORS if hasattr(cls, name)]
    else:
        names = [name for name, value in vars(cls).items() if not name.startswith("_") and function_of(value)]
    return {name: inspect.getattr_static(cls, name) for name in names}


def function_of(member: object) -> object:
    """The function of a method or property; None for other members."""
    for attribute in ("fget", "func", "__func__"):
        member = getattr(member, attribute, member)
    return member if inspect.isfunction(member) else None


def documented_functions():
    for name, value in ENTRIES.items():
        if inspect.isfunction(value):
            yield name, value
        elif inspect.isclass(value):
            yield from (
                (f"{name}.{member}", function_of(value_of_member)) for member, value_of_member in shown(value).items()
            )


def test_every_public_name_has_an_entry():
    exported = [value for name, value in PUBLIC.items() if not name.startswith("_") and callable(value)]
    exported += [getattr(plotting, name) for name in ("curves", "rates", "along", "deformed", "on_surface", "zoomed")]
    exported += [plotting.movie, plotting.View, fields.write, *goals.Goal.__subclasses__()]
    exported += goals.DirectedGoal.__subclasses__()
    exported = [value for value in exported if value.__module__.startswith(OURS)]
    helpers = (goals.DirectedGoal, forms.base.import_optional)
    listed = [*ENTRIES.values()]
    assert [value for value in exported if value not in listed and value not in helpers] == []
    assert {thinlayer.errors.LooseBody, thinlayer.errors.TurningPoint, geometry.joint.Joint} <= {*listed}


def test_every_class_that_a_documented_function_returns_has_an_entry():
    missing = set()
    for name, function in documented_functions():
        for word in re.findall(r"[A-Z]\w+", str(function.__annotations__.get("return"))):
            value = function.__globals__.get(word)
            if inspect.isclass(value) and value.__module__.startswith(OURS) and value not in ENTRIES.values():
                missing.add((name, word))
    assert missing == set()


def test_members_that_pages_call_are_on_the_pages_of_their_classes():
    blocks = [code for text in PAGES.values() for code in re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.M)]
    calls = set(re.findall(rf"(?<![.\w\"])({'|'.join(VARIABLES)})\.([a-z]\w*)", "\n".join(blocks)))
    assert len(calls) >= 30
    for variable, member in calls:
        classes = [CLASSES[name] for name in VARIABLES[variable].split()]
        attributes = re.findall(r"^    +([\w, ]+): ", "\n".join(inspect.getdoc(cls) for cls in classes), re.MULTILINE)
        assert member in {*", ".join(attributes).split(", "), *itertools.chain(*map(shown, classes))}, (
            variable,
            member,
        )


def test_every_entry_says_what_it_does_and_names_its_arguments():
    for name, function in documented_functions():
        text = inspect.getdoc(function) or inspect.getdoc(resolve(name))
        assert text, name
        arguments = [p.name for p in inspect.signature(function).parameters.values() if p.kind != p.VAR_KEYWORD]
        lacking = [argument for argument in arguments if not re.search(rf"\b{argument}\b", f"self cls {text}")]
        assert lacking == [] or "Args:" not in text, (name, lacking)
    for name, value in ENTRIES.items():
        assert inspect.getdoc(value), name
    assert {*USED} <= {name.removeprefix("thinlayer.") for name in ENTRIES} | {*CLASSES}


def test_words_for_types_are_those_of_names_in_the_source():
    words = tomllib.loads((DOCS / "types.toml").read_text())
    used = set(re.findall(r"[\w.]+", "\n".join(SOURCES.values())))
    assert {*words} - used == set()


MORE = {name: value for name, value in ENTRIES.items() if value not in PUBLIC.values()}
FOUND = [doctest.DocTestFinder(recurse=False).find(value, name, globs={}) for name, value in MORE.items()]
EXAMPLES = {test.name: test for tests in FOUND for test in tests if test.examples}
assert len(EXAMPLES) >= 10


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.long][: name.endswith(DRAWING)]) for name in EXAMPLES]
)
def test_examples_of_results_and_pictures_print_what_they_say(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert doctest.DocTestRunner().run(EXAMPLES[name]).failed == 0, capsys.readouterr().out


def test_lines_of_examples_fit_a_page():
    """84 columns, as the code of pages."""
    code = [
        (path.name, line.strip())
        for path, text in SOURCES.items()
        for line in re.findall(r"^ +(?:>>> |\.\.\.  ).*$", text, re.MULTILINE)
    ]
    assert len(code) > 300
    assert [(name, line) for name, line in code if len(line) > 84] == []


def test_built_pages_of_the_reference_have_content():
    """Each has its first sentence, a name that others can link to, and some words."""
    pages = {name: BUILT / f"{name}.html" for name in ENTRIES}
    newest = max(path.stat().st_mtime for path in (DOCS / "reference/api").glob("*.md"))
    if not all(page.exists() and page.stat().st_mtime > newest for page in pages.values()):
        pytest.skip("./fenicsx docs builds the pages")
    for name, page in pages.items():
        article = page.read_text().partition("<article")[2].partition("</article>")[0]
        text = html.unescape(re.sub(r"<[^>]*>", "", article))
        assert len(text.split()) >= MIN_WORDS, name
        assert f'id="{name}"' in article, name
        members = shown(ENTRIES[name]) if inspect.isclass(ENTRIES[name]) else {}
        assert [member for member in members if f'id="{name}.{member}"' not in article] == [], name
    for page in (CLONE / "out/docs").rglob("*.html"):
        is_made_by_sphinx = "_static" in page.parts or page.name in ("search.html", "genindex.html", "py-modindex.html")
        if not is_made_by_sphinx and page.stat().st_mtime > newest:
            article = page.read_text().partition("<article")[2].partition("</article>")[0]
            assert len(re.sub(r"<[^>]*>", "", article).split()) >= MIN_WORDS, page


def test_the_gallery_leads_to_pictures_and_code():
    gallery, pages = CLONE / "out/docs/reference/studies.html", BUILT / "studies"
    if not gallery.exists() or gallery.stat().st_mtime < (DOCS / "listings.py").stat().st_mtime:
        pytest.skip("./fenicsx docs builds the pages")
    text = gallery.read_text()
    shown_as = lambda path: rf"/{path.stem}\d*{path.suffix}"  # Sphinx numbers pictures of one name
    for name in studies():
        page = (pages / f"{name}.html").read_text()
        assert f'href="generated/studies/{name}.html"' in text, name
        assert '<span class="k">def</span>' in page, name
        assert f"thinlayer run {name}\n" in re.sub(r"<[^>]*>", "", page), name
        drawn = [*(CLONE / "studies/pictures").glob(f"{name}*")]
        assert [path for path in drawn if not re.search(shown_as(path), page)] == [], name
        assert all(re.search(shown_as(path), text) for path in drawn if path.suffix == ".png"), name
