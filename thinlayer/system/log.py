"""Messages through Python's `logging`, under the logger "thinlayer", from one rank only.

Nothing is shown unless the user asks for it: `logging.basicConfig(level="INFO")`, or `--verbose` on the command line.
"""

from __future__ import annotations

import logging

from mpi4py import MPI

from geometry.parallel import world

_SILENT = logging.Logger("thinlayer on other ranks", logging.CRITICAL + 1)


def logger(part: str, comm: MPI.Intracomm | None = None) -> logging.Logger:
    """The logger "thinlayer.PART" on rank 0 of a communicator (default: the world); on others one that says nothing.

    Args:
        part: "solve" (what a solve tries), "march" (steps in time), "study" (what a study has done).
        comm: communicator of the model.
    """
    return _SILENT if (comm or world()).rank else logging.getLogger(f"thinlayer.{part}")


def show(level: int) -> None:
    """Show what is logged from this level on, on standard error."""
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(name)s: %(message)s"))
    ours = logging.getLogger("thinlayer")
    ours.addHandler(handler)
    ours.setLevel(level)
    ours.propagate = False
