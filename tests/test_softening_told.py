"""Softening that is not declared is told where it is met; bodies that soften are refused."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace

import pytest

from forms import LinearElastic
from forms.base import InputError
from geometry import block
from tests import ranges_told
from tests.mpirun import CLONE
from tests.refused import refused
from tests.softening_bars import HEIGHT, STEEP, WIDTH, C, Fading, Undeclared, bar, openings, sigma
from thinlayer import Structure, ThinLayer, march, solve


def warnings_and_result(model, times):
    """RangeWarnings of a march, or of a solve at a time; and its result."""
    run = march if isinstance(times, list) else solve
    result, messages = ranges_told.with_warnings(lambda: run(model, times))
    return messages, result


def test_softening_is_told_where_it_is_met():
    """Stresses fall beyond w_0/sqrt(2), whatever the unit of length; what rises, or is declared, is not warned of."""
    for unit in (1.0, 1e-3):
        law = Undeclared(0.9, 0.11 * unit)
        model, again = (bar(law, lambda x, t, unit=unit: unit * t) for _ in range(2))
        messages, history = warnings_and_result(model, [0.05, 0.1, 0.15, 0.2, 0.3])
        (message,) = messages
        falling = openings(history) > law.w_0 / math.sqrt(2)
        assert f"at t = {history.t[falling][0]:g} the stress of Undeclared falls at 2 points" in message
        assert "write softens = True" in message
        assert not falling[:2].any()
        assert warnings_and_result(again, 0.05)[0] == []
        assert len(warnings_and_result(again, 0.3)[0]) == 1
    refused(InputError, "follow them by march", lambda: solve(bar(Fading(0.9, 0.11))))


def test_a_step_over_a_loop_is_told():
    """Both states rise, on branches that a fall parts."""
    law = replace(STEEP, fall=0.8)  # too little for the bar to snap back
    ends = [w + C * sigma(law, w) for w in (0.05, 0.105, 0.232)]
    assert warnings_and_result(bar(law), ends[:2])[0] == []
    messages, history = warnings_and_result(bar(law), ends)
    assert openings(history)[1:] == pytest.approx([0.05, 0.105, 0.232], rel=1e-9)
    assert "the stress of Trilinear falls" in messages[0]


def test_bodies_do_not_soften():
    softer = type("Softer", (LinearElastic,), {"softens": True})(3.0, 2.0)
    strip = block(WIDTH, HEIGHT, WIDTH, cell="quadrilateral", structured=True)
    with pytest.raises(InputError, match=r"the stress of Softer falls as strains grow: .* in one row of cells"):
        Structure(strip, body=softer, supports={"TOP": 0.0}).interface(ThinLayer(LinearElastic(1.0, 1.0), 0.1, at=1.0))


def test_warnings_are_seen():
    """On standard error, though FFCx sends warnings to a log that has no handler."""
    script = "import ffcx, mpi4py.MPI as M, thinlayer.errors as f; f.warn('jumps', 'jumps exceed eps', M.COMM_WORLD)"
    done = subprocess.run([sys.executable, "-c", script], cwd=CLONE, capture_output=True, text=True, timeout=240)
    assert "RangeWarning: jumps exceed eps" in done.stderr
