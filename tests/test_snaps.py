"""Snaps that are easily missed: at the end of a step, on coarse times, within a step that comes back."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import ufl

from forms import LinearElastic, NonMonotoneUnrelaxed
from forms.base import InputError
from geometry import sandwich
from studies.problems import phases_on_s
from tests.own_laws import Stiffening
from tests.refused import refused
from thinlayer import Adaptive, SolveError, Structure, ThinLayer, march
from thinlayer.pointwise.columns import EXCESS_TOLERANCE
from thinlayer.surface.law_points import layer_shares

pytestmark = pytest.mark.few(5)

CHI = np.array([[-0.3, 0.5], [0.5, 0.9]])
LAW = NonMonotoneUnrelaxed(60.0, 40.0, 1.2, 0.015, CHI)
SOFT = LinearElastic.young(100.0, 0.3)


def blocks(of_t=lambda t: t, *, body=SOFT, law=LAW, top=None, kind=Structure.interface, eigenstrain=None):
    """Eight columns, sheared and pulled, more at the right end; they switch in four snaps as of_t goes from 0 to 1."""
    joint = sandwich(1.0, 0.5, 0.5, 0.125, cell="quadrilateral", structured=True)
    top = top or {"x": lambda x, t: 0.03 * of_t(t), "y": lambda x, t: of_t(t) * (0.05 * x[0] - 0.01)}
    plates = Structure(joint, body=body, supports={"BOTTOM": 0.0, "TOP": top}, element="Q1")
    layer = ThinLayer(law, 0.05, at=1.0, eigenstrain=eigenstrain)
    return plates.full(layer, cells_through=2) if kind is Structure.full else kind(plates, layer)


def excesses(history):
    """Of every state the largest excess of a column."""
    law = history.model.layers["S"].law
    for state in history:
        columns = state.model.quadratures["layer"].columns
        phase, drive, bound = (columns.column_means(state.memory["layer"][:, k]) for k in (0, 2, 3))
        yield law.excess(np.rint(phase), drive, bound).max()


def check(history, t=None, lost=None, rel=1e-9):
    """Times and losses of snaps; energy balance; no column is left in a phase that another one beats."""
    if t is not None:
        assert [snap.t for snap in history.snaps] == pytest.approx(t, rel=rel)
    if lost is not None:
        assert [snap.lost for snap in history.snaps] == pytest.approx(lost, rel=1e-6)
    assert all(snap.lost > 0 for snap in history.snaps)
    assert np.abs(history.table["imbalance"]).max() < 1e-9
    assert np.diff(history.t).min() >= 0


@cache
def reference():
    """Times and losses of the snaps of one march of one step."""
    history = march(blocks(), [1.0])
    assert len(history.snaps) == 4
    assert max(excesses(history)) < 3 * EXCESS_TOLERANCE
    for snap in history.snaps:
        assert history.at(snap.t) is history.states[snap.row]  # not the one just before it
        energy = history.table["energy"]
        assert energy[snap.row - 1] - energy[snap.row] == pytest.approx(snap.lost, rel=1e-9)
    return np.array([snap.t for snap in history.snaps]), np.array([snap.lost for snap in history.snaps])


@pytest.mark.parametrize("near", [0.0, -1e-11, 1e-9])
def test_a_step_that_ends_at_a_snap(near):
    """The snap comes at the end of the first step or just after it, once."""
    t, lost = reference()
    check(march(blocks(), [t[0] * (1 + near), 1.0]), t, lost)


def test_times_that_are_coarse():
    """Seconds of a clock: times are found to 2e-6, excesses to more than `EXCESS_TOLERANCE`."""
    (t, lost), start, near = reference(), 1e9, 1e-5
    history = march(blocks(lambda t: t - start), [start + 0.5, start + 1], start=start)
    check(history)
    assert [snap.t - start for snap in history.snaps] == pytest.approx(t, abs=near)
    assert [snap.lost for snap in history.snaps] == pytest.approx(lost, rel=1e3 * near)


WAVE, COLD = lambda t: ufl.sin(np.pi * t), lambda T: 0.03 * np.exp(-T / 50)
HEATED = NonMonotoneUnrelaxed(60.0, 40.0, 1.2, COLD, CHI, T=lambda x, t: 40 * x[0] + 50 * np.sin(3 * t))
COMING_BACK = {  # what else is given, end of time, number of steps beside one, numbers of snaps
    "loads": ({"of_t": WAVE}, 1, 4, range(9, 99)),
    "temperature": ({"law": HEATED, "top": {"x": 0.03, "y": 0.02}}, 2, 2, [11]),
    "strains": (
        {"eigenstrain": lambda x, t: [[0, 0], [0, WAVE(t) * (0.2 - x[0])]], "top": {"y": 0}},
        1,
        2,
        range(5, 99),
    ),
}


@pytest.mark.parametrize("name", COMING_BACK)
def test_what_comes_back_within_a_step(name):
    """A half wave in one step is that in several: up, through all snaps, and back, through others."""
    options, end, steps, counts = COMING_BACK[name]
    history, several = (march(blocks(**options), end * np.arange(1, n + 1) / n) for n in (1, steps))
    assert len(history.snaps) in counts
    check(history, [snap.t for snap in several.snaps], [snap.lost for snap in several.snaps])
    if name == "loads":
        assert [snap.t for snap in history.snaps[:4]] == pytest.approx(np.arcsin(reference()[0]) / np.pi, rel=1e-9)
        assert layer_shares(history.last, "S")["plus"] == 0


def test_bodies_that_stiffen():
    """By Newton's method phases are held in a solve as well; the snaps are those of other steps, and not those of SOFT."""
    history, three = (march(blocks(body=Stiffening(32.0, 40.0, 1e4)), times) for times in ([0.6], [0.3, 0.6]))
    check(history, [snap.t for snap in three.snaps], [snap.lost for snap in three.snaps])
    assert len(history.snaps) == 2
    assert abs(history.snaps[0].t - reference()[0][0]) > 1e-3


@pytest.mark.parametrize("kind", [Structure.interface, Structure.full])
def test_columns_that_tie(kind):
    """Columns left and right that come to their threshold together switch together."""
    law = NonMonotoneUnrelaxed(60.0, 40.0, 1.2, 0.015, np.diag([0.2, 1.0]))
    top = {"x": 0.0, "y": lambda x, t: 0.06 * t * (1 - 2 * (x[0] - 0.5) ** 2)}
    history = march(blocks(law=law, top=top, kind=kind), [1.0])
    check(history)
    assert len(history.snaps) == 3
    for state in history:
        phases = phases_on_s(state)[1]
        assert phases == pytest.approx(phases[::-1], abs=1e-12)
        assert set(phases) <= {0.0, 1.0}


class Stuck(NonMonotoneUnrelaxed):
    """Says that other phases have a lower energy, and does not change them."""

    def switched(self, phase, drive, bound):
        return phase


def test_a_law_that_does_not_switch_and_steps_without_an_error_are_refused():
    refused(SolveError, r"switched\(\) keeps its phase", march, blocks(law=Stuck(60.0, 40.0, 1.2, 0.015, CHI)), [1.0])
    words = "steps of NonMonotoneUnrelaxed have no error: give the times to stop at"
    refused(InputError, words, march, blocks(), Adaptive(1.0, 0.1))
