"""The page of the paper: its rows name checks that studies make, it is whole in itself, gaps are seen; runs in a batch."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from forms.base import InputError
from studies import rates
from tests.documents import CLONE, names_of_checks
from tests.refused import refused
from thinlayer.running.batch import Job, run_jobs
from thinlayer.running.markup import DATA_FOLDER, formula_html
from thinlayer.running.process import CHECK_FAILED, OK, UNFINISHED
from thinlayer.running.record import Record
from thinlayer.running.reproduce import Page, bounds_text, number_text

BROWSERS = ("chromium", "chromium-headless-shell", "chromium-browser", "google-chrome")
SQUARE = b'<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9"><rect width="9" height="9"/></svg>'
PIXEL = "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
SECONDS = {"long": 3.0, "bad": 2.0, "short": 1.0}
FACTS = {"command": "python3 -m thinlayer reproduce"}
ASKED = """<script>addEventListener("load", () => { document.title = JSON.stringify([
  [...document.images].filter(image => !image.naturalWidth).map(image => image.alt),
  [...document.links].filter(link => link.hash && !document.getElementById(link.hash.slice(1))).map(link => link.href)]) })
</script>"""


def entries(page):
    rows = [row for part in page.paper["sections"] for row in part["rows"]]
    return rows + [entry for entry in page.paper["errata"] if "check" in entry]


def ran(job, checks):
    """Leave what a run of a job leaves; its checks must lie between 1 and 3."""
    with Record(job.study, job.folder, job.options) as record:
        for name, value in checks.items():
            record.check(name, value, low=np.float64(1.0), high=3.0)


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The page of runs of one kind of number, 2."""
    page = Page(tmp_path_factory.mktemp("paper"), quick=True)
    for name, job in page.jobs.items():
        ran(job, {row["check"].replace("*", "any"): 2.0 for row in entries(page) if row["run"] == name})
    for name in (name for part in page.paper["sections"] for name in part["pictures"]):
        (page.out / name).write_bytes(base64.b64decode(PIXEL) if name.endswith("png") else SQUARE)
    assert page.write(FACTS) == OK
    return page


def test_every_row_names_a_check_of_a_study():
    """A check's name is a text of some study, with values put in where the row has * or the same value."""
    texts = names_of_checks()
    page = Page(Path("out"), quick=True)
    for entry in entries(page):
        assert any(text.fullmatch(entry["check"]) for text in texts), entry
        if page.jobs[entry["run"]].study == "rates" and entry["check"].startswith("last observed order of the *,"):
            assert entry["check"].rpartition(", ")[2] in rates.SWEEPS, entry


def test_the_page_is_whole_in_itself(page):
    text = (page.out / "index.html").read_text()
    ids, links = (re.findall(rf'<[^>]+ {name}="([^"]+)"', text) for name in ("id", "href"))
    pictures = re.findall(r'src="data:image/(png|svg\+xml);base64,([^"]+)"', text)
    assert not re.search(r"<(script|link|iframe)|url\(|@import", text)
    assert len(ids) == len({*ids})
    anchors = {link for link in links if link.startswith("#")}
    assert anchors <= {f"#{name}" for name in ids}
    pages = {link for link in links if not link.startswith(("#", "https://doi.org/"))}
    assert {Path(link).stem for link in pages} == {name for part in page.paper["sections"] for name in part["laws"]}
    assert all((page.out / link).resolve().is_relative_to(CLONE) and (page.out / link).exists() for link in pages)
    assert page.law_html("no_page", "NoPage") == ""  # an installed package has no pages
    assert len(pictures) == text.count(" src=") > 40
    for kind, content in pictures:
        assert base64.b64decode(content, validate=True).startswith(b"<svg" if kind == "svg+xml" else b"\x89PNG")
    rows = json.loads((page.out / "reproduce.json").read_text())["rows"]
    assert {row["verdict"] for row in rows} == {"holds"}
    assert f"{len(rows)} of {len(rows)} numbers hold; 8 figures" in text


def test_each_section_has_a_tile_that_tells_a_number(page):
    text = (page.out / "index.html").read_text()
    count = r'<span class="count holds">(\d+) of \2 hold</span>'
    tiles = re.findall(rf'<a href="#(\w+)"><strong>.*?</strong><img .*?>\s*{count}(.*)</a>', text)
    assert [name for name, _, _ in tiles] == [part["id"] for part in page.paper["sections"]]
    assert sum(int(count) for _, count, _ in tiles) == len(page.rows)
    assert all("2" in telling and "?" not in telling for _, _, telling in tiles)  # the number of all checks


def test_each_section_has_a_sketch_of_its_own_with_readable_text(page):
    sketches = [part["sketch"] for part in page.paper["sections"]]
    assert {*sketches} == {path.name for path in DATA_FOLDER.glob("sketch_*.svg")}
    assert len(sketches) == len({*sketches})
    for name in sketches:
        text = (DATA_FOLDER / name).read_text()
        assert int(re.search(r'viewBox="0 0 (\d+)', text)[1]) <= 340  # px, the width at which a section places it
        assert min(map(int, re.findall(r'font-size="(\d+)"', text))) >= 12


def test_tables_have_the_papers_column_where_it_prints_numbers(page):
    """And the reasons for bounds of orders stand under the tables."""
    text = (page.out / "index.html").read_text()
    tables = re.findall(r"<h3>(Numbers of the paper|Checks)</h3><div[^>]*><table>(.*?)</table>", text, re.DOTALL)
    assert {(title, "<th>Paper</th>" in table) for title, table in tables} == {
        ("Checks", False),
        ("Numbers of the paper", True),
    }
    assert all("" not in re.findall(r'class="paper".*?>(.*?)</td>', table) for _, table in tables)
    names = [entry["check"].rpartition(", ")[2] for entry in entries(page) if "order of the *," in entry["check"]]
    orders = {rates.SWEEPS[name].orders for name in names}
    assert {bounds_text({"low": low, "high": high}) for low, high in orders} == {*page.paper["bounds"]}


