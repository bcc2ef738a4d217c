"""Sheets and bodies of revolution: the interface law against the meshed layer over eps, and a sheet in 3D."""

from __future__ import annotations

import numpy as np
import pytest

from forms import KelvinVoigt, LinearElastic
from geometry import sandwich
from studies.problems import FOURIER_BODY, fourier
from tests.refused import refused
from thinlayer import InputError, Structure, ThinLayer, compare, march, solve

pytestmark = pytest.mark.few(5)


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
        structure = Structure(mesh, **setup, plane=plane)
        layer = ThinLayer(KelvinVoigt(60.0, 40.0, 0.3, 0.5), eps, order, at=1.0)
        models = structure.full(layer), structure.interface(layer)
        errors.append(compare(*(march(model, [0.2, 0.5]) for model in models)))
    for key in ("error_traction", "error_jump"):
        assert np.log2(errors[0][key] / errors[1][key]) == pytest.approx(rate, abs=0.1), key
    refused(InputError, "KelvinVoigt depends on rates", lambda: solve(models[1]))


def compliance_of_a_lap_joint(plane: str = "strain", depth: float | None = None) -> float:
    """Work of the load over the depth (mm) of a sheet whose faces are free; half of the sheet is meshed."""
    half = None if depth is None else depth / 2
    joint = sandwich(24.0, 4.0, 6.0, 3.0, h_S=1.5, depth=half, cell="hexahedron" if half else "quadrilateral")
    supports = {"RIGHT/LOWER": {"x": 0.0, "y": 0.0}, "LEFT/UPPER": {"y": 0.0}} | ({"BACK": {"z": 0.0}} if half else {})
    pull = {"LEFT/UPPER": (-5.0, 0.0, 0.0)[: joint.dim]}
    plates = Structure(joint, body=LinearElastic.young(2e3, 0.35), supports=supports, tractions=pull, plane=plane)
    state = solve(plates.full(ThinLayer(LinearElastic.young(100.0, 0.45), 2.0), cells_through=6))
    return state.energies()["loads"] / (half or 1.0)


def test_a_thin_sheet_in_three_dimensions_is_in_plane_stress():
    """A lap joint with a meshed layer: work of its load; plane strain is another one."""
    sheet, stress, strain = (compliance_of_a_lap_joint(*case) for case in (("strain", 0.5), ("stress",), ("strain",)))
    assert sheet == pytest.approx(stress, rel=0.01)
    assert sheet > 1.03 * strain
