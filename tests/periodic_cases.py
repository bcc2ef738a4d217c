"""Periodic cells with known numbers, some from an independent program."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from forms import LinearElastic, MohrCoulomb, MohrCoulombMonodirectional
from geometry import bond_cell, periodic, sandwich, wall
from geometry.joint import Joint
from tests.network_cases import springs
from thinlayer import Structure, Surface, ThinLayer, homogenised_stiffness, march, solve

BRICK = (2.0, 1.0)
MORTAR = {"BED": springs(5.0, 2.1), "HEAD": springs(3.0, 1.3)}
BOND = {  # Young's modulus of bricks -> A_1111, A_2222, A_1212, A_1122
    1e2: (7.472714907, 4.771972123, 1.56705223, 8.56e-2),
    1e3: (8.032298032, 4.976126106, 1.637118965, 9.59e-3),
    1e4: (8.093175598, 4.997601268, 1.644532268, 9.71e-4),
    1e6: (8.0999317, 4.999976, 1.6453525, 9.7e-6),
}
RIGID = (8.1, 5.0, 1.645360825)  # the limits for stiff bricks
FREE = {"BED": springs(0.7, 0.3), "HEAD": springs(0.4, 0.2)}  # beside bricks of E = 1


def bond(E: float = 1e3, *, cell: str = "quadrilateral", element: str | None = None, **options) -> Structure:
    """A running bond of bricks 2 x 1."""
    joint = bond_cell(BRICK, 0.25, cell=cell)
    return Structure(joint, body=LinearElastic.young(E, 0.2), supports={}, element=element, **options)


def stiffness(joint: Joint, E: float, element: str | None = None) -> np.ndarray:
    structure = Structure(joint, body=LinearElastic.young(E, 0.2), supports={}, element=element)
    return homogenised_stiffness(structure.interface(MORTAR))


def laminate(cell: str = "quadrilateral", h: float = 0.25, **options) -> Joint:
    """A layer in bodies of height 1 in all, repeated in all directions."""
    sides = [("LEFT", "RIGHT"), ("BOTTOM", "TOP"), ("BACK", "FRONT")]
    joint = wall(1, 2, (1.0, 0.5), h, cell=cell, **options)
    facets = {name: rows for name, rows in joint.facets.items() if name not in joint.seams}
    joint = replace(joint, facets=facets | {"S": joint.facets["BED"]}, seams={"S": joint.seams["BED"]})
    return periodic(joint, *sides[: joint.dim])


def yielded() -> tuple[float, ...]:
    """Stored and dissipated energy, shear stress and largest imbalance of a bond whose heads yield, under a shear."""
    heads = {"HEAD": ThinLayer(MohrCoulomb(0.2, 0.2, cohesion=2e-4, friction_angle=30.0), 0.01, at=1.0)}
    model = bond(1.0, strain=lambda x, t: ((0.0, 0.01 * t), (0.01 * t, -0.002 * t))).interface(FREE | heads)
    history = march(model, [0.25, 0.5, 0.75, 1.0])
    audits = [state.audit for state in history]
    imbalance = max(abs(one.imbalance) for one in audits)
    dissipated = sum(one.dissipated for one in audits)
    return audits[-1].total, dissipated, float(history.last.mean_stress()[0, 1]), imbalance


def slid(times) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Mean stresses, and mean tractions on S, of a laminate that is pressed to t = 1 and then sheared."""
    law = MohrCoulombMonodirectional(8.0, 4.0, cohesion=0.02, friction_angle=30.0)

    def strain(x, t):
        return ((0.0, 0.05 * t), (0.05 * t, -0.04))

    structure = Structure(laminate(), body=LinearElastic.young(10.0, 0.25), supports={}, strain=strain)
    model = structure.interface(ThinLayer(law, 0.01, at=1.0))
    history, surface = march(model, times), Surface(model)
    return [state.mean_stress() for state in history], [surface.integral(surface.traction(state)) for state in history]


STRESS = np.array([[0.3, 0.2], [0.2, -1.0]])


def under_stress() -> list[float]:
    """Mean strain, mean stress and energy of a bond whose heads yield, under a mean stress."""
    heads = {"HEAD": ThinLayer(MohrCoulomb(0.2, 0.2, cohesion=2e-4, friction_angle=30.0), 0.01, at=1.0)}
    model = bond(1.0, stress=lambda x, t: [[1e-3 * c * t for c in row] for row in STRESS]).interface(FREE | heads)
    last = march(model, [0.5, 1.0]).last
    return [
        *last.mean_strain().ravel().tolist(),
        *last.mean_stress().ravel().tolist(),
        last.audit.total,
        last.audit.imbalance,
    ]


def held_at_a_point() -> list[float]:
    """Mean displacement of a strip that is moved by one vertex of its periodic sides, and the mean stress."""
    strip = periodic(sandwich(1.0, 0.5, 0.5, 0.25, cell="quadrilateral"), ("LEFT", "RIGHT"))
    supports = {(1.0, -0.5): {"x": 0.1, "y": 0.2}}
    structure = Structure(strip, body=LinearElastic.young(10.0, 0.25), supports=supports, strain=((1e-3, 0), (0, 0)))
    state = solve(structure.interface(springs(4.0, 1.5)))
    mean = [state.integral(state.u[k] * state.model.dx) for k in range(2)]
    return [*mean, *state.mean_stress().ravel().tolist()]


def numbers() -> dict[str, list[float]]:
    found = {f"bond {E:g}": stiffness(bond_cell(BRICK, 0.25), E).ravel().tolist() for E in (1e2, 1e4)}
    found["triangles"] = stiffness(bond_cell(BRICK, 0.25, cell="triangle"), 1e2, "P1").ravel().tolist()
    found["space"] = stiffness(bond_cell(BRICK, 0.5, depth=1.0), 1e2, "Q1").ravel().tolist()
    found["yielded"] = yielded()[:3]
    found["held at a point"] = held_at_a_point()
    found["under stress"] = under_stress()[:-1]
    found["slid"] = slid([0.5, 1.0])[0][-1].ravel().tolist()
    return found
