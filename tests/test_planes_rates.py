"""Sheets and bodies of revolution: the interface law against the meshed layer over eps, and the studies of planes."""

from __future__ import annotations

import numpy as np
import pytest

from forms import KelvinVoigt, Maxwell, MohrCoulomb
from studies.problems import FOURIER_BODY, fourier
from thinlayer import Structure, ThinLayer, compare, march
from thinlayer.running.cli import main

LAWS = {"Maxwell": Maxwell(6.0, 4.0, 0.7, 1.5), "Mohr-Coulomb": MohrCoulomb(6.0, 4.0, 0.3, 30.0, 0.05)}


@pytest.mark.parametrize("name", ["Maxwell", "Mohr-Coulomb"])
def test_the_layer_of_a_sheet_tends_to_its_law_at_rate_1(name):
    mesh, setup = fourier(1 / 8, cell="quadrilateral")
    errors = []
    for eps in (0.02, 0.01):
        layer = ThinLayer(LAWS[name], eps)
        structure = Structure(mesh, **setup, plane="stress")
        full, limit = (march(model, [0.2, 0.5]) for model in (structure.full(layer), structure.interface(layer)))
        errors.append(compare(full, limit))
    for key in ("error_traction", "error_jump"):
        assert np.log2(errors[0][key] / errors[1][key]) == pytest.approx(1.0, abs=0.12), key


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
            ThinLayer(KelvinVoigt(60.0, 40.0, 0.3, 0.5), eps, order),
        )
        errors.append(
            compare(*(march(model, [0.2, 0.5]) for model in (structure.full(layer), structure.interface(layer))))
        )
    for key in ("error_traction", "error_jump"):
        assert np.log2(errors[0][key] / errors[1][key]) == pytest.approx(rate, abs=0.1), key


@pytest.mark.parametrize(("name", "checks"), [("tubes", 6), ("plane_stress", 4)])
def test_studies_of_planes(tmp_path, capsys, name, checks):
    assert main(["run", name, "--quick", "--out", str(tmp_path / "out")]) == 0
    assert capsys.readouterr().out.count("ok   ") == checks
    assert list((tmp_path / "out").glob("*.png"))
