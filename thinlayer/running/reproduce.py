"""Page in HTML, and file in JSON, with the numbers of the paper next to those that the studies compute.

The paper is Lebon, Rizzoni and Ronel-Idrissi, Computers & Structures 82 (2004) 1929-1938. studies/data/paper.toml lists
its statements, the runs of studies, and the checks that are shown. studies/data/paper.html is the template of the page.
Each row of a table on the page shows a check that a study wrote to its run.json. The row "holds" if the check has
passed.
"""

from __future__ import annotations

import base64
import json
import os
import platform
import re
import shlex
import time
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from functools import cache, reduce
from html import escape
from mimetypes import guess_type
from pathlib import Path
from string import Template
from typing import Any

from thinlayer.running.batch import LOG_SUFFIX, Job, quick_options, run_jobs
from thinlayer.running.markup import DATA_FOLDER, line_html, paragraphs_html
from thinlayer.running.process import CHECK_FAILED, OK, UNFINISHED
from thinlayer.running.provenance import code_hash, package_versions
from thinlayer.system.folder import replace_file
from thinlayer.system.table import Table
from thinlayer.system.version import print_safely

STATUS_OF_VERDICT = {"holds": OK, "fails": CHECK_FAILED, "missing": UNFINISHED}  # verdict of a row -> exit status
MAX_HALF_WIDTH_RATIO = 0.05  # half-width over lower end, up to which a range is shown as a number and a tolerance
COLUMNS = {"label": "Number", "printed": "Paper", "computed": "Computed", "bounds": "Bounds", "verdict": "Verdict"}
GROUPS = {"Numbers of the paper": True, "Checks": False}  # table of a section -> whether the paper prints its numbers
LAW_PAGES = ("out/docs/laws/{}.html", "thinlayer/docs/laws/{}.md")  # a law's page in the clone: built, or its source
ERRATA_COLUMNS = {"where": "Where", "printed": "Printed", "right": "Right", "shown": "Shown by"}
Entries = Mapping[str, Any]  # a table of paper.toml, or a check of run.json
MISSING_CHECK = {"value": None, "low": None, "high": None, "passed": None}  # entries of a missing check


def reproduce(out: Path, *, quick: bool, at_a_time: int | None) -> int:
    """Run the studies of the paper, and write the page index.html and the file reproduce.json with their numbers.

    Args:
        out: folder of the page and of the runs.
        quick: whether to use the option --quick (coarser meshes and fewer rows) of those studies that have it.
        at_a_time: largest number of studies that run at the same time; None: the number of cores.

    Returns:
        Exit status: `UNFINISHED` (3) if a run or a number is missing, else `CHECK_FAILED` (1) if a number does not
        agree with the paper, else `OK` (0).

    Raises:
        InputError: the program runs on several MPI ranks; `at_a_time` < 1; another batch uses `out`; or no files can be
            written there.
    """
    start_time, page = time.monotonic(), Page(out, quick=quick)
    run_jobs([*page.jobs.values()], out, at_a_time)
    head_file = DATA_FOLDER.parents[1] / ".git" / "HEAD"
    name = head_file.read_text().strip().removeprefix("ref: ") if head_file.exists() else "not known"
    commit = (head_file.parent / name).read_text().strip() if (head_file.parent / name).is_file() else name
    facts = {"commit": commit[:12], "code": code_hash(), "date": time.strftime("%F")}
    facts["machine"] = f"{platform.system()} {platform.machine()}, {len(os.sched_getaffinity(0))} cores"
    facts["command"] = f"python3 -m thinlayer reproduce{' --quick' * quick}"
    return page.write(facts | {"seconds": f"{time.monotonic() - start_time:.0f}"})


