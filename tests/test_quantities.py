"""Texts with a unit: numbers in the units of a script or of a description; without them nothing needs pint."""

from __future__ import annotations

import re
import sys
from dataclasses import fields
from inspect import signature
from math import degrees
from operator import attrgetter

import pytest

import forms
from forms import LinearElastic
from forms.base import InputError
from tests.documents import PAGES
from tests.refused import refused
from tests.test_descriptions import described
from thinlayer import Units
from thinlayer.system import units as module

MM, SI, HOURS = Units("mm", "MPa"), Units("m", "Pa"), Units("mm", "MPa", "h")
SYSTEMS = {"mm, MPa": MM, "m, Pa": SI, "mm, MPa, s": Units("mm", "MPa", "s"), "mm, MPa, h": HOURS}
NUMBERS = [
    ("2 GPa", "mm, MPa", 2e3),
    ("2 GPa", "m, Pa", 2e9),
    ("3 psi", "mm, MPa", 3 * 0.45359237 * 9.80665 / 25.4**2),  # pounds of force per square inch
    ("0.2mm", "m, Pa", 2e-4),
    (" -7 um ", "mm, MPa", -7e-3),
    ("5 kN", "mm, MPa", 5e3),
    ("77 kN/m^3", "mm, MPa", 7.7e-5),
    ("12e-6/K", "mm, MPa", 12e-6),
    ("30 deg", "mm, MPa", 30.0),
    ("0.5 rad", "mm, MPa", degrees(0.5)),
    ("5 %", "mm, MPa", 0.05),
    ("0.3 mm/m", "m, Pa", 3e-4),
    ("2 J/m^2", "mm, MPa", 2e-3),  # N/mm: an energy per area
    ("7850 kg/m^3", "mm, MPa, s", 7.85e-9),  # tonnes per mm^3
    ("3 MPa min", "mm, MPa, h", 0.05),
    ("4e-3 MPa^-3.5/s", "mm, MPa, h", 14.4),  # of Norton's creep
]


@pytest.mark.parametrize(("text", "system", "number"), NUMBERS)
def test_numbers(text, system, number):
    assert SYSTEMS[system](text) == pytest.approx(number, rel=1e-14)


def test_kinds():
    assert MM("2 GPa", "stress") == 2000.0
    assert MM("30 deg", "angle") == 30.0
    for kind, words in (
        ("length", "the length is '2 GPa'; give one with a unit of length, not of stress"),
        ("ratio", "the ratio is '2 GPa'; give one with a unit of ratio, not of stress"),
        ("strain", "the kind of a quantity is 'strain'; allowed: length, stress, time, ratio, "),
    ):
        refused(InputError, words, MM, "2 GPa", kind)


@pytest.mark.parametrize(
    "text", ["mm", "2", "7e3", "2,5 GPa", "2 mm?", "2 GPa)", "2 mpaa", "20 degC", "2e-5/degC", 2.0, None, "2 A"]
)
def test_refused(text):
    refused(InputError, "; (give a text such as|name a third unit)", MM, text)


def test_units_are_those_of_lengths_stresses_and_times():
    refused(InputError, "the stress is '1 mm'", Units, "mm", "mm")
    refused(InputError, "the time is '1 m'; give one with a unit of time, not of length", Units, "mm", "MPa", "m")
    refused(InputError, "'3 h'; name a third unit, of times", MM, "3 h")


PLAIN = """
mesh = "joint.msh"
units = "mm, MPa, h"
times = [0.5, 2]
tolerance = 0.05
body = {A = {E = 210e3, nu = 0.3}, B = {law = "NortonCreep", E = 70e3, nu = 0.2, A = 1e-4, n = 3.5}}
supports = {LEFT = {x = {times = [0, 2], values = [0, 0.1]}}, BED = -1e-3, "(40, 0)" = {y = 2e-3}}
tractions = {TOP = [3, -50], "2 MPa" = {pressure = 0.2}}
body_force = {A = [0, -7.7e-5]}
loads = [{place = [10, 2], force = [0, -30]}, {first = "1 mm", second = "BACK", force = [1, 2, 4]}]
goals = {pull = {kind = "displacement", x = [80, 1], direction = [1, 0]}, reaction = {place = "3 m", direction = [0, 1]}}
layer = {law = "MohrCoulomb", G = 5, K = 9, cohesion = 0.1, friction_angle = 30, eps = 0.3, eigenstrain = -0.01}
"""
TEXTS = [
    "times=['30 min', 2]",
    "tolerance='5 %'",
    "body.A.E='210 GPa'",
    "body.B.A='1e-4/h/MPa^3.5'",
    "supports.LEFT.x={times = [0, '2 h'], values = [0, '100 um']}",
    "supports.BED=-1 um",
    "supports.'(40, 0)'.y='2 um'",
    "tractions.TOP=['3 N/mm^2', '-500 bar']",
    "tractions.'2 MPa'.pressure=0.2 MPa",
    "body_force.A=[0, '-77 kN/m^3']",
    "loads.1={place = ['1 cm', 2], force = [0, '-30 N/mm']}",
    "loads.2.force=['1 kN/m', 2, '40 N/cm']",
    "goals.pull.x=['8 cm', 1]",
    "layer.G=5e6 Pa",
    "layer.cohesion=1 bar",
    "layer.friction_angle=30 deg",
    "layer.eps=300 um",
    "layer.eigenstrain=-1 %",
]


