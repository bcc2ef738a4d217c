"""The public names, for editors and mypy, and for `__init__.py`, which imports them when they are first used."""

import typing

from thinlayer.discretisation.broken_mesh import BrokenMesh as BrokenMesh
from thinlayer.discretisation.coefficient import Pressure as Pressure
from thinlayer.discretisation.layer import Bond as Bond
from thinlayer.discretisation.layer import Gap as Gap
from thinlayer.discretisation.layer import SurfaceSource as SurfaceSource
from thinlayer.discretisation.layer import ThinLayer as ThinLayer
from thinlayer.discretisation.point_loads import LineLoad as LineLoad
from thinlayer.discretisation.point_loads import PointLoad as PointLoad
from thinlayer.discretisation.prescribed_strains import Prestress as Prestress
from thinlayer.discretisation.prescribed_strains import ThermalExpansion as ThermalExpansion
from thinlayer.discretisation.structure import Structure as Structure
from thinlayer.discretisation.time_functions import piecewise as piecewise
from thinlayer.errors import InputError as InputError
from thinlayer.errors import LimitLoad as LimitLoad
from thinlayer.errors import RangeWarning as RangeWarning
from thinlayer.errors import SolveError as SolveError
from thinlayer.errors import ThinlayerError as ThinlayerError
from thinlayer.estimating.derivative import derivative as derivative
from thinlayer.estimating.estimate import estimate as estimate
from thinlayer.estimating.failure_load import failure_load as failure_load
from thinlayer.estimating.fit import Fit as Fit
from thinlayer.estimating.fit import Measurement as Measurement
from thinlayer.estimating.fit import fit as fit
from thinlayer.estimating.fit import read_measurements as read_measurements
from thinlayer.estimating.frequencies import estimate_frequencies as estimate_frequencies
from thinlayer.estimating.frequencies import frequency_derivatives as frequency_derivatives
from thinlayer.estimating.refinement import solve_to as solve_to
from thinlayer.estimating.sensitivity import sensitivity as sensitivity
from thinlayer.estimating.strength import MohrCoulombCriterion as MohrCoulombCriterion
from thinlayer.estimating.strength import QuadraticCriterion as QuadraticCriterion
from thinlayer.estimating.strength import StrengthCriterion as StrengthCriterion
from thinlayer.estimating.strength import strength as strength
from thinlayer.estimating.thickness import thin_enough as thin_enough
from thinlayer.output.comparison import compare as compare
from thinlayer.output.ensemble import ensemble as ensemble
from thinlayer.output.homogenised import homogenised_conductivity as homogenised_conductivity
from thinlayer.output.homogenised import homogenised_stiffness as homogenised_stiffness
from thinlayer.output.probe import Probe as Probe
from thinlayer.output.surface import Surface as Surface
from thinlayer.output.sweep import sweep as sweep
from thinlayer.output.zooming import Zoom as Zoom
from thinlayer.parts.film import Film as Film
from thinlayer.parts.inertia import Inertia as Inertia
from thinlayer.parts.joule import JouleHeat as JouleHeat
from thinlayer.parts.plates import RigidPlate as RigidPlate
from thinlayer.parts.springs import Springs as Springs
from thinlayer.parts.ufl_part import UflPart as UflPart
from thinlayer.pointwise.drive import drive as drive
from thinlayer.solving.coupling import coupled as coupled
from thinlayer.solving.harmonic import harmonic as harmonic
from thinlayer.solving.initial_state import initial_state as initial_state
from thinlayer.solving.modes import modes as modes
from thinlayer.solving.solve import solve as solve
from thinlayer.solving.step_problem import StepProblem as StepProblem
from thinlayer.system.table import Table as Table
from thinlayer.system.units import Units as Units
from thinlayer.time.marching import march as march
from thinlayer.time.plan import Adaptive as Adaptive
from thinlayer.time.plan import ArcLength as ArcLength

__version__: str

def __getattr__(name: str) -> typing.Any: ...
