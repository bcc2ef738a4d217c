"""Programs run on several ranks, or in a process of their own, from the root of the project."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

CLONE = Path(__file__).parent.parent
# an outer MPI process must not be taken for our parent
CLEAN = {k: v for k, v in os.environ.items() if not k.startswith(("PMIX_RANK", "PMIX_NAMESPACE", "OMPI_COMM", "PRTE_"))}
CLEAN |= {k: v for k, v in os.environ.items() if k.startswith("PRTE_MCA")}


def mpirun(ranks: int, *command: str, cwd: Path = CLONE, timeout: float = 240) -> subprocess.CompletedProcess:
    # ranks that wait leave the cores to those that compute: there may be fewer cores than ranks
    environment = CLEAN | {"PYTHONPATH": str(CLONE), "OMP_NUM_THREADS": "1", "OMPI_MCA_mpi_yield_when_idle": "1"}
    # mpi4py ends all ranks where one has an error
    words = ["mpirun", "-n", str(ranks), sys.executable, "-m", "mpi4py", *command]
    return subprocess.run(words, env=environment, cwd=cwd, capture_output=True, text=True, timeout=timeout)
