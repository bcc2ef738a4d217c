"""Constitutive laws in UFL, kinematics, and the virtual work of a law in a body, in a meshed layer or on a surface S.

This module exports the names that users import: laws, base classes for user-defined laws, `check`, `Tabulated`.
"""

# ruff: noqa: F401
from forms.adhesion import Adhesion
from forms.breaking import Breaking, Cohesive
from forms.broken_friction import CohesiveFriction
from forms.check import check
from forms.conduction import AnisotropicConduction, Conductance, Conduction, Heat
from forms.contact import ContactLaw, HolonomicCoulomb, IncrementalCoulomb, Tresca
from forms.elastic import Anisotropic, LinearElastic
from forms.flux import FluxLaw
from forms.kernel import KernelLaw
from forms.law import BulkLaw
from forms.microcracks import Microcracked
from forms.non_monotone import NonMonotone, NonMonotoneUnrelaxed
from forms.plastic import MohrCoulomb, MohrCoulombMonodirectional, VonMises
from forms.rubber import Incompressible, Rubber
from forms.series import Stack
from forms.temperature import Tabulated
from forms.traction import TractionLaw
from forms.viscous import KelvinVoigt, Maxwell, Norton, NortonCreep
