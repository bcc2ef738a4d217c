"""A run owns its folder: other runs at the same time, older files, files that are damaged or cannot be written."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
from matplotlib.figure import Figure

import thinlayer.running.record
from forms.base import InputError
from studies import rates
from tests.folders_run import same_errors
from tests.on_ranks import on_ranks
from tests.refused import refused
from tests.viscous_joints import SUDDEN, interface
from thinlayer import Table, march, plotting, sweep
from thinlayer.running import cli
from thinlayer.running.record import Record
from thinlayer.system.folder import lock_from_root

FACTOR = 2.0


def scaled(x):
    return FACTOR * x


def row(e):
    return {"eps": e, "error_traction": scaled(e), "error_jump": 3 * e}


def fail_to_write(*_):
    raise OSError(errno.ENOSPC, "No space left on device")


# ---------------------------------------------------------------- marches
def test_a_march_leaves_other_tables_alone(tmp_path):
    (tmp_path / "table.csv").write_text("a,b\n1,2\n")
    refused(InputError, r"table\.csv is not of a march", lambda: march(interface(), [0.1], out=tmp_path))
    assert (tmp_path / "table.csv").read_text() == "a,b\n1,2\n"


# ---------------------------------------------------------------- two runs at once
def test_the_second_run_at_a_time_is_refused(tmp_path):
    """And the folder is free again when the first one ends, by whatever signal."""
    out = tmp_path / "out"
    program = (
        "import fcntl, os, sys; file = os.open(sys.argv[1], os.O_RDWR | os.O_CREAT); fcntl.flock(file, fcntl.LOCK_EX); "
        "os.write(file, b'process 123 on there'); print('locked', flush=True); sys.stdin.read()"
    )
    out.mkdir()
    for name in (".lock", ".t.csv.lock"):
        words = [sys.executable, "-c", program, str(out / name)]
        with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as first:
            assert first.stdout.readline() == "locked\n"
            with pytest.raises(InputError, match=r"^another run \(process 123 on there\) is writing into"):
                march(interface(), [0.1], out=out) if name == ".lock" else sweep(row, [0.2], out / "t.csv")
            first.send_signal(signal.SIGKILL)
    assert sorted(path.name for path in out.iterdir()) == [".lock", ".t.csv.lock"]
    assert len(march(interface(), [0.1], out=out)) == 2
    sweep(row, [0.2], out / "t.csv")
    assert not [*out.glob(".*")]


def test_a_lock_of_this_process_and_folders_for_nothing(tmp_path):
    out = tmp_path / "a" / "b"
    with lock_from_root(out), pytest.raises(InputError, match=f"process {os.getpid()} on "), Record("s", out, {}):
        pass
    assert not (tmp_path / "a").exists()
    refused(InputError, r"no files can be written in .*: ", lambda: march(interface(), [0.1], out="/proc/no/such"))


def test_a_lock_is_that_of_the_file_which_is_there(tmp_path, monkeypatch):
    """A run that ends takes its file away just before another one locks it, and a third one makes a new file."""
    flock, path = fcntl.flock, tmp_path / ".lock"

    def late(file, flags):
        monkeypatch.undo()
        path.unlink()
        path.touch()
        flock(file, flags)

    monkeypatch.setattr(fcntl, "flock", late)
    with lock_from_root(tmp_path), pytest.raises(InputError, match="another run"), lock_from_root(tmp_path):
        pass


def test_file_systems_without_locks(tmp_path, monkeypatch):
    def unknown(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", unknown)
    assert len(march(interface(), [0.1], out=tmp_path)) == 2


# ---------------------------------------------------------------- sweeps
def test_the_table_of_another_sweep_is_not_adopted(tmp_path, monkeypatch):
    path, calls = tmp_path / "t.csv", []

    def run(e):
        calls.append(e)  # what it collects is no part of what it is
        return row(e)

    sweep(run, [0.4, 0.2], path)
    sweep(run, [0.4, 0.2, 0.1], path, resume=True)
    assert calls == [0.4, 0.2, 0.1]
    before = path.read_bytes()
    monkeypatch.setitem(globals(), "FACTOR", 3.0)
    words = r"is the table of another sweep \(row\.scaled\.FACTOR: 2\.0 there, 3\.0 here\); give another name"
    refused(InputError, words, sweep, run, [0.4, 0.2, 0.1], path, resume=True)
    assert path.read_bytes() == before
    assert sweep(run, [0.4], path)["error_traction"] == pytest.approx([1.2])
    assert (tmp_path / "previous-1" / "t.csv").read_bytes() == before
    sidecar = tmp_path / "t.csv.json"
    sidecar.write_text(sidecar.read_text().replace("0.4", "0.5"))
    refused(InputError, r"t\.csv\.json' cannot be read", lambda: sweep(run, [0.4], path, resume=True))
    sidecar.unlink()
    refused(InputError, "which describes its origin, does not exist", lambda: sweep(run, [0.4], path, resume=True))


def test_rows_that_do_not_fit():
    for change, problem in [
        ({"eps": 0.2}, "another thickness, eps = 0.2"),
        ({"error_jump": "x"}, "no number error_jump"),
        ({"note": [1.0]}, "neither a number nor a text"),
        ({"order_jump": 1.0}, "'order_jump'; names of columns"),
        ({"more": 1.0}, "columns eps, error_traction, error_jump, more, where the first row has eps"),
    ]:
        run = lambda e, change=change: row(e) | (change if e == 0.1 else {})
        refused(InputError, rf"run\(0\.1\) returns.* {problem}", sweep, run, [0.4, 0.1])


def test_errors_of_zero_have_no_order(recwarn):
    table = sweep(lambda e: row(e) | {"error_jump": 0.0}, [0.4, 0.2, 0.1])
    assert [entry["order_jump"] for entry in table.rows] == [None, None, None]
    assert table["order_traction"][1:] == pytest.approx([1.0, 1.0])
    assert not recwarn


# ---------------------------------------------------------------- studies
def study(out, options, rows=(0.4, 0.2), resume=False, stop_at=None):
    def run(e):
        if e == stop_at:
            raise KeyboardInterrupt
        return row(e) | {"b": options["b"]}

    with Record("s", out, options, resume=resume) as record:
        table = record.sweep(run, rows)
        record.write("more.csv", table)
        plotting.rates(table, save=record.path("rates.png"))
    return table


def test_an_older_run_is_moved_away_and_never_mixed(tmp_path):
    study(tmp_path, {"b": 1.0})
    (tmp_path / "notes.txt").write_text("mine")
    first = {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.name != "notes.txt"}
    assert first.keys() == {"run.json", "table.csv", "table.csv.json", "more.csv", "rates.png"}
    refused(KeyboardInterrupt, "", study, tmp_path, {"b": 2.0}, stop_at=0.4)
    assert {path.name for path in tmp_path.iterdir()} == {"notes.txt", "previous-1", "run.json"}
    assert {path.name: path.read_bytes() for path in (tmp_path / "previous-1").iterdir()} == first
    assert list(study(tmp_path, {"b": 2.0}, resume=True)["b"]) == [2.0, 2.0]
    refused(InputError, r"options\.b: 2\.0 there, 3\.0 here", lambda: study(tmp_path, {"b": 3.0}, resume=True))
    study(tmp_path, {"b": 3.0})
    assert {path.name for path in (tmp_path / "previous-2").iterdir()} == first.keys()


def test_bad_input_leaves_the_older_run_where_it_was(tmp_path):
    study(tmp_path, {"b": 1.0})
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def begun():
        with Record("s", tmp_path, {"b": 2.0}) as record:
            record.path("table.csv")
            assert {path.name for path in tmp_path.iterdir()} == {".lock", "previous-1", "run.json"}
            raise InputError("bad")

    refused(InputError, "bad", begun)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_only_the_same_run_is_resumed(tmp_path, monkeypatch):
    study(tmp_path, {"b": 1.0})
    again = partial(study, tmp_path, {"b": 1.0}, resume=True)
    options = {"options": {"-thinlayer_snes_rtol": "0.9"}, "PETSC_OPTIONS": ""}
    for name, value, words in (
        ("code_hash", "0123456789ab", r"another one \(code: "),
        ("petsc_options", options, r"petsc\.-thinlayer_snes_rtol: nothing there, 0\.9 here"),
    ):
        monkeypatch.setattr(thinlayer.running.record, name, lambda value=value: value)
        refused(InputError, words, again)
        monkeypatch.undo()
    for text in ("{", '{"study": "s", "options": 3}', "\xff"):
        (tmp_path / "run.json").write_bytes(text.encode("latin-1"))
        refused(InputError, r"run\.json cannot be read", again)
    (tmp_path / "run.json").unlink()
    for run in (again, partial(study, tmp_path, {"b": 1.0})):
        refused(InputError, r"has more\.csv, table\.csv, but no run\.json; give", run)


def test_other_tables_are_not_drawn(tmp_path):
    study(tmp_path, {"b": 1.0})
    Record("s", tmp_path, {}).require_run()
    refused(InputError, "is of the study s, not t", lambda: Record("t", tmp_path, {}).require_run())


# ---------------------------------------------------------------- the command line
def test_folders_that_cannot_be(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("")
    monkeypatch.setattr(rates, "run", lambda *_, **__: pytest.fail("it was run"))
    assert cli.main(["run", "rates", "--law", "elastic", "--out", "file/x"]) == 2
    assert "no files can be written in 'file/x'" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_files_that_cannot_be_written_and_defects(tmp_path, monkeypatch, capsys):
    def writes_too_much(record, **_):
        record.sweep(row, [0.2])
        monkeypatch.setattr(os, "fsync", fail_to_write)
        record.write("more.csv", Table([row(0.2)]))

    monkeypatch.setattr(rates, "run", writes_too_much)
    words = ["run", "rates", "--law", "elastic", "--out", str(tmp_path / "a")]
    assert cli.main(words) == 3
    message = "more.csv' could not be written or read: No space left on device\nresults so far are kept in"
    assert message in capsys.readouterr().err
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == ["run.json", "table.csv", "table.csv.json"]
    monkeypatch.undo()
    monkeypatch.setattr(rates, "run", lambda *_, **__: 1 / 0)
    monkeypatch.setattr(sys, "argv", ["thinlayer", *words[:5], str(tmp_path / "b")])
    before = signal.getsignal(signal.SIGINT)
    assert cli.start() == 3
    signal.signal(signal.SIGINT, before)
    said = capsys.readouterr().err
    assert "ZeroDivisionError" in said
    assert "this is a defect of thinlayer" in said
    assert "ZeroDivisionError" in json.loads((tmp_path / "b" / "run.json").read_text())["error"]


def test_nobody_reads():
    """A pipe that is closed early: no traceback, no report by PETSc."""
    words = [sys.executable, "-m", "thinlayer", "info"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == 0


# ---------------------------------------------------------------- damage


def test_damaged_marches(tmp_path):
    """A file that is not as the march wrote it: cut, of another time, gone, with another number."""
    march(interface(SUDDEN), [0.1, 0.2], out=tmp_path)
    table, states = tmp_path / "march.json", tmp_path / "states"
    whole = {path: path.read_bytes() for path in (table, states / "000002.npz")}
    for path, spoilt in (
        (table, whole[table][:700]),
        (table, whole[table].replace(b'"theta": 1.0', b'"theta": 0.5')),
        (states / "000002.npz", (states / "000001.npz").read_bytes()),
        (states / "000002.npz", None),
    ):
        assert spoilt != whole[path]
        path.unlink() if spoilt is None else path.write_bytes(spoilt)
        words = rf"{path.name}'? (cannot be read|is lost or damaged)"
        refused(InputError, words, march, interface(SUDDEN), [0.3], out=tmp_path, resume=True)
        path.write_bytes(whole[path])
    table.write_bytes(whole[table] + b'\n{"rows": [{"t": 0.3')  # of a march that was killed
    for _ in range(2):
        assert len(march(interface(SUDDEN), [0.1, 0.2, 0.3], out=tmp_path, resume=True)) == 4


def test_damaged_tables(tmp_path):
    for text in [b"\xff\xfe\x00", b"a,b\n1,2,3\n", b"a,a\n1,2\n", b"a,b\n" + b"1" * 200_000 + b',"\n']:
        path = tmp_path / "t.csv"
        path.write_bytes(text)
        refused(InputError, r"cannot be read as a table|is not a whole table", Table.load, path)
        refused(InputError, "", plotting.rates, path)


def test_pictures_are_whole_or_as_they_were(tmp_path, monkeypatch):
    path, table = tmp_path / "rates.png", Table([row(0.2), row(0.1)])
    plotting.rates(table, save=path)
    before = path.read_bytes()

    def half(self, file, **_):
        file.write(b"half")
        fail_to_write()

    monkeypatch.setattr(Figure, "savefig", half)
    refused(OSError, "No space", lambda: plotting.rates(table, save=path))
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["rates.png"]


# ---------------------------------------------------------------- several ranks
@pytest.mark.long
@on_ranks(same_errors, 2)
def test_errors_of_files_are_errors_of_all_ranks(there):
    assert there is None  # no error on any rank
