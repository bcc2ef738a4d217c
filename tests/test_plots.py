"""What is in pictures: their lines are the data."""

from __future__ import annotations

import numpy as np
import pytest

from forms.base import InputError
from studies.problems import sliding_bar
from tests.contact_bars import bar, coulomb
from tests.refused import refused
from thinlayer import Structure, Surface, Table, plotting, solve
from thinlayer.solving.harmonic import HarmonicResponse


def test_rates_have_the_slope_they_say():
    eps = [0.4, 0.2, 0.05]
    table = Table({"eps": e, "error_traction": 3 * e**1.5, "error_jump": 2 * e} for e in eps)
    (axes,) = plotting.rates(table, reference=1.5).axes
    lines = {line.get_label(): line.get_xydata() for line in axes.lines}
    assert lines["traction"] == pytest.approx(np.column_stack([eps, table["error_traction"]]))
    assert lines["jump"] == pytest.approx(np.column_stack([eps, table["error_jump"]]))
    slopes = np.diff(np.log(lines["slope 1.5"]), axis=0)
    assert slopes[:, 1] / slopes[:, 0] == pytest.approx(1.5)


def test_responses_have_amplitudes_phases_and_resonances():
    """Of two oscillators, in cycles per time; frequencies in any order."""
    omega, answers, pairs = np.array([2.0, 0.5, 1.0, 4.0]), {}, {}
    for label, (natural, loss) in {"soft": (1.0, 0.2), "hard": (3.0, 0.1)}.items():
        answers[label] = HarmonicResponse(omega, {"tip": 1 / (natural**2 * (1 + 1j * loss) - omega**2)})
        pairs[label] = np.array([natural, 7.0]), np.array([loss, 0.3])
    amplitude, phase = plotting.response(answers, "tip", "f (Hz)", "u (mm)", resonances=pairs).axes
    lines = {axes: {line.get_label(): line.get_xydata().T for line in axes.lines} for axes in (amplitude, phase)}
    order = np.argsort(omega)
    for label, answer in answers.items():
        for axes, values in (
            (amplitude, abs(answer.values["tip"])),
            (phase, np.degrees(np.angle(answer.values["tip"]))),
        ):
            assert lines[axes][label] == pytest.approx(np.array([omega / (2 * np.pi), values])[:, order])
    assert [text.get_text() for text in amplitude.texts] == ["loss 0.2", "loss 0.1"]  # 7 is out of range
    assert [text.xy[0] for text in amplitude.texts] == pytest.approx(np.array([1.0, 3.0]) / (2 * np.pi))
    assert amplitude.get_yscale() == "log"
    refused(InputError, "observed quantity 'top'", lambda: plotting.response(answers, "top", "", ""))
    for wrong, words in ((omega, "as Modes.loss"), ((1, 2), "as Modes.loss"), ({"stiff": None}, "response 'stiff'")):
        refused(InputError, words, plotting.response, answers, "tip", "", "", resonances=wrong)


def test_symbols_are_written_as_mathematics(tmp_path):
    drawn = {"eps = 1": ([0, 1], [0, 1]), "t_T": ([0, 1], [1, 0])}
    picture = plotting.curves(drawn, "mu w_N (10^3 N)", save=tmp_path / "a.svg")
    assert [text.get_text() for text in picture.legends[0].get_texts()] == [r"$\varepsilon$ = 1", "$t_{T}$"]
    assert picture.axes[0].get_xlabel() == r"$\mu$ $w_{N}$ ($10^{3}$ N)"
    assert "ε" in (tmp_path / "a.svg").read_text()  # text stays text


def test_contact_along_s():
    """Pressure, friction, slip and opening by arc length; openings are upwards."""
    report = bar(8, coulomb("soft"))
    p, t_T, u_T, opening = plotting.along(report.surface, report).axes
    (line,) = report.surface.along(report.p)
    for axes, values in ((p, report.p), (t_T, report.t_T[:, 0]), (u_T, report.u_T[:, 0]), (opening, -report.u_N)):
        x, y = axes.lines[0].get_xydata().T
        is_finite = np.isfinite(y)
        assert x == pytest.approx(line.s)
        assert y[is_finite] == pytest.approx(values[is_finite])
        hidden = report.status == "pinned" if axes in (p, t_T) else False  # of which the force is the support's
        assert (is_finite == ~np.isin(x, line.s[np.broadcast_to(hidden, x.shape)])).all()


def test_jumps_along_s():
    joint, setup = sliding_bar(8)
    state = solve(Structure(joint, **setup).interface(coulomb("soft")))
    surface = Surface(state.model)
    t, w = (surface.frame(field(state)) for field in (surface.traction, surface.jump))
    for axes, values in zip(plotting.along(surface, state).axes, (t[1], t[0], w[1], w[0]), strict=True):
        (line,) = surface.along(values)  # in the order t_N, t_T, w_N, w_T
        assert axes.lines[0].get_xydata() == pytest.approx(np.column_stack([line.s, line.values]))
