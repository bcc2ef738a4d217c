"""How small a residual must be, without any model."""

import math

import pytest

from thinlayer.solving.part_sum import ACCEPTED_RESIDUAL, MACHINE_EPSILON, SOLVER_RESIDUAL, ForceScale

STIFF = 1e6  # N/mm


def begun(stiffness=STIFF, cancelling=0.0, *, loads=0.0, prescribed=0.0, moved=0.0, stresses=()):
    scale = ForceScale(stiffness, cancelling)
    scale.begin(loads, prescribed, moved)
    scale.update_stresses(max(stresses, default=0.0))
    return scale


def test_the_largest_forces_count():
    """Loads, stresses, and what was out of balance at the start."""
    scale = begun(loads=3.0, stresses=(5.0, 2.0))
    assert scale.forces == 5.0
    assert scale.max_norms(0.0) == pytest.approx(5.0 * SOLVER_RESIDUAL)
    scale.update_stresses(1.0)
    assert scale.forces == 3.0
    scale.include_initial_residual(40.0)
    scale.update_stresses(1.0)
    assert scale.forces == scale.least_forces == 40.0
    assert scale.relative_norm(4.0) == pytest.approx(0.1)
    scale.begin(3.0, 0.0, 0.0)  # a new step forgets it
    scale.include_initial_residual(math.inf)  # and forces that are not finite do not count
    scale.update_stresses(math.nan)
    assert scale.forces == 3.0
    assert not math.nan <= scale.allowed_residual


def test_rigid_far_motion():
    """Supports that carry stiff bodies far leave stresses of rounding; these pass for forces, a real one does not."""
    scale = begun(prescribed=1e4, stresses=(MACHINE_EPSILON * STIFF * 1e4,))
    assert scale.allowed_residual >= MACHINE_EPSILON * STIFF * 1e4
    assert scale.relative_norm(MACHINE_EPSILON * STIFF * 1e4) < ACCEPTED_RESIDUAL
    assert scale.relative_norm(1e-6 * STIFF * 1e4) > ACCEPTED_RESIDUAL


def test_loads_that_end_at_zero():
    """Where they have moved the bodies before, rounding of that is all that is left."""
    scale = begun(moved=0.3)
    assert (scale.least_forces, scale.allowed_residual) == pytest.approx((1e-8 * STIFF * 0.3, 1e-14 * STIFF * 0.3))
    assert begun(moved=0.3, loads=1.0).forces == 1.0


def test_bodies_far_away_on_soft_springs():
    """Solvers may stop at rounding of stiffness times displacement, but never above the share of the loads for a state."""
    scale = begun(loads=1.0)
    assert (scale.max_norms(0.1), scale.max_norms(1e2)) == pytest.approx(
        (SOLVER_RESIDUAL, MACHINE_EPSILON * STIFF * 1e2)
    )
    assert (scale.max_norms(1e12), scale.allowed_residual) == pytest.approx((ACCEPTED_RESIDUAL, ACCEPTED_RESIDUAL))


def test_springs_between_bodies_round_more():
    """Springs that act on the difference of two bodies' displacements count where they are stiffer than the bodies."""
    assert begun(cancelling=1e9).force_rounding(1.0) == 1e3 * begun().force_rounding(1.0)
    assert begun(cancelling=1.0).force_rounding(1.0) == begun().force_rounding(1.0)
    assert begun(cancelling=1e9, moved=1.0).least_forces == begun(moved=1.0).least_forces
