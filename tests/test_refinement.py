"""Goals of the continuum to a wished tolerance: cells are divided where the interval comes from, and limits are told."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from forms import HolonomicCoulomb, LinearElastic, Stack
from geometry import sandwich, wall
from geometry.inflating.band_cells import level_heights
from geometry.inflating.inflation import inflate
from geometry.refining import refined
from studies.whole_error import overkill
from tests.refused import refused
from tests.test_continuum import random_structure
from thinlayer import InputError, RangeWarning, Structure, ThinLayer, goals, plotting, solve, solve_to
from thinlayer.estimating import refinement
from thinlayer.estimating.refinement import Indicators

BODY = LinearElastic.young(100.0, 0.3)
EPS, TRUTH = 1 / 16, 0.0275273  # of `blocks`: thickness; compliance of adapted cells, outside this package


def blocks(n=2, **more):
    """Interface model of two blocks with n cells along S."""
    structure = Structure(
        sandwich(1.0, 0.5, 0.5, 1 / n, structured=True),
        **{"body": BODY, "supports": {"BOTTOM": 0.0}, "tractions": {"TOP": (0.3, -1.0)}} | more,
    )
    return structure.interface(ThinLayer(LinearElastic.young(2.6 * 40 * EPS, 0.3), EPS))


def measures(joint):
    """Areas of regions and lengths of facet sets, in 3D volumes and areas."""
    x = joint.points[joint.corners]
    volumes = np.abs(np.linalg.det(x[:, 1:] - x[:, :1]))
    sizes = {name: volumes[joint.region == k].sum() for k, name in enumerate(joint.regions)}
    for name, facets in joint.facets.items():
        edges = joint.points[facets[:, 1:]] - joint.points[facets[:, :1]]
        sizes[name] = np.sqrt(np.linalg.det(edges @ np.swapaxes(edges, 1, 2))).sum()
    return sizes


# ---------------------------------------------------------------- cells
@pytest.mark.parametrize(
    "joint", [wall(2, 2, (2.5, 0.7), 0.4, cell="triangle"), sandwich(1.0, 0.4, 0.3, 0.4, depth=0.6)], ids=["2D", "3D"]
)
def test_divided_joint_keeps_its_names(joint):
    row = joint.surface_rows[3]
    fine = refined(joint, np.array([0]), np.array([row]))
    assert measures(fine) == pytest.approx(measures(joint))
    assert fine.seams == joint.seams
    places = {tuple(np.round(x, 9)) for x in fine.points}
    edges = itertools.chain(
        *(itertools.combinations(nodes, 2) for nodes in (joint.corners[0], joint.table.vertices[row]))
    )
    assert all(tuple(np.round(joint.points[[*edge]].mean(axis=0), 9)) in places for edge in edges)
    beside_s = fine.table.cells[fine.surface_rows]
    assert (beside_s >= 0).all()
    assert (fine.region[beside_s[:, 0]] != fine.region[beside_s[:, 1]]).sum() == (fine.dim == 3) * len(beside_s) or (
        fine.dim == 2
    )


def test_rows_of_layers_may_be_graded():
    """Where layers meet, junctions are graded alike, and filled."""
    levels = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
    for joint, area in ((sandwich(2.0, 1.0, 1.0, 0.5), 0.2), (wall(2, 2, (2.5, 0.7), 0.4, cell="triangle"), None)):
        inflated = inflate(joint, 0.1, cells_through=dict.fromkeys(joint.seams, levels), bodies="kept")
        uniform = inflate(joint, 0.1, cells_through=6, bodies="kept")
        sizes = [{k: v for k, v in measures(j).items() if "LAYER" in k} for j in (inflated, uniform)]
        assert sizes[0] == pytest.approx(sizes[1])
        assert area is None or sizes[0]["LAYER"] == pytest.approx(2 * area)
    assert level_heights(2, levels, (0.3, 0.7)) == pytest.approx(np.interp(np.arange(13) / 2, range(7), levels))
    for bad in ((0.0, 0.5), (0.0, 0.6, 0.4, 1.0), (0.1, 1.0), (0.0, 0.5, 1.0)):
        refused(InputError, "heights that increase from 0 to 1", level_heights, 1, bad, (0.3, 0.7))


# ---------------------------------------------------------------- tolerances
def test_tolerance_is_reached_with_few_cells():
    result = solve_to(blocks(), tolerance=0.02, of="change")
    bounds, table = result.bounds["compliance"], result.table
    middle, half = (bounds.lower + bounds.upper) / 2, (bounds.upper - bounds.lower) / 2
    assert bounds.lower < TRUTH < bounds.upper
    assert half <= 0.02 * abs(middle - bounds.value)
    assert bounds.value == pytest.approx(solve(blocks()).load_work())  # of the given cells
    assert result.reached
    assert table["compliance error"][-1] <= 0.02 < table["compliance error"][-2]
    assert table["unknowns"][-1] < 2000  # uniform cells: 4100 for 5.4 %
    assert str(result).startswith(f"compliance {bounds.lower:.6g} to {bounds.upper:.6g}, +- ")
    picture = plotting.cells(bounds.joint, bounds.by_cell)
    (shares,) = (c.get_array() for c in picture.axes[0].collections)
    assert len(shares) == table["cells"][-1]
    assert shares.sum() == pytest.approx(1)


def test_bodies_alone_do_not_reach_it(monkeypatch):
    """A wrong twin that divides neither the layer nor S, where half of the interval comes from."""
    monkeypatch.setattr(refinement, "_divided", lambda heights, *_: heights)
    marked = Indicators.marked
    monkeypatch.setattr(Indicators, "marked", lambda self: marked(replace(self, facets=0 * self.facets)))
    with pytest.warns(RangeWarning, match="is not reached: compliance is known to .* with the largest part near"):
        result = solve_to(blocks(), tolerance=0.02, of="change", max_cells=100)
    assert not result.reached
    assert result.bounds["compliance"].lower < TRUTH < result.bounds["compliance"].upper
    assert "the limit is max_cells=100" in str(result)


def test_several_goals_seams_and_plies():
    joint = wall(1, 2, (2.5, 1.0), 1.0, cell="triangle")
    body, mortar = LinearElastic.young(12.0, 0.2), LinearElastic.young(2.0, 0.1)
    structure = Structure(joint, body=body, supports={"BOTTOM": 0.0}, tractions={"TOP": (0.1, -0.5)})
    qois = goals.Compliance(), goals.Reaction("BOTTOM", (0, 1))
    result = solve_to(structure.interface(ThinLayer(mortar, 0.1)), qois, 0.01)
    assert result.reached
    assert result.bounds[qois[1].name].lower <= 0.5 * 2.5 <= result.bounds[qois[1].name].upper
    plies = ThinLayer(Stack((0.4, mortar), (0.6, body)), 0.1)
    pair = Structure(sandwich(2.0, 1.0, 1.0, 1.0), body=body, supports={"BOTTOM": 0.0}, tractions={"TOP": (0.3, 0.1)})
    through = solve_to(pair.interface(plies), tolerance=0.002).estimate._subproblem.cells_through["S"]
    assert 0.4 in through


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::thinlayer.RangeWarning")
def test_random_structures_reach_2_percent():
    """Or say why; true errors are those from full models of the last cells, halved once more."""
    reached = []
    for seed in range(100):
        structure, layer = random_structure(seed, 1)
        if layer.law.traits.constrained and structure.element == "P1":  # a law that needs P2
            continue
        result = solve_to(structure.interface(layer), max_cells=6000)
        bounds, value = result.bounds["compliance"], overkill(result.estimate)
        assert bounds.lower * (1 - 1e-6) <= value <= bounds.upper, seed
        assert result.reached == (result.reason == "")
        reached.append(result.reached)
        assert not result.reached or abs((bounds.lower + bounds.upper) / 2 - value) <= 0.02 * value, seed
    assert np.mean(reached) >= 0.95


def test_marked_parts_are_half_of_the_interval():
    parts = Indicators(np.array([0.1, 0.02]), np.array([0.3, 0.03]), {"S": np.array([0.05, 0.2])}, 0.3)
    cells, facets, rows, law = parts.marked()
    assert (list(cells), list(facets), rows["S"].tolist(), law) == ([], [0], [False, False], True)


@pytest.mark.parametrize("of", ["goal", "change"])
def test_a_goal_that_equilibrium_determines_needs_no_finer_cells(of):
    """A reaction that is zero but for rounding, and a change that is: both are smaller than any interval around them."""
    column = Structure(sandwich(1.0, 0.5, 0.5, 0.5), body=BODY, supports={"BOTTOM": 0.0}, tractions={"TOP": (0, 1.0)})
    result = solve_to(column.interface(ThinLayer(BODY, 0.1)), [goals.Reaction("BOTTOM", (1, 0))], of=of)
    assert (result.reached, len(result.table.rows)) == (True, 1)


def test_refusals():
    quads = Structure(
        sandwich(1.0, 0.5, 0.5, 0.5, cell="quadrilateral"), body=BODY, supports={"BOTTOM": 0.0}, tractions={}
    )
    layer = ThinLayer(BODY, 0.1)
    assert refused(InputError, "use triangles or", solve_to, quads.interface(layer)).key == "divided"
    assert refused(InputError, "give the layer", solve_to, quads.bonded()).key == "bonded"
    law = HolonomicCoulomb(200.0, 80.0, 0.5)
    assert refused(InputError, "", solve_to, blocks().structure.interface(law)).key == "no thickness"
    refused(InputError, "tolerance", solve_to, blocks(), tolerance=0.0)
    refused(InputError, "goals is", solve_to, blocks(), [])
    refused(InputError, "structure.interface", solve_to, quads.full(layer))
    refused(InputError, "change", solve_to, blocks(), of="value")
    point = goals.Displacement((0.0, 0.5), (0, 1))
    assert refused(InputError, "no single points", solve_to, blocks(), [point]).key == "goal"
