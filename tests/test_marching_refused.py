"""Times, options and observers that a march cannot take are refused before a folder is made."""

from __future__ import annotations

import numpy as np

from forms.base import InputError
from tests.refused import refused
from tests.viscous_joints import interface
from thinlayer import Adaptive, march


def test_bad_input(tmp_path):
    for times, options, message in [
        ([], {}, "increase"),
        ([0.2, 0.1], {}, "increase"),
        ([0.1, float("nan")], {}, "finite"),
        (0.1, {}, "sequence of numbers"),
        ([0.1], {"theta": 0.4}, "theta is 0.4"),
        ([0.1], {"keep": "some"}, "'all', 'last'"),
        ([0.1], {"resume": True}, "resume needs one"),
        ([0.1], {"observe": {"t": len}}, "column 't'"),
        ([0.1], {"observe": {"a": 5}}, "must be a function of a state"),
        ([0.1], {"observe": len}, "name of a column"),
        ([0.1], {"observe": {"a": lambda state: None}}, r"observe\['a'\] at t = 0: .* returns a real number"),
        ([0.1], {"observe": {"a": lambda state: np.complex128(1 + 2j)}}, r"observe\['a'\] at t = 0: .* real number"),
        ([0.1], {"observe": {"a": lambda state: 1 / 0}}, r"observe\['a'\] at t = 0: ZeroDivisionError: division"),
        ([0.1], {"theta": 1j}, "theta is 1j; it must be a number"),
        ([0.1], {"metod": "newton"}, "unknown argument of march 'metod', did you mean 'method'"),
        ("12", {}, "sequence of numbers"),
        ([0.1], {"out": ""}, "name of a folder"),
        ([0.1], {"options": {"ksp_nonsense": 1}}, "not read"),
        (Adaptive(-1.0, 0.1), {}, "increase"),
    ]:
        if not options.get("resume"):
            options = {"out": tmp_path / "out"} | options
        refused(InputError, message, march, interface(), times, **options)
        assert not (tmp_path / "out").exists()


def test_bad_adaptive_steps():
    refused(InputError, r"tolerance is -1\.0; allowed: a number > 0", Adaptive, 1.0, first=0.1, tolerance=-1.0)
    refused(InputError, "at has t = 2; times increase to end = 1", Adaptive, 1.0, 0.1, at=[2.0])