class Page:
    """The page with the numbers of the paper, and the runs of studies whose results it shows.

    Attributes:
        out: folder of the page and of the runs.
        paper: content of studies/data/paper.toml.
        jobs: name of a run -> the run, whose folder in `out` has this name.
        results: name of a run -> content of its run.json; {} if there is none.
        unfinished: names of the runs that are not finished.
        rows: for each number of the paper its label, the check that computes it, and the verdict.
        summary: sentence that counts the numbers that hold, the figures, and the errors of the paper that are
            corrected.
    """

    def __init__(self, out: Path, *, quick: bool) -> None:
        self.out, self.paper = out, tomllib.loads((DATA_FOLDER / "paper.toml").read_text(encoding="utf-8"))
        self.jobs = {}
        for name, run in self.paper["runs"].items():
            options = run.get("options", {}) | quick_options(run["study"], quick)
            self.jobs[name] = Job(run["study"], options, out / name, run["seconds"][not quick])

    def write(self, facts: Mapping[str, str]) -> int:
        """Write index.html and reproduce.json from the results of the runs, and return the exit status.

        Args:
            facts: name -> text that says how the page was made, such as versions and date.

        Returns:
            3 if a run or a number is missing, else 1 if a number does not agree with the paper, else 0.
        """
        self.results = {name: job.run_content() or {} for name, job in self.jobs.items()}
        self.unfinished = [name for name, result in self.results.items() if result.get("error", "no run") is not None]
        self.rows = [row for part in self.paper["sections"] for row in self.number_rows(part["rows"], part["id"])]
        n_drawn, n_wrong = sum(part.get("figures", 0) for part in self.paper["sections"]), len(self.paper["errata"])
        checked = f"{count_text(self.rows)} numbers hold"
        self.summary = f"{checked}; {n_drawn} figures; {n_wrong} places of the paper corrected"
        content = {**facts, "versions": package_versions(), "unfinished": self.unfinished, "rows": self.rows}
        for name, text in {"reproduce.json": json.dumps(content, indent=1), "index.html": self.html(facts)}.items():
            with replace_file(self.out / name) as file:
                file.write(text.encode())
        print_safely(f"{self.summary}\nwritten to {self.out / 'index.html'}")
        return max(UNFINISHED if self.unfinished else OK, *(STATUS_OF_VERDICT[row["verdict"]] for row in self.rows))

    def number_rows(self, entries: Iterable[Mapping[str, str]], section: str = "") -> list[Entries]:
        """Make the rows of a table of numbers from entries of paper.toml and from the checks of the runs.

        An entry names a run and has a pattern for names of its checks, in which * stands for any text. Each check with
        a matching name gives a row. The text that * stands for replaces the * in the entry's label. If no check
        matches, the entry gives one row with the verdict "missing".

        Args:
            entries: for each entry "run" (name of the run), "check" (the pattern), and perhaps "label" and "printed"
                (the number in the paper, as text).
            section: identifier of the section of the page, stored in the rows.

        Returns:
            Rows, each with the name, value and bounds of the check (None if it is missing), the label, and the verdict
            "holds", "fails" or "missing".
        """
        rows: list[Entries] = []
        for entry in entries:
            run, pattern = entry["run"], re.compile("(.*)".join(map(re.escape, entry["check"].split("*"))))
            about = {"section": section, "run": run, "study": self.jobs[run].study, "options": self.jobs[run].options}
            checks = self.results[run].get("checks", ())
            matches = [(check, match.groups()) for check in checks if (match := pattern.fullmatch(check["name"]))]
            for check, wildcard_texts in matches or [({"name": entry["check"], **MISSING_CHECK}, ())]:
                label = fill_stars(entry.get("label", check["name"]), wildcard_texts)
                computed = number_text(check["value"], "#") if matches else ""
                verdict = {True: "holds", False: "fails", None: "missing"}[check["passed"]]
                texts = {"label": label, "printed": entry.get("printed", ""), "verdict": verdict}
                rows.append(about | check | texts | {"computed": computed, "bounds": bounds_text(check)})
        return rows

    def html(self, facts: Mapping[str, str]) -> str:
        """Return the HTML of the whole page; `facts`, name -> text, say how it was made."""
        values = {name: paragraphs_html(text) for name, text in self.paper["paper"].items() if name != "bibtex"}
        values |= {name: escape(self.paper["paper"][name].strip()) for name in ("title", "bibtex")}
        parts = self.paper["sections"]
        values["links"] = "".join(fill_template("link", id=part["id"], short=part["short"]) for part in parts)
        values |= {"tiles": "".join(map(self.tile_html, parts)), "sections": "".join(map(self.section_html, parts))}
        values["gaps"] = "".join(fill_template("gap", name=name, log=f"{name}{LOG_SUFFIX}") for name in self.unfinished)
        values["errata"] = html_table(ERRATA_COLUMNS, [*map(self.erratum_row, self.paper["errata"])])
        values["summary"] = self.summary
        return fill_template("page", **values, facts=html_pairs(facts), versions=html_pairs(package_versions()))

    def tile_html(self, part: Entries) -> str:
        """Return the HTML of a section's tile: its name, its sketch, how many numbers hold, and what they tell.

        Args:
            part: table of the section in paper.toml. In its text "telling", the computed values of the section's rows
                replace the signs *, the first value the first sign.
        """
        rows = [row for row in self.rows if row["section"] == part["id"]]
        telling = fill_stars(part["telling"], [row["computed"] or "?" for row in rows])
        values = {"id": part["id"], "short": part["short"], "count": count_text(rows), "telling": line_html(telling)}
        values["state"] = max((row["verdict"] for row in rows), key=STATUS_OF_VERDICT.__getitem__)
        return fill_template("tile", **values, sketch=html_picture(DATA_FOLDER / part["sketch"], "", "image"))

    def section_html(self, part: Entries) -> str:
        """Return the HTML of one section of the page: statements of the paper, results, pictures and numbers.

        Args:
            part: table of the section in paper.toml, with its texts, pictures and entries of numbers.
        """
        values = {"id": part["id"], "title": line_html(part["title"])}
        values |= {name: paragraphs_html(part[name]) for name in ("problem", "says", "computed")}
        values["sketch"] = html_picture(DATA_FOLDER / part["sketch"], part["sketch_says"])
        values["pictures"] = "".join(html_picture(self.out / name, text) for name, text in part["pictures"].items())
        run_names = dict.fromkeys(row["run"] for row in part["rows"])
        values["details"] = "".join(self.details_html(name, part.get("tables", ())) for name in run_names)
        rows = [row for row in self.rows if row["section"] == part["id"]]
        groups = {title: [row for row in rows if bool(row["printed"]) == shown] for title, shown in GROUPS.items()}
        values["numbers"] = "".join(html_table(COLUMNS, group, title) for title, group in groups.items() if group)
        order_bounds = dict.fromkeys(row["bounds"] for row in rows if "order" in row["label"])
        reasons = [self.paper["bounds"].get(bounds, "") for bounds in order_bounds]
        values["laws"] = "".join(self.law_html(name, title) for name, title in part["laws"].items())
        return fill_template("section", **values, reasons=paragraphs_html("\n\n".join(reasons)))

    def law_html(self, name: str, title: str) -> str:
        """Return the HTML of a link to the page of a law; "" where there are no pages, as in an installed package.

        Args:
            name: name of the law's page, without its ending.
            title: name of the law's class.
        """
        pages = [path for pattern in LAW_PAGES if (path := DATA_FOLDER.parents[1] / pattern.format(name)).exists()]
        return fill_template("law", title=title, link=os.path.relpath(pages[0], self.out)) if pages else ""

    def details_html(self, run: str, tables: Iterable[str]) -> str:
        """Return the HTML of a box with details of a run, closed until a reader opens it.

        The box shows the run's command, tables, checks and parameters.

        Args:
            run: name of the run.
            tables: names of csv files, as RUN/FILE. Only those of this run are shown.
        """
        result, job = self.results[run], self.jobs[run]
        paths = [path for name in tables if name.startswith(f"{run}/") and (path := self.out / name).exists()]
        values = {"command": escape(shlex.join(job.command_words)), "seconds": f"{result.get('seconds', 0):.0f}"}
        values["tables"] = "".join(fill_template("csv", name=p.name, text=escape(str(Table.load(p)))) for p in paths)
        values["numbers"] = html_table(COLUMNS, self.number_rows([{"run": run, "check": "*"}]))
        return fill_template("details", **values, parameters=html_pairs(result.get("parameters", {})))

    def erratum_row(self, entry: Mapping[str, str]) -> dict[str, str]:
        """Return a row of the table of the paper's errors: name of a column -> text.

        Args:
            entry: table of one error in paper.toml. What shows the error is a check of a run, in "run" and "check", or
                a text, in "evidence".
        """
        rows = self.number_rows([entry]) if "check" in entry else ()
        evidence = "; ".join(f"{row['label']}: {row['computed']}" for row in rows) or entry["evidence"]
        return {**entry, "shown": f"[{evidence}](#{entry['section']})"}


