"""Periodic cells of coated fibres: the coating meshed and as a law on S, and the same cell cut elsewhere, through S."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forms import LinearElastic, Maxwell
from forms.base import InputError
from geometry import fibre, periodic
from geometry.joint import Joint
from tests.refused import refused
from thinlayer import Structure, ThinLayer, homogenised_stiffness, march, solve

WIDTH, HEIGHT, RADIUS = 1.2, 1.0, 0.3
BODIES = {"FIBRE": LinearElastic.young(E=5.0, nu=0.3), "MATRIX": LinearElastic.young(E=1.0, nu=0.2)}
COATING = LinearElastic(lmbda=0.6, mu=0.7)  # per thickness
SIDES = ("LEFT", "RIGHT"), ("BOTTOM", "TOP")
STRAIN = ((0.1, 0.02), (0.02, -0.05))


def cell(h: float = 0.1, degree: int = 2) -> Joint:
    return fibre(RADIUS, (WIDTH, HEIGHT), h, degree=degree)


def structure(joint: Joint, **loads) -> Structure:
    return Structure(joint, body=BODIES, supports={}, **loads)


def cut_at(joint: Joint, x: float) -> Joint:
    """The same periodic cell, cut along cells' sides near x: what lies left of it is moved by the period."""
    cells, table = joint.cells, joint.table
    moved = joint.points[joint.corners].mean(axis=1)[:, 0] < x
    for name in ("BOTTOM", "TOP"):  # the cut ends at the same node of both
        rows = table.index(joint.facets[name])
        moved[table.cells[rows, 0]] = joint.points[joint.facets[name]].mean(axis=1)[:, 0] < x
    both = table.cells[joint.surface_rows]
    while (moved[both[:, 0]] != moved[both[:, 1]]).any():  # not along S
        moved[both[moved[both].any(axis=1)].ravel()] = True
    places = joint.points[cells] + np.where(moved, WIDTH, 0.0)[:, None, None] * [1.0, 0.0]
    keys = np.round(places.reshape(-1, 2) / 1e-7).astype(int)
    _, first, number = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    number = number.reshape(cells.shape)
    new = [{int(a): int(b) for a, b in zip(*pair, strict=True)} for pair in zip(cells, number, strict=True)]
    kept = {name: joint.facets[name] for name in ("S", "BOTTOM", "TOP")}
    facets = {}
    for name, some in kept.items():
        rows = table.index(some)
        facets[name] = np.array([[new[table.cells[row, 0]][int(v)] for v in table.vertices[row]] for row in rows])
    whole = replace(joint, points=places.reshape(-1, 2)[first], cells=number, facets=facets)
    outer = np.flatnonzero(whole.table.cells[:, 1] < 0)
    others = np.setdiff1d(outer, np.concatenate([whole.table.index(facets[name]) for name in ("BOTTOM", "TOP")]))
    right = moved[whole.table.cells[others, 0]]
    facets |= {"LEFT": whole.table.vertices[others[~right]], "RIGHT": whole.table.vertices[others[right]]}
    return replace(whole, facets=facets)


# ---------------------------------------------------------------- both ways
def test_the_coating_meshed_and_as_a_law():
    """Rate 1 of the whole stiffness, and of each of its entries; without the law's tangential part there is a floor."""
    one = structure(periodic(cell(), *SIDES))
    errors, floors, eps = [], [], np.array([0.04, 0.02, 0.01])
    smooth = LinearElastic(lmbda=COATING.lmbda + 2 * COATING.mu, mu=1e-9)
    for e in eps:
        full = homogenised_stiffness(one.full(ThinLayer(COATING, e, at=1.0), bodies="extended"))
        limit, wrong = (homogenised_stiffness(one.interface(ThinLayer(law, e, at=1.0))) for law in (COATING, smooth))
        assert np.abs(full - full.T).max() < 1e-12
        errors.append(np.abs(full - limit).max() / np.abs(limit).max())
        floors.append(np.abs(full - wrong).max() / np.abs(limit).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 0.9).all()
    assert (orders < 1.1).all()
    assert errors[-1] < 0.01
    assert floors[-1] > 4 * errors[-1]
    assert floors[-1] > floors[0]


def test_mean_stresses_and_strains():
    """A meshed coating has the mean strain as well, and counts in the mean stress: energies, stresses and strains agree."""
    joint = periodic(cell(0.15), *SIDES)

    def made(**loads):
        return structure(joint, **loads).full(ThinLayer(COATING, 0.02, at=1.0), bodies="extended")

    strained = solve(made(strain=STRAIN))
    C = homogenised_stiffness(strained.model)
    E = np.array([STRAIN[0][0], STRAIN[1][1], 2 * STRAIN[0][1]])
    stress = strained.mean_stress()
    assert [stress[0, 0], stress[1, 1], stress[0, 1]] == pytest.approx(C @ E, rel=1e-9)
    energies = strained.energies()
    stored = energies["bodies"] + energies["layer"]
    assert stored == pytest.approx(WIDTH * HEIGHT * E @ C @ E / 2, rel=1e-9)
    assert strained.audit.supplied == pytest.approx(2 * stored, rel=1e-9)
    found = solve(made(stress=stress.tolist()))
    assert found.mean_strain() == pytest.approx(np.array(STRAIN), rel=1e-8)
    assert found.mean_stress() == pytest.approx(stress, rel=1e-8)
    assert abs(found.audit.imbalance) < 1e-9


def test_a_coating_that_creeps():
    """Compiled laws of meshed coatings know the mean strain: after long the coating has no shear stress left."""
    joint = periodic(cell(0.15), *SIDES)
    layer = ThinLayer(Maxwell(COATING.lmbda, COATING.mu, t1=0.5), 0.02, at=1.0)
    one = structure(joint, strain=lambda x, t: STRAIN)
    stresses = {}
    for name, made in (("full", one.full(layer, bodies="extended")), ("interface", one.interface(layer))):
        history = march(made, [0.1, 0.3, 0.6])
        stresses[name] = history.last.mean_stress()
        assert np.abs(history.table["imbalance"]).max() < 1e-9
    first = solve(one.interface(ThinLayer(COATING, 0.02, at=1.0))).mean_stress()
    change = np.abs(stresses["interface"] - first).max()
    assert change > 0.01 * np.abs(first).max()
    assert np.abs(stresses["full"] - stresses["interface"]).max() < 0.2 * change


# ---------------------------------------------------------------- cut elsewhere
def test_it_does_not_matter_where_the_cell_is_cut():
    """Also where S crosses the sides: twice the same discrete problem; there a layer cannot be meshed."""
    joint = cell(0.12)
    layer = ThinLayer(COATING, 0.02, at=1.0)
    here = homogenised_stiffness(structure(periodic(joint, *SIDES)).interface(layer))
    for x in (-0.4, 0.05):
        other = periodic(cut_at(joint, x), *SIDES)
        on_sides = np.intersect1d(np.concatenate(other.periods.pairs), other.surface)
        assert (len(on_sides) > 0) == (abs(x) < RADIUS)
        there = homogenised_stiffness(structure(other).interface(layer))
        assert np.abs(there - here).max() < 1e-9 * np.abs(here).max()
    words = "S reaches one of the periodic sides 'LEFT' and 'RIGHT' .*, at .* cannot be meshed"
    refused(InputError, words, structure(other).full, layer, bodies="extended")
