"""Random structures with a thin layer between two blocks, for estimates of what dropping its mesh changes."""

from __future__ import annotations

from functools import partial

import numpy as np
import ufl
from dolfinx import fem

from forms import Anisotropic, LinearElastic, Stack
from forms.elastic import VOIGT_PAIRS
from forms.tensors import Expr
from studies.dropped import CLAMPED, H_S, DroppedCase
from studies.problems import free_blocks
from thinlayer import ThinLayer, goals
from thinlayer.discretisation.interface_model import InterfaceModel

young = LinearElastic.young


def random_case(seed: int) -> tuple[float, DroppedCase]:
    """Return a random thickness and a random case; the same `seed` always gives the same ones.

    The case has two blocks, 1 wide and 1.5 to 40 thicknesses high, and a layer of one to three plies. Lengths and
    stresses have no units.
    """
    rng = np.random.default_rng(seed)
    eps = 10 ** rng.uniform(-2.0, -0.9)
    heights = np.minimum(1.5 * eps * 10 ** rng.uniform(0.0, 1.43, 2), 1.0)
    body = {name: young(10 ** rng.uniform(2.0, 2.5), rng.uniform(0.0, 0.4)) for name in ("LOWER", "UPPER")}
    plies = [_random_ply(rng) for _ in range(seed % 3 + 1)]
    law = Stack(*zip(rng.dirichlet([3.0] * len(plies)), plies, strict=True)) if len(plies) > 1 else plies[0]
    load, has_rollers, eigenstrain = rng.normal(size=2), rng.random() < 0.3, -0.01 if rng.random() < 0.2 else None
    words = [type(ply).__name__ for ply in plies] + ["rollers"] * has_rollers + ["shrinks"] * (eigenstrain is not None)

    def mean_displacement(u: Expr, model: InterfaceModel) -> Expr:
        direction = fem.Constant(model.domain.mesh, np.array([0.6, 0.8]) / heights[1])
        return ufl.inner(direction, u) * model.ds(model.domain.values("RIGHT/UPPER"))

    supports = CLAMPED | ({"LEFT": {"x": 0.0}} if has_rollers else {})
    blocks = partial(free_blocks, eps / 4, tuple(load), tuple(heights), h_S=H_S, body=body, supports=supports)
    layer = ThinLayer(law, eps, eigenstrain=eigenstrain)
    qois = goals.Compliance(), goals.Functional("mean displacement", mean_displacement)
    return eps, DroppedCase(" ".join(words), lambda _: blocks(), lambda _: layer, qois=qois)


def _random_ply(rng: np.random.Generator) -> LinearElastic | Anisotropic:
    """Draw the law of a ply from the generator `rng`.

    Young's modulus is between 0.1 and 100, that of the bodies at least 100. With the probability 1/2 the ply also has
    fibres in a random direction.
    """
    ply, d, power = (
        young(10 ** rng.uniform(-1.0, 2.0), rng.uniform(0.0, 0.45)),
        rng.normal(size=3),
        rng.uniform(0.0, 2.0),
    )
    if rng.random() < 0.5:
        return ply
    fibre_strain = np.array([d[i] * d[j] for i, j in VOIGT_PAIRS]) / (d @ d)  # strain along fibres, from Voigt's order
    lmbda, mu = ply.elastic_moduli()
    C = np.diag([2.0 * mu] * 3 + [mu] * 3) + 10**power * np.outer(fibre_strain, fibre_strain)
    C[:3, :3] += lmbda
    return Anisotropic(C, "layer")
