"""What several layers remember, store, dissipate and switch is told by the names of their seams, in any order."""

from __future__ import annotations

import numpy as np
import pytest

from forms import LinearElastic, MohrCoulomb, NonMonotoneUnrelaxed, Stack
from forms.base import InputError
from geometry import sandwich
from tests.meshed_cases import mortar, panel, yielding
from tests.network_cases import springs
from tests.refused import refused
from tests.test_networks import cut_at, on
from thinlayer import Structure, Surface, ThinLayer, compare, march, solve

COLUMN = sandwich(2.0, 4.0, 4.0, 1.0, cell="quadrilateral")  # cut at two heights into three blocks
BLOCKS = cut_at(COLUMN, {"LOW": (on(1, -1.0), (0, 1)), "HIGH": (on(1, 2.0), (0, 1))})
ROLLERS = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
STEPS = [0.5, 1.0]


def reversed_(layers: dict) -> dict:
    return dict(reversed(layers.items()))


def pulled(joint=BLOCKS, body: float = 5.0, **data) -> Structure:
    data = {"supports": ROLLERS} | data
    return Structure(joint, body=LinearElastic(0.0, body), element="Q1", **data)


# ---------------------------------------------------------------- energies and memory
def test_energies_of_each_layer():
    """Springs of the beds and heads that yield; all layers together are the sum."""
    history = march(panel("Q2", 0.25).full(yielding(0.01)), STEPS)
    assert set(history.last.memory) == {"layer HEAD"}
    energies = history.last.energies()
    assert list(energies) == ["bodies", "layer", "layer BED", "layer HEAD", "loads"]
    assert energies["layer BED"] + energies["layer HEAD"] == pytest.approx(energies["layer"], rel=1e-14)
    assert energies["layer HEAD"] == pytest.approx(history.last.stored["layer HEAD"], rel=1e-14)
    surface = Surface(panel("Q2", 0.25).interface(mortar(0.01)), "BED")
    w = surface.frame(surface.jump(history.last))
    assert energies["layer BED"] == pytest.approx(surface.integral(2.0 * w[1] ** 2 + 0.7 * w[0] ** 2) / 2, rel=0.02)
    table = history.table
    assert {"dissipated HEAD"} == {name for name in table.columns if name.startswith("dissipated ")}
    assert table["dissipated HEAD"] == pytest.approx(table["dissipated"], rel=1e-12)
    assert history.last.dissipated == {"BED": 0.0, "HEAD": history.last.audit.dissipated} != {"BED": 0.0, "HEAD": 0.0}


def test_sublayers_of_one_of_several_layers():
    """A seam's name and its sublayer's number cannot be taken for the name of another seam."""
    yields = MohrCoulomb(3.0, 2.0, cohesion=0.4, friction_angle=20.0)
    both = Stack((0.4, yields), (0.6, yields))
    layers = {"LOW": ThinLayer(yields, 0.1, at=1.0), "HIGH": ThinLayer(both, 0.1, at=1.0)}
    structure = pulled(tractions={"TOP": lambda x, t: (0.0, -0.5 * t)})
    full, limit = (march(model, [1.0]).last for model in (structure.full(layers), structure.interface(layers)))
    assert set(full.memory) == {"layer LOW", "layer HIGH/1", "layer HIGH/2"}
    assert set(limit.memory) == {"layer LOW", "layer HIGH"}
    for name in ("layer LOW", "layer HIGH", "layer"):
        assert full.energies()[name] == pytest.approx(limit.energies()[name], rel=1e-10)