def test_descriptions(tmp_path):
    """Each text is the number that it replaces; names of places that look like quantities stay names."""
    plain, texts = described(tmp_path, PLAIN), described(tmp_path, PLAIN, *TEXTS)
    for name in [field.name for field in fields(plain) if field.name not in ("file_table", "body", "layer")]:
        assert rounded(getattr(texts, name)) == rounded(getattr(plain, name)), name
    for name, where in (("body", "A"), ("body", "B"), ("layer", None)):
        actual, expected = (getattr(description, name)[where] for description in (texts, plain))
        assert actual.law.parameters() == pytest.approx(expected.law.parameters(), rel=1e-12)
        assert actual.eps == pytest.approx(expected.eps, rel=1e-12)
        assert rounded(actual.eigenstrain) == rounded(expected.eigenstrain)


def rounded(value):
    """The repr of an entry with twelve digits of each number."""
    match value:
        case float():
            return float(f"{value:.12g}")
        case dict():
            return {key: rounded(item) for key, item in value.items()}
        case list() | tuple():
            return [rounded(item) for item in value]
    return rounded(value.values) if hasattr(value, "key_path") else value


def test_ratios_and_angles_need_no_units_of_the_file(tmp_path):
    parsed = described(tmp_path, PLAIN.replace("units =", "# "), "tolerance=7%", "layer.friction_angle=20 deg")
    assert (parsed.units, parsed.tolerance, parsed.layer[None].law.friction_angle) == (None, {"traction": 0.07}, 20.0)


@pytest.mark.parametrize(("plane", "place", "force"), [("axisymmetric", [10, 2], "3 N"), ("strain", [10, 2, 1], "3 N")])
def test_forces_that_are_not_per_length(tmp_path, plane, place, force):
    more = (f"plane={plane}", f"loads=[{{place = {place}, force = {[0, force, 0][: len(place)]}}}]")
    assert described(tmp_path, PLAIN, *more).loads[0]["force"][1] == 3.0
    refused(
        InputError, "loads.1.force.2: the force is", described, tmp_path, PLAIN, more[0], more[1].replace(" N", " N/m")
    )


def test_without_pint(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pint", None)
    module._registry.cache_clear()
    assert described(tmp_path, PLAIN).layer[None].eps == 0.3
    message = r"pint is not installed: pip install 'thinlayer\[units\]'"
    refused(InputError, message, described, tmp_path, PLAIN, "layer.eps=0.3 mm")
    refused(InputError, message, Units, "mm", "MPa")
    module._registry.cache_clear()


def test_a_law():
    assert LinearElastic.young(E=MM("2 GPa"), nu=0.4) == LinearElastic.young(E=2e3, nu=0.4)


def test_units_of_the_cheat_sheet():
    """Each row of its table, and its sentence on `Units`."""
    page = PAGES["thinlayer/docs/reference/cheat_sheet.md"]
    rows = [
        line.strip("| ").split(" | ") for line in page.partition("## Units")[2].splitlines() if line.startswith("| ")
    ]
    for length, force, time, mass, stress, steel, gravity in rows[1:]:
        units, numbers = Units(length, stress, time), [*steel.split(", "), gravity]
        for text, number in zip(["210 GPa", "7850 kg/m^3", "9.81 m/s^2"], numbers, strict=True):
            assert units(text) == pytest.approx(float(number), rel=1e-12), (length, text)
        assert (units(f"1 {force}"), units(f"1 {mass}")) == pytest.approx((1.0, 1.0), rel=1e-12)
    said = dict(re.findall(r'`units\("(.*?)"\)` is ([\d.e-]+\d)', page))
    assert {text: SYSTEMS["mm, MPa, s"](text) for text in said} == pytest.approx({t: float(n) for t, n in said.items()})
    assert len(said) == 2


def test_laws_of_the_cheat_sheet():
    """Parameters in their order; "..." are the moduli."""
    page = PAGES["thinlayer/docs/reference/cheat_sheet.md"].partition("## Laws")[2].partition("## Units")[0]
    calls = re.findall(
        r"([\w.]+)\((.*?)\)(?=,? |$)", "".join(re.findall(r"^    .*\n", page, re.MULTILINE)), re.MULTILINE
    )
    assert len(calls) >= 11
    for name, arguments in calls:
        if name != "Stack":  # of tuples
            names = re.sub(r"^\.\.\.", "lmbda, mu", arguments).split(", ")
            names = [name for name in names if "=" not in name]
            assert names == list(signature(attrgetter(name)(forms)).parameters)[: len(names)], name
