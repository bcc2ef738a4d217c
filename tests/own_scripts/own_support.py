"""A support of one's own: a guided stiff beam moves all nodes of a side alike."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse

from forms import LinearElastic
from geometry import sandwich
from thinlayer import Probe, Structure, ThinLayer, solve
from thinlayer.discretisation.constraints import MultiPointConstraint
from thinlayer.discretisation.part_definition import PartDefinition


@dataclass(frozen=True)
class Level(PartDefinition):
    """All nodes of a facet set move alike along y, under a given force."""

    place: str
    force: object  # along y, per thickness: a number, or a function (x, t)
    key: str = "level"
    components = ("y",)  # it ties these; along x nodes are free

    def total_force(self, model):
        force = model.coordinates.coefficient(self.force, "the level's force", ())
        return force.once("the whole beam")

    def check(self, model):
        self.total_force(model)

    def multi_point_constraint(self, model):
        # displacements of this rank
        n = model.V.dofmap.index_map.size_local * model.joint.dim
        rows = self.bc_dofs_in(model, model.V)
        rows = rows[rows < n]
        ones = (np.ones(len(rows)), (rows, np.zeros_like(rows)))
        R = scipy.sparse.csr_matrix(ones, (n, 1))
        force = lambda t: np.array([self.total_force(model).at_time(t)])
        return MultiPointConstraint(self.key, ["y"], R, {}, force)


joint = sandwich(width=40, lower=6, upper=6, h=1)  # mm
# MPa; twice as stiff on the right
concrete = LinearElastic.young(E=lambda x: 20e3 * (1 + x[0] / 40), nu=0.2)
supports = {"BOTTOM": {"y": 0}, "LEFT": {"x": 0}}
beam = Level("TOP", force=-2000)
pressed = Structure(joint, body=concrete, supports=supports, parts=[beam])
state = solve(pressed.interface(ThinLayer(LinearElastic.young(E=2e3, nu=0.3), 0.2)))
lowered = Probe(state).displacement([(1, 6), (39, 6)])[:, 1]
print(lowered, state.reaction("BOTTOM").force[1])  # -0.0230, -0.0230 mm; 2000 N/mm
