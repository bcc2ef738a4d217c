"""The study of heat and cure holds what it promises."""

from thinlayer.running.cli import main


def test_the_study_of_cure(tmp_path):
    assert main(["run", "cure", "--quick", "--out", str(tmp_path)]) == 0
    assert {path.name for path in tmp_path.glob("*.png")} == {"shear_lag.png", "bending.png", "curing.png"}
