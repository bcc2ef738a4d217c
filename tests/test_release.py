"""What a release consists of: one version, the same dependencies everywhere, extras, names that users have too."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
import warnings
from functools import partial

import pytest
from scipy.optimize import minimize

import geometry
import thinlayer
from forms.base import OPTIONAL_PACKAGES, InputError
from forms.traits import RangeWarning, warn_of_range
from tests.documents import CLONE
from tests.refused import refused
from thinlayer.errors import warn_of_deprecated
from thinlayer.running.cli import main

PROJECT = tomllib.loads((CLONE / "pyproject.toml").read_text())["project"]
EXTRA = PROJECT["optional-dependencies"]
OF_CONDA_ALONE = ["fenics-dolfinx>=0.9,<0.12", "petsc4py>=3.22"]  # for pip they are in the extra fenicsx
OF_CONDA = {"gmsh": "python-gmsh", "matplotlib": "matplotlib-base"}  # where it has another name than PyPI


def test_version_and_date_are_the_same_everywhere():
    citation, recipe = ((CLONE / name).read_text() for name in ("CITATION.cff", ".ci/recipe.yaml"))
    released = re.search(r"^## \[(\d.*)\] - (.*)$", (CLONE / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert released.groups() == tuple(re.findall(r"^(?:version|date-released): (.*)$", citation, re.MULTILINE))
    assert released[1] == thinlayer.__version__ == re.search(r'version: "(.*)"', recipe)[1]


@pytest.mark.parametrize("file", ["environment.yml", ".ci/recipe.yaml"])
def test_dependencies_are_the_same_for_conda(file):
    wanted = [*OF_CONDA_ALONE, *PROJECT["dependencies"], *EXTRA["pictures"], *EXTRA["vtk"], *EXTRA["meshes"]]
    wanted += EXTRA["movie"]
    listed = re.findall(r"^ *- (.+)$", (CLONE / file).read_text(), re.MULTILINE)
    for name, bounds in (re.fullmatch(r"([\w-]+)(.*)", spec).groups() for spec in wanted):
        assert f"{OF_CONDA.get(name, name)} {bounds}".strip() in listed


def test_a_missing_extra_is_named_before_anything_is_computed(tmp_path, monkeypatch, capsys):
    assert all(any(spec.startswith(name) for spec in EXTRA[extra]) for name, extra in OPTIONAL_PACKAGES.items())
    for name in [module for module in sys.modules if module.startswith(("thinlayer.output.plotting", "studies."))]:
        monkeypatch.delitem(sys.modules, name)
    for name in OPTIONAL_PACKAGES.keys() - {"dolfinx"}:
        monkeypatch.setitem(sys.modules, name, None)
    assert main(["run", "fig6_stratified", "--out", str(tmp_path / "out")]) == 2
    assert "matplotlib is not installed: pip install 'thinlayer[pictures]'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    refused(InputError, r"gmsh is not .*thinlayer\[meshes\]", geometry.block, 2.0, 1.0, h=0.3)
    refused(InputError, r"pandas is not installed: .*thinlayer\[pandas\]", thinlayer.Table().to_pandas)
    refused(InputError, r"meshio is not .*thinlayer\[meshes\]", geometry.read, CLONE / "studies/data/lap.msh")


@pytest.mark.parametrize("statement", ["import geometry", "from thinlayer import solve"])
def test_a_missing_dolfinx_is_named(statement):
    """`list` and the laws need none."""
    script = f"import sys; sys.modules['dolfinx'] = None; import forms, thinlayer; {statement}"
    done = subprocess.run([sys.executable, "-c", script], cwd=CLONE, capture_output=True, text=True)
    assert "dolfinx is not installed: pip install 'thinlayer[fenicsx]'" in done.stderr
    old = "types.SimpleNamespace(__version__='0.8.0')"
    script = f"import sys, types; sys.modules['dolfinx'] = {old}; {statement}"
    done = subprocess.run([sys.executable, "-c", script], cwd=CLONE, capture_output=True, text=True)
    assert "DOLFINx 0.8.0 is too old; thinlayer needs 0.9 or newer" in done.stderr


def test_a_file_with_the_name_of_a_package_is_refused_and_the_command_does_not_see_it(tmp_path):
    run = lambda *words: subprocess.run([sys.executable, *words], cwd=tmp_path, capture_output=True, text=True)
    (tmp_path / "forms.py").touch()
    (tmp_path / "logging.py").touch()
    assert "rates" in run("-m", "thinlayer", "list").stdout
    (tmp_path / "logging.py").unlink()
    refused = f"{tmp_path / 'forms.py'} hides thinlayer's own package 'forms', {CLONE / 'forms'}"
    assert refused in run("-c", "import thinlayer").stderr


def test_what_is_deprecated_is_said_once_at_each_line_of_the_user():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default")
        for _ in range(2):
            warn_of_deprecated("Bond()", "1.2", "Gap()")
        warn_of_deprecated("Bond()", "1.2", "Gap()")
    assert [str(warning.message) for warning in caught] == ["Bond() is deprecated since thinlayer 1.2; use Gap()"] * 2
    assert {warning.filename for warning in caught} == {__file__}


def test_a_warning_below_scipy_is_said_at_the_line_of_the_user():
    with pytest.warns(RangeWarning) as caught:
        minimize(lambda x: x @ x, [1.0], callback=partial(warn_of_range, "key"))
    assert {warning.filename for warning in caught} == {__file__}


def bibtex_fields(entry: str) -> dict[str, str]:
    return {key: value.strip("{}") for key, value in re.findall(r"(\w+) = (\{\{.*?\}\}|\{.*?\})", entry)}


def test_the_page_of_citations_says_what_the_citation_file_says():
    """Both entries of BibTeX, and the text; the paper's entry is that of `reproduce`."""
    page = (CLONE / "thinlayer/docs/reference/citing.md").read_text()
    software, paper = map(bibtex_fields, re.findall(r"^    @\w+\{.*?^    \}", page, re.DOTALL | re.MULTILINE))
    citation = (CLONE / "CITATION.cff").read_text()
    of_software, of_paper = (
        {key: value.strip('"') for key, value in re.findall(r"^[ -]*([\w-]+): (.+)$", part, re.MULTILINE)}
        for part in citation.split("references:")
    )
    year = of_software["date-released"][:4]
    wanted = {
        "author": of_software["name"],
        "title": of_software["title"],
        "version": of_software["version"],
        "year": year,
    }
    assert software == wanted
    people = zip(*(re.findall(rf"{kind}-names?: (.+)", citation) for kind in ("family", "given")), strict=True)
    wanted = {key: of_paper[key] for key in ("title", "volume", "year", "doi")}
    wanted |= {"author": " and ".join(map(", ".join, people)), "journal": of_paper["journal"].replace("&", r"\&")}
    wanted |= {"number": of_paper["issue"].replace("-", "--"), "pages": f"{of_paper['start']}--{of_paper['end']}"}
    assert paper == wanted
    said = " ".join(page.partition("    @")[0].replace(">", "").replace("*", "").split())
    assert f"{of_software['name']}. {of_software['title']}. Version {of_software['version']}, {year}." in said
    assert f"{of_paper['volume']} ({of_paper['year']}) {of_paper['start']}-{of_paper['end']}" in said
    printed = tomllib.loads((CLONE / "studies/data/paper.toml").read_text())["paper"]["bibtex"]
    assert bibtex_fields(printed) == paper
