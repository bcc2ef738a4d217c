"""Periodic cells of coated fibres: the coating meshed and as a law on S."""

from __future__ import annotations

import numpy as np
import pytest

from forms import LinearElastic, Maxwell
from geometry import fibre, periodic
from geometry.joint import Joint
from thinlayer import Structure, ThinLayer, compare, estimate, homogenised_stiffness, march, solve

WIDTH, HEIGHT, RADIUS = 1.2, 1.0, 0.3
BODIES = {"FIBRE": LinearElastic.young(E=5.0, nu=0.3), "MATRIX": LinearElastic.young(E=1.0, nu=0.2)}
COATING = LinearElastic(lmbda=0.6, mu=0.7)  # per thickness
SIDES = ("LEFT", "RIGHT"), ("BOTTOM", "TOP")
STRAIN = ((0.1, 0.02), (0.02, -0.05))


def cell(h: float = 0.1, degree: int = 2) -> Joint:
    return fibre(RADIUS, (WIDTH, HEIGHT), h, degree=degree)


def structure(joint: Joint, **loads) -> Structure:
    return Structure(joint, body=BODIES, supports={}, **loads)


# ---------------------------------------------------------------- both ways
def test_the_coating_meshed_and_as_a_law():
    """Rate 1 of the whole stiffness, and of each of its entries."""
    composite = structure(periodic(cell(), *SIDES))
    errors = []
    for e in (0.04, 0.02, 0.01):
        full = homogenised_stiffness(composite.full(ThinLayer(COATING, e, at=1.0), bodies="extended"))
        limit = homogenised_stiffness(composite.interface(ThinLayer(COATING, e, at=1.0)))
        assert np.abs(full - full.T).max() < 1e-12
        errors.append(np.abs(full - limit).max() / np.abs(limit).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 0.9).all()
    assert (orders < 1.1).all()
    assert errors[-1] < 0.01


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
    stressed = solve(made(stress=stress.tolist()))
    assert stressed.mean_strain() == pytest.approx(np.array(STRAIN), rel=1e-8)
    assert stressed.mean_stress() == pytest.approx(stress, rel=1e-8)
    assert abs(stressed.audit.imbalance) < 1e-9


def test_the_error_of_a_coating_as_a_law_is_known_without_meshing_the_cell():
    """That of the meshed coating, to the second order in its thickness."""
    composite, coat = structure(periodic(cell(0.15), *SIDES), strain=STRAIN), ThinLayer(COATING, 0.05, at=1.0)
    limit, full = (solve(kind(coat, bodies="extended")) for kind in (composite.interface, composite.full))
    errors, true = estimate(limit), compare(full, limit)
    assert (errors.traction, errors.jump) == pytest.approx((true["error_traction"], true["error_jump"]), rel=5e-3)


def test_a_coating_that_creeps():
    """Compiled laws of meshed coatings know the mean strain: after long the coating has no shear stress left."""
    joint = periodic(cell(0.15), *SIDES)
    layer = ThinLayer(Maxwell(COATING.lmbda, COATING.mu, t1=0.5), 0.02, at=1.0)
    composite = structure(joint, strain=lambda x, t: STRAIN)
    stresses = {}
    for name, made in (("full", composite.full(layer, bodies="extended")), ("interface", composite.interface(layer))):
        history = march(made, [0.1, 0.3, 0.6])
        stresses[name] = history.last.mean_stress()
        assert np.abs(history.table["imbalance"]).max() < 1e-9
    first = solve(composite.interface(ThinLayer(COATING, 0.02, at=1.0))).mean_stress()
    change = np.abs(stresses["interface"] - first).max()
    assert change > 0.01 * np.abs(first).max()
    assert np.abs(stresses["full"] - stresses["interface"]).max() < 0.2 * change
