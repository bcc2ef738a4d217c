"""May you drop the layer? What leaving its mesh out changes, estimated and in truth, in thirty structures."""

from __future__ import annotations

from studies.dropping.further import further_cases
from studies.dropping.known import COARSE, FINE, known_cases
from studies.dropping.measuring import Dropped, effectivities, from_known
from thinlayer.files.progress import track
from thinlayer.running.record import Record

THICKNESSES = (COARSE, FINE)


def run(record: Record, *, quick: bool = False) -> None:
    """Solve each structure with the law of order 0, with a better law, and with its layers meshed.

    Args:
        record: where to write.
        quick: without structures in three dimensions.
    """
    cases = [case for case in (*known_cases(), *further_cases()) if not (quick and case.solid)]
    table, goals = record.table("effectivities.csv"), record.table("goals.csv")
    for case, eps in track(
        [(case, eps) for case in cases for eps in THICKNESSES], "may_i_drop", "{0[0].name}, {0[1]:g}"
    ):
        found = Dropped.of(case, eps, record)
        row, asked = effectivities(found)
        here = {"case": case.name, "eps": eps}
        table.append({**here, "unknowns": found.unknowns, **row, "from_known": from_known(found)})
        for one in asked:
            goals.append(here | one)
    record.say(table)
    record.say(goals)


def draw(record: Record) -> None:
    """Draw."""
