"""Long work tells on standard error what is done, what is left and the time it takes; short and silenced work nothing."""

from __future__ import annotations

import io
import logging
import re
import sys
from types import SimpleNamespace

import pytest

from forms import LinearElastic
from tests.viscous_joints import JOINT, SETUP
from thinlayer import Structure, ThinLayer, ensemble, march, plotting, thin_enough
from thinlayer.system import progress
from thinlayer.system.progress import ProgressReporter
from thinlayer.system.version import print_safely


class Pipe(io.StringIO):
    def flush(self) -> None:
        self.seen = self.getvalue()


class OutStream(Pipe):
    __module__ = "ipykernel.iostream"


def three_runs(terminal: bool, seconds: float, kind: type[Pipe] = Pipe) -> str:
    """What is told of a sweep of three marches of four steps each, which take `seconds` per step."""
    stream, clock = kind(), SimpleNamespace(now=100.0)
    stream.isatty = lambda: terminal
    teller = ProgressReporter(lambda: stream, lambda: clock.now)
    for _ in teller.track([0.4, 0.2, 0.1], "sweep", "eps = {:g}"):
        with teller.report("march") as tell:
            for k in range(4):
                clock.now += seconds
                tell((k + 1) / 4, f"t = {k + 1} of 4")
    assert stream.getvalue() == getattr(stream, "seen", "")  # before the results are printed
    return stream.getvalue()


def test_a_pipe_gets_a_line_a_minute():
    """Steps of 25 s: 12 of them are 300 s."""
    lines = three_runs(False, 25.0).splitlines()
    assert lines[0] == "sweep: 1 of 3, eps = 0.4, march: t = 3 of 4, 0:01:15 so far, about 0:03:45 left"
    assert [line.split(", ")[1] for line in lines] == ["eps = 0.4", "eps = 0.2", "eps = 0.1", "eps = 0.1"]


def test_a_terminal_gets_one_line_that_changes_and_goes():
    output = three_runs(True, 2.0)
    assert "\n" not in output
    assert output.endswith("\r\x1b[K")
    assert "sweep: 1 of 3, eps = 0.4, march: t = 3 of 4, 0:00:06 so far, about 0:00:18 left" in output


def test_a_notebook_gets_a_line_that_changes_every_five_seconds():
    """Its front end writes over characters after a carriage return, and knows no other control characters."""
    output = three_runs(False, 2.0, OutStream)
    shown = [line for line in output.split("\r") if line.strip()]
    assert [line.split(", ")[-2] for line in shown] == [f"0:00:{s:02} so far" for s in (6, 12, 18, 24)]
    assert not {"\n", "\x1b"} & {*output}
    assert len(output.split("\r")[-2]) >= max(map(len, shown))  # the last line goes
    assert output.endswith(" \r")


def test_lines_printed_during_work_are_not_glued_to_it(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    print_safely("a study ends")
    assert capsys.readouterr() == ("a study ends\n", "\r\x1b[K")


@pytest.mark.parametrize("terminal", [True, False])
def test_short_and_silenced_work_tells_nothing(terminal, caplog):
    assert three_runs(terminal, 0.4) == ""
    with caplog.at_level(logging.ERROR, "thinlayer"):
        assert three_runs(terminal, 100.0) == ""


def test_all_long_work_tells(monkeypatch, capsys, tmp_path):
    """Each function tells of itself and of the work within it, here at once."""
    for wait in (progress.FIRST_REPORT_SECONDS, progress.REPORT_SECONDS):
        monkeypatch.setitem(wait, "file", 0.0)
    layer, load = ThinLayer(LinearElastic(6.0, 4.0), 0.1, at=1.0), {"TOP": lambda x, t: (0.0, t)}
    structure = Structure(JOINT, tractions=load, **SETUP)
    model = structure.interface(layer)
    marched = lambda case: {"u": len(march(model, [1.0]))}
    work = {
        r"march: t = 1 of 2, .*left": lambda: march(model, [1.0, 2.0]),
        r"ensemble: 2 of 2, run 1, .*march: t = 1 of 1": lambda: ensemble(lambda: marched, [{"k": 1}, {"k": 2}]),
        r"thin_enough, estimate": lambda: thin_enough(structure, layer, 0.02, t=1.0),
        r"movie: 2 of 2, a frame": lambda: plotting.movie(march(model, [1.0]), save=tmp_path / "a.gif"),
    }
    for pattern, run in work.items():
        run()
        assert re.search(pattern, capsys.readouterr().err), pattern
