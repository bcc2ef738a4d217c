"""Laws with time, bulk and traction laws and sublayers in series, with their parameters, for tests at points."""

from __future__ import annotations

from forms import BulkLaw, KelvinVoigt, LinearElastic, Maxwell, Norton, NortonCreep, Stack, TractionLaw
from tests.own_laws import Hardening, Mises, Slipping, StandardSolid, Stiffening

EXACT = 1e-12  # relative: a few operations, and of a stack the last Newton step of its local problem
ROUNDING = 1e-14
THETAS = [1.0, 0.7, 0.5]
LMBDA, MU = 60.0, 40.0
K_N, K_T = LMBDA + 2 * MU, MU


ELASTIC = LinearElastic(LMBDA, MU)
KELVIN = KelvinVoigt(LMBDA, MU, 0.3, 0.5)
MAXWELL, MAXWELL_2 = Maxwell(LMBDA, MU, 0.7), Maxwell(LMBDA, MU, 0.7, 1.5)
NORTON_15, NORTON_3 = Norton(LMBDA, MU, 5.0, 1.5), Norton(LMBDA, MU, 5.0, 3.0)
CREEP = NortonCreep(LMBDA, MU, A=0.02, n=3.5)
SOLID = StandardSolid(LMBDA, MU, 25.0, 0.4)
MISES = Mises(LMBDA, MU, 7.0)
STIFF = LinearElastic(20.0, 90.0)
STACKS = {
    "Maxwell, Norton 1.5": Stack((0.3, MAXWELL), (0.7, NORTON_15)),
    "Maxwell, Kelvin-Voigt": Stack((0.3, MAXWELL), (0.7, KELVIN)),
    "elastic, plastic": Stack((0.4, STIFF), (0.6, MISES)),
    "three": Stack((0.2, KELVIN), (0.5, MAXWELL_2), (0.3, NORTON_3)),
    "nested": Stack((0.5, Stack((0.4, MAXWELL), (0.6, SOLID))), (0.5, STIFF)),
    "user, Norton 1.5": Stack((0.6, Hardening(LMBDA, MU)), (0.4, NORTON_15)),
}
LAWS: dict[str, BulkLaw] = {
    "Kelvin-Voigt": KELVIN,
    "Maxwell": MAXWELL,
    "Maxwell t1 != t2": MAXWELL_2,
    "Norton 1.5": NORTON_15,
    "Norton 3": NORTON_3,
    "Norton's creep": CREEP,
    "user": SOLID,
    "user, not quadratic": Hardening(LMBDA, MU),
    "user, elastic": Stiffening(LMBDA, MU, 90.0),
    "traction": Slipping(70.0, 30.0, 12.0, 90.0),
    **STACKS,
}
BALANCED = [name for name, law in LAWS.items() if not isinstance(law, TractionLaw)]  # those that declare an energy
QUADRATIC = [name for name in BALANCED if LAWS[name].traits.has_quadratic_energy]