# ---------------------------------------------------------------- pieces of HTML
@cache
def template_pieces() -> dict[str, Template]:
    """Return name -> piece of the template studies/data/paper.html.

    In the file, a comment "part: NAME" stands before each piece; the first piece, without a comment, is called "page".
    """
    page_text, *rest = re.split(r"<!-- part: (.*) -->\n", (DATA_FOLDER / "paper.html").read_text(encoding="utf-8"))
    return {"page": Template(page_text)} | dict(zip(rest[::2], map(Template, rest[1::2]), strict=True))


def fill_template(piece: str, **values: str) -> str:
    """Return the piece of the template with a given name, with its placeholders filled in.

    Args:
        piece: name of the piece.
        **values: for each placeholder $NAME in the piece, the HTML text that replaces it, as argument NAME.
    """
    return template_pieces()[piece].substitute(values)


def fill_stars(text: str, values: Iterable[str]) -> str:
    """Return a text whose signs * are replaced by values, the first sign by the first value."""
    return reduce(lambda text, value: text.replace("*", value, 1), values, text)


def count_text(rows: Sequence[Entries]) -> str:
    """Return how many of some rows hold, as "2 of 3"."""
    return f"{sum(row['verdict'] == 'holds' for row in rows)} of {len(rows)}"


def number_text(value: float, form: str = "") -> str:
    """Return a number with 3 digits, in markup; whole numbers, and those of 100 or more, have all digits before the point.

    Args:
        value: the number.
        form: "#" keeps zeros at the end, as in 1.00; "" drops them.
    """
    if value % 1 == 0 or abs(value) >= 100:
        return f"{value:.0f}"
    # 0.8575 gives the same text as a value that differs by an error of rounding
    digits, _, power = f"{value * (1 + 1e-9):{form}.3g}".partition("e")
    return f"${digits} \\cdot 10^{{{int(power)}}}$".replace("$1 \\cdot ", "$") if power else digits.rstrip(".")


