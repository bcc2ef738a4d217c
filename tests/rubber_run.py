"""Layers with a pressure, and bodies with projected volume strains, have the same numbers on 1, 2 and 3 ranks."""

from __future__ import annotations

import math

import numpy as np
import ufl

from forms import Incompressible, LinearElastic, Rubber, VonMises
from geometry import block, periodic, sandwich
from thinlayer import State, Structure, Surface, ThinLayer, compare, march, solve

BODY = LinearElastic(80.0, 50.0)
EPS = 0.06
RUBBER = Rubber(1900.0, 2.0)
VARYING = Rubber(lambda x: 1900.0 * (1 + x[0]), lambda x: 2.0 / (1 + x[0]))


def strip(**sides) -> Structure:
    joint = sandwich(1.0, 0.5, 0.4, 0.2, h_S=0.1, h_ends=0.03)
    top = {"TOP": lambda x, t: (0.02 * (1 + t) * x[0], -0.03 * (1 + t) * (1 + x[0] ** 2))}
    return Structure(joint, body=BODY, supports={"BOTTOM": 0.0, **sides}, tractions=top)


def solid(cell: str) -> Structure:
    """Held on one of four sides; the pressure is zero on the others."""
    joint = sandwich(1.0, 0.4, 0.3, 0.25, depth=0.8, cell=cell)
    supports = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}}
    return Structure(joint, body=BODY, supports=supports, tractions={"TOP": lambda x, t: (0.01, -0.03, 0.02 * x[0])})


def on_a_base() -> Structure:
    joint = block(1.0, 0.5, 0.2, h_S=0.1, cell="quadrilateral")
    return Structure(joint, body=BODY, supports={}, tractions={"TOP": lambda x, t: (0.02, -0.03 * (1 + x[0]))})


def measured(name: str, state: State) -> dict[str, float]:
    found = {
        f"{name} u": state.integral(ufl.inner(state.u, state.u) * ufl.dx),
        f"{name} energies": sum(value for value in state.energies().values() if np.isfinite(value)),
    }
    p = state.p
    assert p is not None
    own, comm = p.function_space.dofmap.index_map.size_local, p.function_space.mesh.comm
    found[f"{name} pressures"] = comm.allreduce(float((p.x.array[:own] ** 2).sum()))
    found[f"{name} zero pressures"] = comm.allreduce(int((p.x.array[:own] == 0).sum()))
    if state.model.broken:
        surface = Surface(state.model)
        found[f"{name} jump"] = surface.norm(surface.jump(state))
        found[f"{name} profile"] = float(np.abs(surface.profile(surface.frame(surface.traction(state)))[1]).sum())
    return found


def numbers() -> dict[str, float]:
    found: dict[str, float] = {}
    structures = {
        "strip": strip(),
        "held strip": strip(LEFT={"x": 0.0}),
        "tetrahedra": solid("tetrahedron"),
        "hexahedra": solid("hexahedron"),
        "base": on_a_base(),
    }
    cases = (
        [(name, RUBBER) for name in structures]
        + [("base", VARYING)]
        + [(name, Incompressible(2.0)) for name in ("strip", "hexahedra")]
    )
    for name, law in cases:
        layer, called = (
            ThinLayer(law, EPS, order=1, at=1.0),
            f"{name} {type(law).__name__}{' varying' * (law is VARYING)}",
        )
        full = solve(structures[name].full(layer, cells_through=1 if name.endswith("hedra") else 2))
        limit = solve(structures[name].interface(layer))
        found |= measured(f"{called} meshed", full) | measured(called, limit)
        # errors are differences of numbers that are 1 in size
        found |= {f"{called} {key}": 1 + value for key, value in compare(full, limit).items()}
    history = march(strip().interface(ThinLayer(RUBBER, EPS, order=1, at=1.0)), [0.3, 1.0], theta=0.5)
    found |= measured("march", history.last)
    cell = periodic(sandwich(2.0, 0.5, 0.5, 0.25, depth=1.0, cell="hexahedron", structured=True), ("LEFT", "RIGHT"))
    top = {"TOP": lambda x, t: (0.0, 0.1 * ufl.cos(ufl.pi * (x[0] - 0.3)), 0.03)}
    repeated = Structure(cell, body=BODY, supports={"BOTTOM": 0.0}, tractions=top)
    found |= measured("periodic", solve(repeated.interface(ThinLayer(RUBBER, EPS, order=1, at=1.0))))
    return found | flow()


def flow() -> dict[str, float]:
    """A tube of a metal that yields, with projected volume strains, on quadrilaterals of degree 1 and 2."""
    wall = sandwich(3.0, 6.0, 6.0, 2.0, cell="quadrilateral").rotated(-math.pi / 2).moved((12.0, 3.0))
    metal = VonMises.young(E=70e3, nu=0.3, strength=100.0)
    found = {}
    for element in ("Q1", "Q2"):
        tube = Structure(
            wall, body=metal, supports={"LEFT": {"y": 0.0}, "RIGHT": {"y": 0.0}}, plane="axisymmetric", element=element,
            tractions={"BOTTOM": lambda x, t: (t, 0.0)},
        )  # fmt: skip
        last = march(tube.bonded(), [80.0, 110.0, 120.0]).last
        found[f"{element} u"] = last.integral(ufl.inner(last.u, last.u) * ufl.dx)
        found[f"{element} dissipated"] = last.audit.dissipated
    return found
