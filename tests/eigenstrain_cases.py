"""Models with eigenstrains."""

from __future__ import annotations

import ufl
from dolfinx import fem
from dolfinx.mesh import create_rectangle
from mpi4py import MPI

from forms import LinearElastic, Maxwell
from geometry import sandwich
from thinlayer import Structure, ThermalExpansion, ThinLayer, march

BODY, GLUE = LinearElastic.young(30.0, 0.3), Maxwell(7.0, 5.0, t1=0.7, t2=0.9)
HOT = ThermalExpansion(2e-3, lambda x, t: t * (1 + x[0] ** 2))


def computed(values, element=("Lagrange", 2), width=2.0) -> fem.Function:
    """A function on a mesh of its own."""
    mesh = create_rectangle(MPI.COMM_WORLD, [(0.0, -0.5), (width, 0.75)], (5, 5))
    T = fem.Function(fem.functionspace(mesh, element))
    T.interpolate(values)
    return T


def numbers() -> dict[str, float]:
    found: dict[str, float] = {}
    joint = sandwich(2.0, 0.5, 0.75, 0.25)
    data = {"body": BODY, "supports": {"BOTTOM": 0.0}, "tractions": {"TOP": (0.02, -0.05)}}
    T = computed(lambda x: 1 + x[0] ** 2)
    for kind, hot in (
        ("full computed", ThermalExpansion(2e-3, T, factor=lambda x, t: t)),
        ("interface computed", ThermalExpansion(2e-3, T, factor=lambda x, t: t)),
        ("full", HOT),
        ("interface", HOT),
    ):
        layer = ThinLayer(
            GLUE, 0.1, eigenstrain=[hot, lambda x, t: ((0, 1e-3 * x[0]), (1e-3 * x[0], -2e-3 * t))], at=1.0
        )
        model = getattr(Structure(joint, eigenstrain=hot, **data), kind.split()[0])(layer)
        state = march(model, [0.5, 1.0]).last
        found[f"{kind} u"] = state.integral(ufl.inner(state.u, state.u) * ufl.dx)
        found[f"{kind} supplied"] = state.audit.supplied
        found[f"{kind} stored"] = state.audit.total
    return found
