"""Rigid plates on the boundary: for each motion of a plate, either the motion or its force is prescribed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import scipy.sparse
from dolfinx import fem

from forms.base import Array, InputError
from forms.kinematics import PLANE_STRAIN
from forms.tensors import Expr
from geometry.refusals import require_known
from thinlayer.discretisation.boundary import AXIS_NAMES, boundary_tags
from thinlayer.discretisation.coefficient import Coefficient
from thinlayer.discretisation.constraints import MultiPointConstraint
from thinlayer.discretisation.part_definition import HostModel, PartDefinition
from thinlayer.discretisation.rigid_motions import (
    centroid,
    moment_centre,
    require_point,
    resultant_mask,
)
from thinlayer.discretisation.state import State

Number = float | Callable[[Expr, Expr], Expr]
Vector = Sequence[float] | Callable[[Expr, Expr], Sequence[Expr]]
ROTATION_NAMES = {2: ("rotation",), 3: ("rotation x", "rotation y", "rotation z")}


def motion_names(d: int) -> list[str]:
    """Return the names of a plate's motions in `d` dimensions: "x", "y" and "rotation" in 2D.

    In 3D they are "x", "y", "z", "rotation x", "rotation y" and "rotation z".
    """
    return [*AXIS_NAMES[:d], *ROTATION_NAMES[d]]


@dataclass(frozen=True, eq=False)
class PlateMotion:
    """Displacement and rotation of a rigid plate; d: number of dimensions.

    Attributes:
        translation: (d,) displacement of the reference point.
        rotation: small rotation in radians: (3,), in 2D a number, > 0 from x to y.
        about: (d,) coordinates of the reference point.
    """

    translation: Array
    rotation: Array
    about: Array


@dataclass(frozen=True)
class RigidPlate(PartDefinition):
    """Rigid plate that is bonded to a facet set of the outer boundary.

    Where the facet set meets the side of a meshed layer, the plate is bonded to that side, too. The nodes of the plate
    move as a rigid body, with small rotations. Its motions are a translation along each of the d axes, and one rotation
    in 2D, three in 3D.

    For each motion the user prescribes either the motion or its force or moment, by default zero. Each value may also
    be a function (x, t) that depends on the time alone, or `piecewise`. A support at one node of the plate constrains
    the motion of the whole plate.

    Attributes:
        place: name of a facet set on the outer boundary.
        force: (d,) resultant force on the plate; in plane models per unit thickness.
        moment: resultant moment about the point `about`: a number in 2D (> 0 from x to y), (3,) in 3D.
        motion: name of a motion -> its prescribed value. "x", "y", "z": displacement of the point `about`, a length.
            "rotation" (in 3D "rotation x", ...): a small angle in radians.
        about: (d,) coordinates of the reference point in the model's mesh; None: the centroid of the facet set.
        key: name of the plate's unknowns: "plate NAME" for the facet set NAME.

    Raises:
        InputError: when a model is made: the facet set is unknown or empty, or has inner facets; or a value is no
            number. Also if a prescribed motion has a force too, or a node belongs to two plates.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import RigidPlate, Structure, ThinLayer, solve
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> plate = RigidPlate("TOP", force=(0, -40), moment=10)
        >>> plates = Structure(joint, body=steel, supports={"BOTTOM": 0}, parts=[plate])
        >>> state = solve(plates.interface(ThinLayer(glue, eps=0.05)))
        >>> motion = plate.motion_in(state)
        >>> f"{motion.translation[1]:.3g}, {motion.rotation:.3g}"
        '-0.000238, 4.55e-05'
    """

    place: str
    force: Vector | None = None
    moment: Number | Vector | None = None
    motion: Mapping[str, Number] = field(default_factory=dict)
    about: Sequence[float] | None = None
    key: str = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "key", f"plate {self.place}")

    def multi_point_constraint(self, model: HostModel) -> MultiPointConstraint:
        """Return the constraint by which the displacements of the plate's nodes follow its few motions. Collective."""
        d, size = model.joint.dim, model.domain.joint.size
        units = np.where(np.arange(PLANE_STRAIN.motion_count(d)) < d, 1.0, size)
        keys, loads, vals = self.prescribed_motions(model), self._prescribed_loads(model), self._motions(model)
        motion = {k: partial(lambda k, t: float(vals[k].at_time(t) * units[k]) if k in vals else 0.0, k) for k in keys}
        R = self._motion_matrix(model, self.point(model), size)
        return MultiPointConstraint(self.key, motion_names(d), R, motion, lambda t: self._at(t, loads, keys, d) / units)

    def motion_in(self, state: State) -> PlateMotion:
        """Return the displacement and rotation of the plate in `state`. Collective."""
        model = state.model
        (mpc,) = (mpc for mpc in model.constraints.mpcs if mpc.key == self.key)
        q, d = model.constraints.fit_motions(mpc, state.u.x.array[: model.constraints.n]), model.joint.dim
        rotation = q[d:] / model.domain.joint.size  # the unknowns are lengths
        return PlateMotion(q[:d], np.asarray(rotation[0] if d == 2 else rotation), self.point(model))

    def _motion_matrix(self, model: HostModel, about: Array, size: float) -> scipy.sparse.csr_matrix:
        """Return the matrix (n, k) from the plate's k motions to this rank's n displacement components. Collective.

        In an interface model of order 1, lever arms of rotations are measured as if the bodies had moved apart by the
        layer's thickness. The plate then rotates as on a meshed layer.

        Args:
            model: the model.
            about: (d,) reference point of the rotations; d: number of dimensions.
            size: size of the structure. The unknowns of rotations are angles times this length.
        """
        V, d = model.V, model.joint.dim
        n_owned = V.dofmap.index_map.size_local
        dofs = fem.locate_dofs_topological(V, d - 1, model.domain.facets(self.place, layer_sides=True))
        nodes = np.unique(dofs[dofs < n_owned])
        try:
            x = V.tabulate_dof_coordinates()[nodes, :d]
        except RuntimeError as error:
            raise InputError(f"{self.title} needs nodal displacements, not elements S2") from error
        if (shifts := model.meshing_translations()) is not None:
            node_shifts = np.zeros((n_owned + V.dofmap.index_map.num_ghosts, d))
            node_shifts[V.dofmap.list] = shifts[model.domain.original_cells][:, None]
            low, high = node_shifts[nodes].min(axis=0, initial=np.inf), node_shifts[nodes].max(axis=0, initial=-np.inf)
            extrema = np.array(model.comm.allgather((low, high)))
            middle = (extrema[:, 0].min(axis=0) + extrema[:, 1].max(axis=0)) / 2  # the reference point does not shift
            x = x + node_shifts[nodes] - middle
        motion_values = PLANE_STRAIN.unit_motions_at(x, about)
        motion_values[:, :, d:] /= size
        k = motion_values.shape[2]
        indices = np.repeat(nodes[:, None] * d + np.arange(d), k), np.tile(np.arange(k), len(nodes) * d)
        return scipy.sparse.csr_matrix((motion_values.ravel(), indices), (n_owned * d, k))

    # ---------------------------------------------------------------- prescribed values
    @property
    def title(self) -> str:
        """Name of the plate in messages."""
        return f"plate on {self.place!r}"

    def check(self, model: HostModel) -> None:
        """Raise InputError unless the plate's facet set and values fit the model. Collective."""
        boundary_tags(model.domain, model.kinematics, self.place, self.title)
        d, names = model.joint.dim, motion_names(model.joint.dim)
        for name in self.motion:
            require_known("motion", name, names, self.title)
            if names.index(name) in self._excluded(model):
                raise InputError(f"{self.title}: a plate of revolution has no motion {name!r}; it moves along the axis")
        if self.about is not None:
            require_point(self.about, d)
        if not any(value.varies for value in [*self._prescribed_loads(model).values(), *self._motions(model).values()]):
            self._at(0.0, self._prescribed_loads(model), self.prescribed_motions(model), d)

    def _prescribed_loads(self, model: HostModel) -> dict[str, Coefficient]:
        """Return the prescribed loads of the plate, under the names "force" and "moment", if they are not None."""
        d, loads = model.joint.dim, (("force", self.force), ("moment", self.moment))
        shapes: dict[str, tuple[int, ...]] = {"force": (d,), "moment": () if d == 2 else (3,)}
        return {name: self._converted(model, name, value, shapes[name]) for name, value in loads if value is not None}

    def _motions(self, model: HostModel) -> dict[int, Coefficient]:
        """Return the prescribed motions: position of the motion in `motion_names` -> its prescribed value."""
        names = motion_names(model.joint.dim)
        return {names.index(k): self._converted(model, f"motion {k!r}", value, ()) for k, value in self.motion.items()}

    def _converted(self, model: HostModel, name: str, value: Number | Vector, shape: tuple[int, ...]) -> Coefficient:
        """Convert a value that the user prescribes to a `Coefficient` that may depend on the time, not on the place.

        Args:
            model: the model.
            name: name of the value in messages.
            value: number, vector or function (x, t) that the user gave.
            shape: shape that the value must have.
        """
        coefficient: Coefficient = model.coordinates.coefficient(value, f"{self.title}: {name}", shape)
        return coefficient.once("the whole plate")

    @staticmethod
    def _excluded(model: HostModel) -> list[int]:
        """Return the positions in `motion_names` of the motions that the model's symmetry excludes.

        In axisymmetry these are all motions except the translation along the axis.
        """
        return [int(k) for k in np.flatnonzero(resultant_mask(model.kinematics, model.joint.dim) == 0)]

    def _at(self, t: float, loads: Mapping[str, Coefficient], prescribed: Sequence[int], d: int) -> Array:
        """Return the forces (k,) on the k motions of the plate at time `t`; those on rotations are moments.

        Args:
            t: time.
            loads: the prescribed loads under the names "force" and "moment".
            prescribed: positions of the prescribed motions in `motion_names`.
            d: number of dimensions.

        Raises:
            InputError: a motion is prescribed, and its force or moment is not zero.
        """
        out, slices = np.zeros(PLANE_STRAIN.motion_count(d)), {"force": slice(d), "moment": slice(d, None)}
        for name, value in loads.items():
            out[slices[name]] = value.at_time(t)
        for k in prescribed:
            if out[k]:
                text = f"{self.title}: the motion {motion_names(d)[k]!r} is prescribed, and {out[k]:g} is given"
                raise InputError(f"{text} for its force or moment; one of them follows from the other")
        return out

    def point(self, model: HostModel) -> Array:
        """Return the coordinates (d,) of the reference point of rotations and moments, in d dimensions. Collective.

        By default it is the centroid of the facet set, in axisymmetry the projection of the centroid onto the axis.
        """
        if self.about is not None:
            return require_point(self.about, model.joint.dim)
        return moment_centre(model.kinematics, centroid(model.domain, self.place))

    def prescribed_motions(self, model: HostModel) -> list[int]:
        """Return the positions in `motion_names`, ascending, of motions that are prescribed or excluded by axisymmetry.

        Axisymmetry excludes all motions except the translation along the axis.
        """
        return sorted({*self._excluded(model), *(motion_names(model.joint.dim).index(name) for name in self.motion)})
