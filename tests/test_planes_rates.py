"""Sheets and bodies of revolution: the interface law against the meshed layer over eps, and a sheet in 3D."""

from __future__ import annotations

import numpy as np
import pytest

from forms import KelvinVoigt
from studies import plane_stress
from studies.problems import FOURIER_BODY, fourier
from thinlayer import Structure, ThinLayer, compare, march
from thinlayer.running.record import Record


@pytest.mark.parametrize(("order", "rate"), [(0, 1.0), (1, 1.95)])
@pytest.mark.parametrize("plane", ["stress", "axisymmetric"])
def test_the_next_order_is_one_more(plane, order, rate):
    """S across the axis between rods on rollers, a creeping layer; between blocks in plane stress."""
    mesh, setup = fourier(1 / 16, cell="quadrilateral")
    if plane == "axisymmetric":
        loads = {"TOP": lambda x, t: (0.5 * x[0] * (1 - x[0]), (1 - x[0] ** 2) ** 2)}
        setup = {"body": FOURIER_BODY, "supports": {"BOTTOM": 0.0, "RIGHT": {"x": 0.0}}, "tractions": loads}
    errors = []
    for eps in (0.02, 0.01):
        structure, layer = (
            Structure(mesh, **setup, plane=plane),
            ThinLayer(KelvinVoigt(60.0, 40.0, 0.3, 0.5), eps, order, at=1.0),
        )
        errors.append(
            compare(*(march(model, [0.2, 0.5]) for model in (structure.full(layer), structure.interface(layer))))
        )
    for key in ("error_traction", "error_jump"):
        assert np.log2(errors[0][key] / errors[1][key]) == pytest.approx(rate, abs=0.1), key


def test_a_thin_sheet_in_three_dimensions_is_in_plane_stress(tmp_path):
    """A lap joint with a meshed layer: work of its load; plane strain is another one."""
    with Record("plane_stress", tmp_path, {}) as record:
        sheet, stress, strain = (
            plane_stress._compliance(record, plane_stress.LAWS["elastic"], 3.0, **one)
            for one in ({"depth": 0.5}, {"plane": "stress"}, {"plane": "strain"})
        )
    assert sheet == pytest.approx(stress, rel=plane_stress.SAME)
    assert sheet > 1.03 * strain