def test_reasons_of_bounds_stand_below_orders_alone(page, monkeypatch):
    monkeypatch.setitem(page.paper, "bounds", {"1 to 3": "because it is so"})  # the bounds of all checks
    shown = {part["id"]: "because it is so" in page.section_html(part) for part in page.paper["sections"]}
    assert {name for name, is_shown in shown.items() if not is_shown} == {"fig3", "fig4", "fig8", "relaxation"}


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.00223, "1.00"),
        (0.7920, "0.792"),
        (13.0, "13"),
        (85713.7, "85714"),
        (8.49895e-8, r"$8.50 \cdot 10^{-8}$"),
        (99.99, "100"),
        (0.8575 - 1e-15, "0.858"),
        (0.8575 + 1e-15, "0.858"),
    ],
)
def test_numbers_have_three_digits(value, text):
    assert number_text(value, "#") == text


def test_bounds_as_text():
    assert bounds_text({"low": None, "high": 1e-6}) == "≤ $10^{-6}$"
    assert bounds_text({"low": 0.93, "high": 1.07}) == "0.93 to 1.07"
    assert bounds_text({"low": 11538.4, "high": 11538.6}) == "11538 ± 0.1"


def test_a_browser_shows_the_page(page, tmp_path):
    if not (browser := next(filter(None, map(shutil.which, BROWSERS)), None)):
        pytest.skip(f"none of {', '.join(BROWSERS)} is on PATH")
    asked = tmp_path / "index.html"
    asked.write_text((page.out / "index.html").read_text() + ASKED)
    words = ["--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--dump-dom", asked.as_uri()]
    done = subprocess.run([browser, *words], capture_output=True, text=True, timeout=60)
    assert "<title>[[],[]]</title>" in done.stdout, done.stderr
    assert "CONSOLE" not in done.stderr


def test_a_batch_takes_up_what_is_done(tmp_path, monkeypatch, capsys):
    """The longest run is first, one that fails stops no other one; a second batch repeats it, and resumes a killed one."""
    long, bad, short = (Job(name, {}, tmp_path / "out" / name, seconds) for name, seconds in SECONDS.items())
    for job in (long, short):
        ran(Job(job.study, {}, tmp_path / job.study, job.expected_seconds), {"a number": 2.0})
    script, calls = tmp_path / "python", tmp_path / "calls"
    script.write_text(f'#!/bin/sh\ncd {tmp_path}\necho "$4 $7" >> calls\nmkdir -p $6\ncp $4/run.json $6')
    script.chmod(0o700)
    monkeypatch.setattr("sys.executable", str(script))
    assert run_jobs([short, bad, long], tmp_path / "out", 1) == UNFINISHED
    assert calls.read_text().split() == ["long", "bad", "short"]
    assert re.search(r"3 of 3  short: all checks hold \(\d+ s, see .*short.log\)", capsys.readouterr().out)
    path = long.folder / "run.json"
    path.write_text(path.read_text().replace('"error": null', '"error": "not finished"'))
    assert run_jobs([short, bad, long], tmp_path / "out", 2) == UNFINISHED
    assert calls.read_text().split()[3:] in (["long", "--resume", "bad"], ["bad", "long", "--resume"])
    assert run_jobs([short, long], tmp_path / "out") == OK
    assert len(calls.read_text().split()) == 6


def test_progress_of_a_batch_counts_running_studies(tmp_path, monkeypatch):
    shares = []
    monkeypatch.setattr(
        "thinlayer.running.batch.report", lambda name: nullcontext(lambda share, text: shares.append(share))
    )
    script = tmp_path / "python"
    script.write_text("#!/bin/sh\nsleep 0.5")
    script.chmod(0o700)
    monkeypatch.setattr("sys.executable", str(script))
    run_jobs([Job("limits", {}, tmp_path / "out" / "limits", 0.2)], tmp_path / "out")
    assert shares == sorted(shares)
    assert shares[0] < 0.5
    assert shares[-2:] == pytest.approx([0.9, 1.0])


def test_formulas_without_scripts():
    text = "<i>μ\u0304</i><sub>12</sub> &lt; [<i>u\u0307</i>]<sup><i>p</i>\u22122</sup>"
    assert formula_html(r"\bar\mu_{12} < [\dot u]^{p-2}") == text
    refused(InputError, r"frac', neither a name of .*signs.toml", formula_html, r"\frac{a}{b}")


@pytest.mark.parametrize(("value", "status", "verdict"), [(None, UNFINISHED, "missing"), (4.0, CHECK_FAILED, "fails")])
def test_a_run_that_fails_is_seen(page, tmp_path, value, status, verdict):
    """Without its run.json, or with a number out of its bounds."""
    shutil.copytree(page.out, tmp_path, dirs_exist_ok=True)
    other = Page(tmp_path, quick=True)
    shutil.rmtree(tmp_path / "fig4")
    if value:
        ran(other.jobs["fig4"], {row["check"]: value for row in entries(other) if row["run"] == "fig4"})
    assert other.write(FACTS) == status
    assert {row["run"] for row in other.rows if row["verdict"] == verdict} == {"fig4"}
    assert other.unfinished == ([] if value else ["fig4"])
    assert ("Not finished: fig4" in (tmp_path / "index.html").read_text()) == (not value)
