"""Settings of all tests."""

import gc
import os
import sys
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import settings
from mpi4py import MPI

from tests.on_ranks import launches, their_folder, there  # noqa: F401  (fixtures)

# -O1: forms compile in half the time, the largest in a third, and small meshes assemble as fast
os.environ["XDG_CONFIG_HOME"] = str(Path(__file__).parent / "config")
# else each of many processes compiles all our sources again
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
# the same examples in every run; others with --hypothesis-profile=random
settings.register_profile("same", deadline=None, derandomize=True)
settings.register_profile("random", deadline=None)
settings.load_profile("same")
# what fails in an assertion of these is shown as it is in a test
pytest.register_assert_rewrite("tests.at_points", "tests.columns_in_time")


def pytest_xdist_auto_num_workers(config):
    """All cores for several files; none for a part of one, and none for a rank of mpirun."""
    (first, *more) = config.args
    alone = MPI.COMM_WORLD.size > 1 or (not more and not Path(first.split("::")[0]).is_dir())
    return 0 if alone else len(os.sched_getaffinity(0))


GOLDEN = (5**0.5 - 1) / 2  # its multiples fall into no step with the lists of a product of them


LONG_LIST = 3  # cases; of shorter ones, which are often of different kinds, a part is run only where the test says so


@pytest.hookimpl(tryfirst=True)  # before tests are chosen by their marks
def pytest_collection_modifyitems(items):
    """Of a list that is marked so, the first case and a few others are in each run."""
    test = lambda item: item.nodeid.partition("[")[0]
    seen, cases = Counter(), Counter(map(test, items))
    for item in items:
        mark, name = item.get_closest_marker("few"), test(item)
        if mark and (cases[name] >= LONG_LIST or mark in item.own_markers):
            if seen[name] * GOLDEN % 1 >= 1 / mark.args[0]:
                item.add_marker("long")
            seen[name] += 1


def pytest_make_parametrize_id(val):
    """Laws have the names of their classes."""
    return type(val).__name__ if hasattr(val, "with_parameters") and not isinstance(val, type) else None


@pytest.fixture
def draw():
    """A session of gmsh, which draws the joints of files."""
    from tests.meshes import drawing

    with drawing() as occ:
        yield occ


@pytest.fixture(autouse=True, scope="module" if MPI.COMM_WORLD.size == 1 else "function")
def collect_garbage():
    """PETSc objects that are freed late are freed in a different order on different ranks."""
    yield
    gc.collect()
