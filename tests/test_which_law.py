"""The study of which law to use: its exact layers and its errors are those of other codes, its warnings those it shows."""

from __future__ import annotations

import re

import pytest

from studies import which_law
from studies.rates import LAWS
from tests.documents import PAGES
from thinlayer.running.cli import studies
from thinlayer.running.record import Record

MU = 40.0  # of the layer over its thickness; bodies have E = 100, nu = 0.3


COMPARED = ("order_0", "order_1", "rubber")
# traction, jump, compliance of order 0, order 1 and Rubber, by elements of higher degree; two digits
ROLLERS = {
    0.3: ((9.7e-2, 1.1e-1, 1.2e-2), None, (2.9e-3, 4.9e-3, 1.3e-3)),
    0.45: ((8.8e-2, 2.3e-1, 5.0e-2), None, (2.8e-3, 7.5e-3, 1.2e-3)),
    0.499: ((7.9e-2, 0.42, 9.4e-2), (1.8e-2, 8.7e-2, 1.6e-2), (3.0e-3, 9.3e-3, 7.8e-4)),
    0.5: (None, None, (3.0e-3, 9.6e-3, 8.6e-4)),
}  # eps = 1/8


@pytest.fixture
def row(tmp_path):
    """Row of the study for a set-up, a ratio and a thickness."""

    def of(set_up, nu, eps, mu=None):
        with Record("which_law", tmp_path, {}) as record:
            return which_law._error_row(record, set_up, mu or MU * eps, nu, eps)

    return of


def errors(row, law):
    return [row[f"{quantity}_{law}"] for quantity in which_law.QUANTITIES]


def test_errors_between_rollers(row):
    set_up = which_law.Rollers(1 / 16)
    for nu, printed in ROLLERS.items():
        table_row = row(set_up, nu, 1 / 8)
        for law, wanted in zip(COMPARED, printed, strict=True):
            assert wanted is None or errors(table_row, law) == pytest.approx(wanted, rel=0.08), (nu, law)
    assert table_row["traction_order_1"] is None  # nu = 1/2
    assert table_row["traction_edges"] is None  # no free ends


PAGE = PAGES["thinlayer/docs/theory/which_law.md"]
LABELS = {  # in its table
    "order 0": "order_0", "LinearElastic, order 1": "order_1", "order 1, free ends": "edges",
    "Rubber, order 1": "rubber", "Rubber, free ends": "rubber_edges",
}  # fmt: skip


def test_the_table_of_the_page(row):
    """Two of its columns computed once more, its errors of two digits; studies that it names exist."""
    cells = re.findall(r"^\| (rollers|free), ([\d,]+) \| (.*?) \|(.*)\|$", PAGE, re.MULTILINE)
    assert len(cells) == 8
    ratios = [float(nu) for nu in re.search(r"E/mu \| law \|(.*)\|", PAGE)[1].replace("nu =", "").split("|")]
    rollers, free = which_law.Rollers(1 / 32), which_law.FreeEnds(False)
    set_ups = {"rollers": (rollers, "200,000", 0.499), "free": (free, "200", 0.49)}
    for name, (set_up, contrast, nu) in set_ups.items():
        table_row = row(set_up, nu, 1 / 16, 100.0 / float(contrast.replace(",", "")))
        for ends, E_over_mu, label, line in cells:
            if (ends, E_over_mu) != (name, contrast):
                continue
            law = LABELS[label.replace("`", "")]
            cell = line.split("|")[ratios.index(nu)].strip()
            printed = [None, None] if cell == "-" else [float(number) / 100 for number in cell.split(";")]
            wanted = pytest.approx(printed, rel=0.07) if None not in printed else printed
            assert [*errors(table_row, law)[:2]] == wanted, (name, law)
    assert set(re.findall(r"`run (\w+)", PAGE)) <= set(studies())
    assert set(re.findall(r"--law (\w+)", PAGE)) <= set(LAWS)
