"""What the package tells through `logging`: nothing unless asked, and one rank for all."""

from __future__ import annotations

import logging

from forms import LinearElastic, Maxwell
from geometry import sandwich
from thinlayer import Structure, ThinLayer, march


def test_steps_of_a_march(caplog):
    joint = sandwich(1.0, 0.5, 0.5, 0.5, cell="quadrilateral", structured=True)
    column = Structure(joint, body=LinearElastic.young(100.0, 0.3), supports={"BOTTOM": 0}, tractions={"TOP": (0, 1.0)})
    with caplog.at_level(logging.INFO, "thinlayer"):
        march(column.interface(ThinLayer(Maxwell(60.0, 40.0, t1=0.7), 0.1, at=1.0)), [0.1, 0.2])
    told = [record.getMessage() for record in caplog.records if record.name == "thinlayer.march"]
    assert [text.partition(":")[0] for text in told] == ["t = 0", "t = 0.1", "t = 0.2"]
