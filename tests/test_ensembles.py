"""Ensembles: one table of many runs, over groups of ranks and over jobs, resumed with the same runs only."""

from __future__ import annotations

import multiprocessing
import os
import random
import signal
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from forms import LinearElastic
from forms.base import InputError
from geometry import sandwich
from tests.on_ranks import on_ranks
from tests.refused import refused
from thinlayer import SolveError, Structure, Surface, Table, ThinLayer, ensemble, solve

RUNS = [{"mu": 40.0 + 7 * k, "where": "left" if k % 2 else "right"} for k in range(5)]


def make():
    joint = sandwich(width=2.0, lower=0.5, upper=0.7, h=0.25, structured=True)
    steel = LinearElastic.young(E=900.0, nu=0.3)
    pulled = Structure(joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (0.3, 0.8)}, element="P1")

    def run(case):
        pull = 1.0 if case["where"] == "left" else 2.0
        model = pulled.interface(ThinLayer(LinearElastic(60.0, case["mu"] * pull), 0.01, at=1.0))
        surface = Surface(model)
        return {"jump": surface.norm(surface.jump(solve(model))), "side": case["where"][0], "ranks": model.comm.size}

    return run


def by_one(folder: Path) -> list[dict]:
    """Rows of an ensemble of which each rank has its part."""
    for part in ((1, 2), (0, 2)):
        table = ensemble(make, RUNS, out=folder / "table.csv", resume=True, ranks=1, part=part)
    return table.rows


CASES = [{"E": 1.5 + k, "name": f"n{k}"} for k in range(5)]
FACTOR = 3.0


def doubled():
    return lambda case: {"double": 2 * case["E"], "same": case["name"]}


def scaled():
    return lambda case: {"scaled": FACTOR * case["E"]}


def test_a_table_has_the_cases_and_the_rows_of_their_runs_in_order(tmp_path):
    for out in (None, tmp_path / "new" / "t.csv"):
        table = ensemble(doubled, CASES, out=out)
        assert table.columns == ["run", "E", "name", "double", "same"]
        assert table["run"].tolist() == [0, 1, 2, 3, 4]
        assert table["double"].tolist() == [3.0, 5.0, 7.0, 9.0, 11.0]
        assert [row["same"] for row in table.rows] == ["n0", "n1", "n2", "n3", "n4"]
    assert Table.load(out).rows == table.rows


@pytest.fixture(scope="module")
def alone():
    return ensemble(make, RUNS)


@on_ranks(by_one, 2)
def test_ranks_give_the_rows_of_one_process(alone, there, their_folder):
    require_rows(alone, there, 1, their_folder)


def require_rows(alone, rows, group, folder):
    assert [row.pop("ranks") for row in rows] == [group] * 5
    for row, other in zip(rows, alone.rows, strict=True):
        assert row["jump"] == pytest.approx(other["jump"], rel=1e-10)  # another order of sums
        assert (row["side"], row["mu"]) == (other["side"], other["mu"])
    assert ensemble(make, RUNS, out=folder / "table.csv", resume=True)["ranks"].tolist() == [group] * 5


def test_jobs_share_a_table_and_each_does_its_part(tmp_path):
    out, done = tmp_path / "t.csv", []

    def make():
        return lambda case: done.append(case["E"]) or {"half": case["E"] / 2}

    ensemble(make, CASES, out, resume=True, part=(1, 2))
    assert done == [2.5, 4.5]
    assert Table.load(out)["run"].tolist() == [1, 3]
    table = ensemble(make, CASES, out, resume=True, part=(0, 2))
    assert sorted(done) == [case["E"] for case in CASES]
    assert table["half"].tolist() == [case["E"] / 2 for case in CASES] == Table.load(out)["half"].tolist()
    assert len(ensemble(make, CASES, out, resume=True)) == len(done) == 5


def test_half_a_line_of_a_killed_job_is_computed_again(tmp_path):
    out, rows = tmp_path / "t.csv", tmp_path / "t.csv.json"
    first = ensemble(doubled, CASES, out)
    rows.write_bytes(rows.read_bytes()[:-30])
    done = []
    for _ in range(2):
        table = ensemble(lambda: lambda case: done.append(case["E"]) or doubled()(case), CASES, out, resume="anyway")
        assert table.rows == first.rows
        assert done == [CASES[-1]["E"]]
    rows.write_bytes(b"".join(line for line in rows.read_bytes().splitlines(True) if b"made from" not in line))
    refused(InputError, "it has no description", ensemble, doubled, CASES, out, resume=True)


