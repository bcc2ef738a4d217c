"""The table of closed forms, literature and independent codes: its rows name runs and tests that have its numbers."""

from __future__ import annotations

import json

import pytest

from forms.ends.constants import free_end
from forms.ends.corner import CornerField
from tests.documents import CLONE, PAGES, names_of_checks
from tests.test_free_ends import INDEPENDENT
from thinlayer.running.cli import main, studies

PAGE = PAGES["thinlayer/docs/theory/validation.md"]
ROWS = [[cell.strip() for cell in line.strip("|\n").split("|")] for line in PAGE.splitlines() if line.startswith("| ")][
    1:
]
VALUE, DEVIATION, SHOWN_BY = 2, 3, 4  # columns
CHECKS = {  # start of a row -> its checks, each with the column that has its number
    "Norton layer": {"traction at t = 0.05, from a spectral solution": DEVIATION},
    "Cooled strips, held flat": {"shear lag, mu = 2 MPa, interface law: largest relative error inside": DEVIATION},
    "Cooled strips, bent": {"curvature with a shear lag, meshed layer: largest relative error": DEVIATION},
    "The same, stiff": {"curvature of the stiffest layer over Timoshenko's, meshed layer": VALUE},
    "Rubber discs, law": {"largest error of the law with a pressure": DEVIATION},
    "Rubber discs, meshed": {
        "largest distance of meshed layers from the closed form, all shape factors": DEVIATION,
    },
    "Double cantilever beam": {"largest force over that of beams": VALUE},
    "The same: dissipated": {"dissipated energy over that of beams": VALUE},
    "End-notched flexure": {"largest force over that of beams": VALUE},
    "Mixed-mode bending": {"lever of 45 mm: largest force over that of beams": VALUE},
    "Bar pulled out": {"friction 0.2: largest force over that of the bar on springs": VALUE},
    "Damping layer": {"largest loss factor over that of the formula": VALUE},
    "Laminated glass": {"laminated glass: largest relative distance from the effective thickness": DEVIATION},
    "Lossy cantilever": {"core of 20 MPa: deflection at half power over that at resonance": VALUE},
    "Punch": {"pressure under the punch on the finest mesh, over (2 + pi) k": VALUE},
    "Thick cylinder": {"cylinder: largest relative error of stress": DEVIATION},
    "Mohr-Coulomb layer": {"lasting friction, normal stress held": VALUE},
    "Brick wall": {"heads with mortar: limit over that of a bed that slides": VALUE},
    "Gap that conducts": {"s = -4.504: opening over that of rods": VALUE},
    "Resin that cures": {"eps = 2.0: stress at the end over the closed form": VALUE},
    "Maxwell": {"largest error of the midpoint rule": DEVIATION},
    "Paper's Fig. 3": {"R1: relative error of the shear force on S, one load step": DEVIATION},
    "Paper's Fig. 4": {
        "delta_0 of the bar, eps = 0.1": VALUE,
        "eps = 0.1: relative error of delta_0, delta_1, up, down, loop_area": DEVIATION,
    },
    "Paper's Fig. 8": {"λ, μ = 1.5e+09, 5e+08 N/mm³: stick nodes, 13 expected": VALUE},
    "The same: slip": {"λ, μ = 1.5e+09, 5e+08 N/mm³: u_T at A, mm": VALUE},
}
COMMANDS = sorted({row[SHOWN_BY] for row in ROWS if row[SHOWN_BY].startswith("run ")})
SHORT = ("run strips", "run layer_friction")


def number(cell: str) -> float:
    return float(cell.strip("<% ")) / (100 if "%" in cell else 1)


def checks_of(row: list[str]) -> dict[str, int]:
    (checks,) = (checks for start, checks in CHECKS.items() if row[0].startswith(start))
    return checks


def test_rows_name_what_there_is():
    """Studies with checks of these names, and tests; each check is of a row."""
    assert len(ROWS) >= 20
    texts = names_of_checks()
    for row in ROWS:
        kind, _, name = row[SHOWN_BY].partition(" ")
        assert row[DEVIATION], row
        if kind != "run":
            assert (CLONE / f"tests/test_{kind}.py").is_file(), row
            continue
        assert name.split()[0] in studies(), row
        assert all(any(text.fullmatch(label) for text in texts) for label in checks_of(row)), row
    assert all(any(row[0].startswith(start) for row in ROWS) for start in CHECKS)


@pytest.mark.parametrize(
    "command", [pytest.param(name, marks=[pytest.mark.long][: name not in SHORT]) for name in COMMANDS]
)
def test_studies_have_the_numbers_of_the_table(command, tmp_path):
    quick = ["--quick"] if "quick" in studies()[command.split()[1]].options else []
    assert main([*command.split(), *quick, "--out", str(tmp_path)]) == 0
    values = {check["name"]: check["value"] for check in json.loads((tmp_path / "run.json").read_text())["checks"]}
    for row in (row for row in ROWS if row[SHOWN_BY] == command):
        for label, column in checks_of(row).items():
            if "<" in row[column]:
                assert abs(values[label]) < number(row[column])
            else:  # deviations are rounded, and gmsh may mesh a little differently
                assert values[label] == pytest.approx(number(row[column]), rel=0.1 if column == DEVIATION else 2e-3), (
                    label
                )
            if column == VALUE and "ratio" in row[0]:
                assert values[label] - 1 == pytest.approx(number(row[DEVIATION]), rel=0.1), label


def test_constants_of_ends_and_corners():
    cells = {row[0]: row for row in ROWS}
    (corner,) = (row for name, row in cells.items() if name.startswith("Corner"))
    (end,) = (row for name, row in cells.items() if name.startswith("Free end"))
    assert abs(CornerField(0.3).exponent / number(corner[VALUE]) - 1) < number(corner[DEVIATION])
    assert free_end(0.3).c_N == pytest.approx(number(end[VALUE]), rel=1e-4)
    assert abs(free_end(0.3).c_N / INDEPENDENT[0.3][0] - 1) == pytest.approx(number(end[DEVIATION]), rel=0.5)