# ---------------------------------------------------------------- order
def test_the_order_of_layers_makes_no_difference(tmp_path):
    """Nor in a march that is resumed with another one; both layers remember, and are not alike."""
    yields = {"BED": ThinLayer(MohrCoulomb(0.6, 0.7, cohesion=4e-4, friction_angle=30.0), 0.01, at=1.0)}
    yields["HEAD"] = ThinLayer(MohrCoulomb(0.3, 0.45, cohesion=2e-4, friction_angle=20.0), 0.007, at=1.0)
    bricks, times = panel("Q2", 0.25), [0.5, 0.75, 1.0]
    history, other = (march(bricks.interface(layers), times) for layers in (yields, reversed_(yields)))
    assert np.array_equal(history.last.u.x.array, other.last.u.x.array)
    assert min(history.last.dissipated.values()) > 0
    march(bricks.interface(yields), times[:2], out=tmp_path)
    resumed = march(bricks.interface(reversed_(yields)), times, out=tmp_path, resume=True)
    assert resumed.last.report.method != "resumed" == resumed.at(0.75).report.method
    assert resumed.last.u.x.array == pytest.approx(history.last.u.x.array, rel=1e-12)
    for state in (resumed.at(0.75), resumed.last):
        assert state.dissipated == pytest.approx(history.at(state.t).dissipated, rel=1e-10)
        assert state.energies() == pytest.approx(history.at(state.t).energies(), rel=1e-10)
    swapped = {"BED": yields["HEAD"], "HEAD": yields["BED"]}
    refused(InputError, "is of another march", march, bricks.interface(swapped), times, out=tmp_path, resume=True)


# ---------------------------------------------------------------- snaps
def test_snaps_of_each_layer():
    """Both layers open at a traction of their own, one after the other."""
    chi = [[0, 0], [0, 1]]
    soon, late = (NonMonotoneUnrelaxed(0.0, 2.0, alpha=0.3, transformation_energy=c, chi=chi) for c in (0.05, 0.09))
    structure = pulled(supports=ROLLERS | {"TOP": {"y": lambda x, t: 2.0 * t}})
    layers = {"LOW": ThinLayer(late, 0.1, at=1.0), "HIGH": ThinLayer(soon, 0.1, at=1.0)}
    history = march(structure.interface(layers), [1.0])
    assert {seam for snap in history.snaps for seam in snap.seams} == {"LOW", "HIGH"}
    first, last = history.snaps[0], history.snaps[-1]
    assert (first.seams, last.seams) == (("HIGH",), ("LOW",))
    for seam in ("LOW", "HIGH"):
        surface = Surface(history.model, seam)
        (row,) = surface.table(history.last).rows
        assert row["plus"] == history.table[f"plus {seam}"][-1] == pytest.approx(1.0)
        assert surface.phase(history.last) == pytest.approx(1.0)
    half = {row["seam"]: row["plus"] for row in Surface(history.model).table(history.states[first.row]).rows}
    assert half["HIGH"] > half["LOW"] == 0.0
    twice = {"minus LOW": lambda state: 0.0}
    refused(InputError, "column 'minus LOW' exists already", march, structure.interface(layers), [0.5], observe=twice)


# ---------------------------------------------------------------- comparisons
def test_comparisons_by_name():
    """Squares of errors and of norms on the seams add up to those on all of S."""
    bricks, layers = panel("Q2", 0.25), mortar(0.02)
    full, limit = (solve(model, 1.0) for model in (bricks.full(layers), bricks.interface(layers)))
    whole = compare(full, limit)
    parts = {name: compare(full, limit, seam=name) for name in layers}
    assert whole["eps"] == parts["HEAD"]["eps"] == 0.02
    for field in ("traction", "jump"):
        norms = [row[field] for row in parts.values()]
        errors = [row[field] * row[f"error_{field}"] for row in parts.values()]
        assert np.linalg.norm(norms) == pytest.approx(whole[field], rel=1e-12)
        assert np.linalg.norm(errors) == pytest.approx(whole[field] * whole[f"error_{field}"], rel=1e-12)
        assert parts["BED"][f"error_{field}"] != pytest.approx(parts["HEAD"][f"error_{field}"], rel=0.1)
    left = compare(full, limit, seam="HEAD", where=lambda x: x[1] < 0.5)  # one head of three
    assert 0 < left["jump"] < parts["HEAD"]["jump"]
    refused(InputError, "where is true nowhere", compare, full, limit, seam="HEAD", where=lambda x: x[0] < -1)
    refused(InputError, "unknown seam 'BEDS', did you mean 'BED'", lambda: compare(full, limit, seam="BEDS"))
    other = solve(bricks.interface(layers | {"HEAD": springs(1.2, 0.45, 0.02)}), 1.0)
    refused(InputError, r"the same thickness of the layer 'HEAD', not 0\.013.* and 0\.02", lambda: compare(full, other))