def test_a_run_that_fails_keeps_the_rows_before_it_and_is_repeated(tmp_path):
    out, broken = tmp_path / "t.csv", {3.5}

    def make():
        def run(case):
            if case["E"] in broken:
                raise SolveError("no equilibrium")
            return {"half": case["E"] / 2}

        return run

    refused(SolveError, "no equilibrium", ensemble, make, CASES, out)
    assert Table.load(out)["run"].tolist() == [0, 1]
    kept = ensemble(make, CASES, out, keep_failures=True)
    assert [row["failure"] for row in kept.rows] == [None, None, "no equilibrium", None, None]
    assert np.isnan(kept["half"][2])
    assert kept["half"][[0, 1, 3, 4]].tolist() == [0.75, 1.25, 2.25, 2.75]


def test_only_the_same_ensemble_is_resumed(tmp_path, monkeypatch):
    out = tmp_path / "t.csv"
    ensemble(scaled, CASES, out)
    monkeypatch.setattr("tests.test_ensembles.FACTOR", 4.0)
    with pytest.raises(InputError, match=r"is the table of another ensemble \(.*FACTOR: 3\.0 there, 4\.0 here"):
        ensemble(scaled, CASES, out, resume=True)
    monkeypatch.undo()
    with pytest.raises(InputError, match=r"is the table of other cases \(run 1: E = 2\.5 there"):
        ensemble(scaled, [case | {"E": case["E"] ** 2 / 1.5} for case in CASES], out, resume=True)
    assert ensemble(scaled, CASES, out, resume=True)["scaled"][0] == 4.5
    refused(InputError, r"another ensemble .* or resume='anyway'", ensemble, doubled, CASES, out, resume=True)
    assert ensemble(doubled, CASES, out, resume="anyway")["scaled"][0] == 4.5  # no row is left to compute
    assert ensemble(doubled, CASES[:2], out)["double"].tolist() == [3.0, 5.0]  # another one moves it away
    assert (tmp_path / "previous-1" / "t.csv").exists()


def drawing(random):
    return lambda case: {"u": float(random())}


def only_the_run_draws(seed):
    def make():
        random = np.random.default_rng(3)
        return lambda case: {"u": float(random.random())}

    return make


drawing_alike = partial(drawing, np.random.default_rng(1).random)


def shared_by_all(seed):
    random.seed(seed)
    return partial(drawing, lambda: random.random())


DRAWN = {
    "argument": lambda seed: partial(drawing, np.random.default_rng(seed).random),
    "of the run": only_the_run_draws,
    "shared by all": shared_by_all,
}


@pytest.mark.parametrize("make", DRAWN.values(), ids=DRAWN)
def test_rows_drawn_from_a_generator_that_goes_on_are_not_resumed(tmp_path, make):
    """Neither with another seed, nor with the same: what is left would be drawn from the beginning again."""
    first = ensemble(make(1), CASES[:3], tmp_path / "t.csv")
    assert len({*first["u"]}) == 3
    for seed in (1, 5):
        with pytest.raises(InputError, match=r"generator of random numbers that goes on .* from a number of the case"):
            ensemble(make(seed), CASES[:3], tmp_path / "t.csv", resume=True)
    assert ensemble(make(5), CASES[:3], tmp_path / "t.csv", resume="anyway").rows == first.rows
    assert ensemble(make(1), CASES[:3], tmp_path / "t.csv").rows == first.rows


def test_parts_that_would_draw_the_same_are_told(tmp_path):
    """So are groups: each part makes a generator of its own, from the same seed."""
    for part in (0, 1):
        with pytest.raises(InputError, match="groups, processes and parts of an ensemble draw the same numbers"):
            ensemble(only_the_run_draws(1), CASES, tmp_path / "t.csv", resume=True, part=(part, 2))


def legacy(seed):
    random.seed(seed)
    return random


