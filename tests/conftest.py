"""Settings of all tests."""

import gc
import os
from pathlib import Path

import pytest
from mpi4py import MPI

# -O1: forms compile in half the time, the largest in a third, and small meshes assemble as fast
os.environ["XDG_CONFIG_HOME"] = str(Path(__file__).parent / "config")


@pytest.fixture(autouse=True, scope="module" if MPI.COMM_WORLD.size == 1 else "function")
def collect_garbage():
    """PETSc objects that are freed late are freed in a different order on different ranks."""
    yield
    gc.collect()
