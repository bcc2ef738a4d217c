"""UFL: kinematics, laws, and the work line that carries a law into a body, a meshed layer or a surface S.

The names here are those that users import: laws, contracts of laws, and what laws are written with.
"""

# ruff: noqa: F401
from forms.check import check
from forms.contact import ContactLaw, HolonomicCoulomb, IncrementalCoulomb, Tresca
from forms.elastic import Anisotropic, LinearElastic
from forms.kernel import KernelLaw
from forms.law import BulkLaw
from forms.non_monotone import NonMonotone, NonMonotoneUnrelaxed
from forms.plastic import MohrCoulomb, MohrCoulombMonodirectional, VonMises
from forms.rubber import Incompressible, Rubber
from forms.series import Stack
from forms.temperature import TemperatureTable
from forms.traction import TractionLaw
from forms.viscous import KelvinVoigt, Maxwell, Norton, NortonCreep