@pytest.mark.parametrize("generator", [np.random.default_rng, legacy])
def test_rows_drawn_from_seeds_of_their_cases_are_resumed(tmp_path, generator):
    def make():
        return lambda case: {"u": float(generator(int(case["E"])).random())}

    first = ensemble(make, CASES[:2], tmp_path / "t.csv")
    again = ensemble(make, CASES, tmp_path / "t.csv", resume=True)
    assert again.rows[:2] == first.rows
    assert len({*again["u"]}) == 5


MANY = [{"E": 1.5 + k, "killed": ""} for k in range(200)]


def halved():
    def run(case):
        if case["killed"] and not Path(case["killed"]).exists():
            Path(case["killed"]).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return {"half": case["E"] / 2}

    return run


def pool():
    return ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn"))


def test_processes_give_the_rows_of_one(tmp_path, alone):
    out = tmp_path / "t.csv"
    with pool() as executor:
        table = ensemble(halved, MANY, out, executor=executor)
        assert table.rows == ensemble(halved, MANY).rows == ensemble(halved, MANY, out, resume=True).rows
        require_rows(alone, ensemble(make, RUNS, tmp_path / "table.csv", executor=executor).rows, 1, tmp_path)


def test_a_killed_process_loses_its_row(tmp_path):
    cases = [case | {"killed": str(tmp_path / "killed") if k == 100 else ""} for k, case in enumerate(MANY)]
    with pool() as executor, pytest.raises(BrokenProcessPool):
        ensemble(halved, cases, tmp_path / "t.csv", executor=executor)
    done = {*Table.load(tmp_path / "t.csv")["run"].astype(int)}
    assert len({*range(100)} - done) <= 1  # the row of the other process, which ends too
    assert 100 not in done
    with pool() as executor:
        table = ensemble(halved, cases, tmp_path / "t.csv", resume=True, executor=executor)
    assert table["half"].tolist() == [case["E"] / 2 for case in MANY]


def test_a_cluster_of_dask_gives_the_rows_of_one(tmp_path):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1) as cluster, distributed.Client(cluster) as client:
        table = ensemble(halved, MANY, tmp_path / "t.csv", executor=client.get_executor())
    assert table.rows == ensemble(halved, MANY).rows


def failing():
    def run(case):
        if case["E"] == 3.5:
            raise SolveError("no equilibrium")
        return {"half": case["E"] / 2}

    return run


def test_errors_in_processes_are_those_of_one(tmp_path, monkeypatch):
    with pool() as executor:
        refused(SolveError, "no equilibrium", ensemble, failing, CASES, tmp_path / "t.csv", executor=executor)
        assert len(Table.load(tmp_path / "t.csv")) >= 2
        kept = ensemble(failing, CASES, tmp_path / "t.csv", executor=executor, keep_failures=True)
        assert [row["failure"] for row in kept.rows] == [None, None, "no equilibrium", None, None]
        text = "groups, processes and parts of an ensemble draw the same numbers"
        refused(InputError, text, ensemble, drawing_alike, CASES, executor=executor)
    monkeypatch.setattr("thinlayer.output.ensemble._IMPORTING_PROCESS", 1)
    with ThreadPoolExecutor(1) as executor:
        refused(InputError, r"forked .*get_context\('spawn'\)", ensemble, doubled, CASES, executor=executor)


def test_bad_input_is_told():
    for change, what in [
        ({"cases": []}, "one case or more"),
        ({"cases": [{"a": 1.0}, {"b": 1.0}]}, "case 1 has b, the first one a"),
        ({"cases": [{"seed": 2**53 + 1}]}, "of which a table keeps 9007199254740992"),
        ({"cases": [{"run": 1.0}]}, "case 0 has 'run'"),
        ({"ranks": 2}, "ranks is 2; allowed: a number that divides the number of ranks, 1"),
        ({"part": (2, 2)}, r"part is \(2, 2\); allowed"),
        ({"executor": 2}, "executor is 2; it must have the method submit"),
        ({"make": None}, "make is None; it must be a function"),
        ({"make": lambda: 3}, "make returns 3"),
        ({"make": lambda: lambda case: {"E": 1.0}}, "the row of run 0 has 'E'"),
    ]:
        refused(InputError, what, ensemble, **{"make": doubled, "cases": CASES} | change)