def bounds_text(check: Entries) -> str:
    """Return the bounds of a check as text: "≥ a" or "≤ b" if there is only one, else "a to b".

    If the bounds are close together, the text is "middle ± half their distance" instead.
    """
    low, high = check["low"], check["high"]
    if low is None or high is None:
        return "".join(f"{sign} {number_text(end)}" for sign, end in (("≥", low), ("≤", high)) if end is not None)
    half_width = (high - low) / 2
    text = number_text(low + half_width) + f" ± {number_text(half_width)}" * (half_width > 0)
    return text if half_width <= MAX_HALF_WIDTH_RATIO * abs(low) else f"{number_text(low)} to {number_text(high)}"


def html_table(headings: Mapping[str, str], rows: Sequence[Entries], title: str = "") -> str:
    """Return the HTML of a table, without the columns that are empty.

    Args:
        headings: name of a column that is shown -> its heading.
        rows: for each row, name of a column -> text.
        title: text above the table.
    """
    body = ""
    shown = {name: heading for name, heading in headings.items() if any(row[name] for row in rows)}
    for row in rows:
        cells = [fill_template("cell", name=name, heading=shown[name], text=line_html(row[name])) for name in shown]
        body += fill_template("row", verdict=row.get("verdict", ""), cells="".join(cells))
    return fill_template("table", title=title, head="".join(map("<th>{}</th>".format, shown.values())), body=body)


def html_pairs(values: Mapping[str, object]) -> str:
    """Return the HTML of a list of names, each with its value; values that are not texts are shown as JSON."""
    texts = {name: value if isinstance(value, str) else json.dumps(value) for name, value in values.items()}
    return "".join(fill_template("pair", name=escape(name), value=escape(text)) for name, text in texts.items())


def html_picture(path: Path, text: str, piece: str = "figure") -> str:
    """Return the HTML of the picture in the file `path`, embedded in the page.

    If the file is missing, a note stands in its place.

    Args:
        path: the file.
        text: caption.
        piece: name of the piece of the template: "figure", or "image" for a picture without caption.
    """
    if not path.exists():
        return fill_template("no figure", caption=line_html(text))
    img = {"alt": escape(re.sub(r"[$`\\{}]", "", text)), "type": guess_type(path.name)[0] or "", "name": path.stem}
    return fill_template(piece, **img, content=base64.b64encode(path.read_bytes()).decode(), caption=line_html(text))
