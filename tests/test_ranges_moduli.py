"""Stiffness and moduli at rest are those of differences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import ufl

from forms import Anisotropic, BulkLaw, KelvinVoigt, LinearElastic, Maxwell
from forms.planes import Kinematics
from forms.stations import GAUSS, Faces
from forms.trace import average_lame, in_plane_modulus, tangent_at_rest

MODULI = np.diag([7.0, 5, 9, 2, 3, 4])
MODULI[:3, :3] += np.array([[0, 1.2, 0.7], [1.2, 0, 1.9], [0.7, 1.9, 0]])
MODULI[0, 4] = MODULI[4, 0] = 0.8
MODULI[1, 3] = MODULI[3, 1] = -0.6


# ---------------------------------------------------------------- stiffness at rest
@dataclass(frozen=True)
class Unnamed(BulkLaw):
    """Anisotropic elasticity that says nothing of its stiffness, and is not linear."""

    law: BulkLaw

    def stress(self, step):
        return self.law.stress(step) * (1 + ufl.tr(step.e) ** 2)

    def parameters(self):
        return {}


@pytest.mark.parametrize(("frame", "n"), [("layer", (0.48, -0.64, 0.6)), ("global", (0.0, 1.0))])
def test_stiffness_by_differences(frame, n):
    law, n = Anisotropic(MODULI, frame), np.array(n)
    assert tangent_at_rest(Unnamed(law), n) == pytest.approx(law.stiffness(n), abs=1e-6)


def test_moduli():
    law, n = LinearElastic(6.0, 2.5), np.array([0.28, 0.96])
    voigt = np.diag([11.0, 11, 11, 2.5, 2.5, 2.5])
    voigt[:3, :3] += 6.0 * (1 - np.eye(3))
    for one in (law, Anisotropic(voigt, "layer"), KelvinVoigt(6.0, 2.5, 0.3, 0.7), Maxwell(6.0, 2.5, 0.4)):
        C = one.stiffness(n)
        assert average_lame(C) == pytest.approx((6.0, 2.5))
        assert in_plane_modulus(C, n) == pytest.approx(4 * 2.5 * 8.5 / 11)  # E/(1 - nu^2)
    springs = Anisotropic.springs(3.0, 5.0).stiffness(n)
    assert abs(in_plane_modulus(springs, n)) < 1e-12


@pytest.mark.parametrize("n", [(0.6, 0.8), (0.48, -0.64, 0.6)])
@pytest.mark.parametrize("plane", ["strain", "stress"])
def test_change_through_the_layer_leaves_the_faces_without_traction(n, plane):
    law = LinearElastic(6.0, 2.5)
    law = law.plane_stress() if plane == "stress" else law
    given = np.zeros((3, 3))
    given[: len(n), : len(n)] = np.random.default_rng(5).normal(size=(len(n), len(n)))
    given += given.T
    d, gradient = len(n), ufl.as_matrix(given[: len(n), : len(n)].tolist())
    faces = Faces(ufl.as_vector(n), 0.3, ufl.zero(d), gradient, ufl.zero(3, 3), Kinematics().along)
    lower, upper = (station.strain(law, faces) for station in law.stations())
    form = (upper - lower) / (2 * GAUSS[1])
    found = np.array([[form((0.0,), component=(i, j)) for j in range(3)] for i in range(3)])
    stress = law.lmbda * np.trace(found) * np.eye(3) + 2 * law.mu * found
    normal = np.pad(n, (0, 3 - len(n)))
    assert stress @ normal == pytest.approx(np.zeros(3), abs=1e-12)
    along = np.eye(3) - np.outer(normal, normal)
    assert along @ found @ along == pytest.approx(along @ given @ along, abs=1e-12)
