"""Surface: tractions, jumps, statuses and tables on S of a state, as arrays that are the same on all ranks."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from forms.base import Array, InputError, is_finite, require, unknown_name_message
from forms.breaking import BROKEN_DAMAGE
from forms.kinematics import ScalarField
from forms.law import Law
from forms.layer_results import ELASTIC, YIELD_STATUSES, LayerPoints
from geometry.topology import IntArray
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.output.contact_fields import CONTACT_STATUSES, Contact, balance_errors, contact_values
from thinlayer.output.layer_energies import dissipated_in_steps, mode_mix
from thinlayer.output.tractions import consistent_tractions, layer_tractions
from thinlayer.solving.history import History
from thinlayer.surface.law_points import LawPoints, layer_points, layer_shares, match_law_points
from thinlayer.surface.lines import level_points
from thinlayer.surface.surface_mesh import SurfaceMesh
from thinlayer.system.table import Row, Table

NO_LAYER_STATUS, BONDED_STATUS = "no layer", "bonded"
# those of further laws have later numbers in files
STATUSES = (*YIELD_STATUSES, NO_LAYER_STATUS, BONDED_STATUS, *CONTACT_STATUSES)


class Surface(SurfaceMesh):
    """The surface S of a joint, or one of its seams, with methods that evaluate states of the joint's models there.

    A field on S is an array with a value at each of q quadrature points of each of n facets: (n, q), for vectors
    (d, n, q) in d dimensions. A field that is constant on facets is (n, 1). The constructor and all methods that take a
    state are collective; results are complete on every rank. Integrals, lines and nodes on S are those of the base
    class `SurfaceMesh`.

    Args:
        model: a model of the joint.
        seam: name of a seam; "S": all seams.

    Attributes:
        x, n: (d, n, q) coordinates of the quadrature points, and unit normals of S from the lower to the upper side.
        weights: (n, q) weights of integrals over S: areas, in axisymmetry of the whole revolution.
        seams: (n,) name of each facet's seam.

    Raises:
        InputError: not a model, or an unknown seam.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, Surface, ThinLayer, solve
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> state = solve(plates.interface(ThinLayer(glue, eps=0.05)))
        >>> surface = Surface(state.model)
        >>> surface.traction(state).shape  # components, facets, points of a facet
        (2, 8, 3)
        >>> print(surface.integral(surface.traction(state)).round(3))
        [ 12. -40.]
    """

    def traction(self, state: State) -> Array:
        """Return the traction (d, n, q) on S, stress times n, as a field that is linear on each facet.

        For a scalar field it is the flux along n, with one component, see `flux`. It depends on what joins the bodies
        on a seam:

        - Contact law: its tractions at the nodes.
        - Interface law: the traction of the law, conjugate to the jump [u].
        - Meshed layer: the mean of stress times n through the thickness, in which elastic sublayers are weighted by
          their compliances. It is zero where layers meet. If the thickness varies on a rigid base, it differs from the
          traction of the interface law by O(eps).
        - Bond, and all seams of `Estimate.better`: the traction equivalent to the nodal forces of the bodies (see
          `reaction`).

        Tractions of interface laws and meshed layers are projected in L2 to fields that are linear on each facet. If
        the surface's model has a contact law on any seam, the mass matrix of the projection is lumped.
        """
        self._require_same_joint(state)
        is_bonded = np.isin(self.seams, state.model.bonds)
        if is_bonded.all() or state.with_meshed_layers:
            return self.reaction(state)
        layer_traction = self.at_points(layer_tractions(self, state))
        return np.where(is_bonded[:, None], self.reaction(state), layer_traction) if is_bonded.any() else layer_traction

    def flux(self, state: State) -> Array:
        """Return the flux (n, q) of a scalar field along n through S, which is chosen as `traction` is.

        Raises:
            InputError: a state of displacements, or of another joint.
        """
        state.model.kinematics.require(ScalarField.unknown, "flux", "traction")
        return self.traction(state)[0]

    def value_in_layer(self, state: State, height: float | None = None) -> Array:
        """Return the values (n, q) of a scalar field in the layers of an interface model. Collective.

        At order 2 they are quadratic in the height, else linear. In a meshed layer see `Probe.value`.

        Args:
            state: a state of an interface model.
            height: distance from the middle along n over the thickness, from -1/2 at the lower to 1/2 at the upper face.
                None: the mean through the thickness is meant.

        Raises:
            InputError: height out of range; a state of another kind of model, of displacements, or of another joint.
        """
        is_height = height is None or (is_finite(height) and abs(height) <= 0.5)
        require(is_height, "height", height, "allowed: from -1/2 to 1/2, or None")
        z, shape = (0.0, 1.0) if height is None else (height, 6 * (1 / 4 - height**2))
        lower, upper = self.displacements(state)
        model = state.model
        model.kinematics.require(ScalarField.unknown, "value_in_layer", "jump")
        if not isinstance(model, InterfaceModel):
            raise InputError(f"value_in_layer is of layers without cells, not of {model!r}; take Probe(state).value")
        values = (lower + upper)[0] / 2 + z * (upper - lower)[0]
        for name, layer in model.layers.items():
            if layer.bubble_key in state.fields:
                b = self.side_values(state.fields[layer.bubble_key], model, self.quadrature)[1, 0]
                values += shape * b * (self.seams == name)[:, None]
        return np.asarray(values)

    def reaction(self, state: State) -> Array:
        """Return the traction (d, n, q) on S that is equivalent to the bodies' nodal forces; linear on each facet.

        If a support constrains the nodes of one side of S, the traction follows from the nodal forces of the other
        side. If supports constrain both sides, or if seams around a vertex form a cycle, the nodal forces do not
        determine it. Of all tractions that fit, the result is then the one closest to the mean at neighbouring nodes.
        Where S ends inside a body, the traction is zero.
        """
        self._require_same_joint(state)
        all_of_s = SurfaceMesh(self.model)  # forces at junctions are sums over all seams there
        tractions, is_bond = consistent_tractions(all_of_s, state), np.isin(all_of_s.seams, state.model.bonds)
        if is_bond.any() and not is_bond.all() and state.model.broken:
            has_bond = all_of_s.nodal_sums(np.broadcast_to(is_bond[:, None], all_of_s.nodes.shape).astype(float)) > 0
            tractions = np.where(has_bond[:, None], tractions, consistent_tractions(all_of_s, state, bonds_joined=True))
        return self.at_points(tractions[all_of_s.positions_of(self.node_numbers)])

    # ---------------------------------------------------------------- status, phases, contact
    def status(self, state: State) -> npt.NDArray[np.str_]:
        """Return words (n, 1) that tell what the layer has done at each of n facets, in a state of an interface model.

        - "elastic": nothing has yielded, or the law has no plastic strain.
        - "sliding": the plastic strain across S is mainly a slip along S.
        - "crushed", "torn": the plastic strain is mainly a closing, or an opening, along n.
        - "open": the sides have separated, and no traction across S is left.
        - "breaking", "broken": laws such as `Breaking` are damaged there, partly or by more than 0.999.
        - "no layer": no law acts on this part of S.
        - "bonded": the seam has a `Bond`.
        - "separated", "sliding", "stick", "pinned": under contact laws, the status of nodes (`Contact.status`).
        - Further words of a law that the user defines (`forms.layer_results.LayerResults.status_at`).

        If points of a facet differ, the facet has the word of most of its area. Plastic strains are those accumulated
        since the beginning of the history.

        Raises:
            InputError: a state of another kind of model.
        """
        self._require_same_joint(state)
        model = state.model
        if not isinstance(model, InterfaceModel):
            raise InputError(f"a status is of a state of an interface model, not of {model!r}")
        areas = {name: np.zeros(len(self.rows)) for name in all_statuses(model)}
        for name in model.joint.seams:
            if len(statuses := seam_statuses(model, name)) == 1:
                areas[statuses[0]][self.seams == name] = 1.0
        for points, facets in layer_points(self, state):
            if len(statuses := law_statuses(points.term.law)) > 1:
                status, weights = _statuses_at_points(self, points, facets), self.rule(points.quadrature.degree).weights
                facets = facets[facets >= 0]
                for name in statuses:
                    np.add.at(areas[name], facets, (weights[facets] * (status == name)).sum(axis=1))
        if contact := contact_values(self, state):
            corner_statuses = contact["status"][self.nodes]
            for name in CONTACT_STATUSES:
                areas[name] += ((self.weights @ self.shapes) * (corner_statuses == name)).sum(axis=1)
        return np.array([*areas])[model.comm.allreduce(np.array([*areas.values()])).argmax(axis=0)][:, None]

    def phase(self, state: State) -> Array:
        """Return the mean phase (n, 1) of a non-monotone layer at each of n facets, in a full or an interface model.

        The phase is a number in [-1, 1]. -1, 0 and 1 are pure phases. Positive fractions are the volume fraction of
        phase 1 in a mixture with phase 0. Negative fractions are minus the volume fraction of phase -1 in such a
        mixture. nan: the layer has no phases.
        """
        return self._facet_means(state, "phase", ())

    def internal(self, state: State, name: str) -> Array:
        """Return the means (n, 1) of an internal variable of a layer's law over each of n facets, and over the thickness.

        An example is the damage "d" of `Breaking`, also in a meshed layer. A tensor has its components first, (3, 3, n,
        1). nan: the law on this facet has no such variable.

        Args:
            state: a state of a full or an interface model.
            name: name of the variable, see `internal` of the law's class.

        Raises:
            InputError: no layer of the model has the variable.
        """
        return self._facet_means(state, name, self._internal_shape(state, name))

    def _internal_shape(self, state: State, name: str) -> tuple[int, ...]:
        self._require_same_joint(state)
        laws = [law for layer in state.model.layers.values() for _, law in layer.law.sublayers]
        shapes = {variable: shape for law in laws for variable, shape in law.internal.items()}
        if not isinstance(name, str) or name not in shapes:
            raise InputError(unknown_name_message("internal variable", name, shapes))
        return shapes[name]

    # ---------------------------------------------------------------- fracture
    def mode_mix(self, state: State) -> Array:
        """Return the mode mixity B (n, 1) on each of n facets, from 0 (opening) to 1 (shear). Collective.

        B is Y_II/(Y_I + Y_II) for the energies that damage releases in shear and in opening, both integrated over the
        facet. Where all is broken, it is that of the open crack. nan: facets that neither open nor slide, or whose law
        has no modes.

        Args:
            state: a state of a full or an interface model with a layer of `Breaking` or `Cohesive`.

        Raises:
            InputError: no layer has modes, or one is a sublayer of a `Stack`.
        """
        self._require_same_joint(state)
        return mode_mix(self, state)

    def dissipated(self, history: History) -> Array:
        """Return the energy per area (rows, n, 1) that layers dissipate on n facets in the step of each row of a table.

        Its integral is the column "dissipated", without what bodies dissipate. `dissipated(history).sum(axis=0)` is what
        breaking has cost at each place. It is zero in the row of a state with which a march begins. Collective.

        Args:
            history: a history with all states.

        Raises:
            InputError: states are missing; a contact law, or a law whose phases switch, which have no such field.
        """
        require(isinstance(history, History), "dissipated", history, "give a history, as march returns it")
        self._require_same_joint(history.last)
        return dissipated_in_steps(self, history)

    def crack_front(self, state: State, d: float = BROKEN_DAMAGE) -> Array:
        """Return the points (k, dim) of the edge of the broken area: in 2D its ends, in 3D in order along lines.

        The edge is interpolated between facets by their broken shares. Where S ends there is none. Collective.

        Args:
            state: a state of a full or an interface model with a layer that has a damage "d".
            d: damage beyond which a point belongs to the area; 0: the edge of what has begun to break.

        Raises:
            InputError: d is not from 0 to below 1, or no layer has a damage.
        """
        require(is_finite(d) and 0 <= d < 1, "crack_front: d", d, "allowed: from 0 to below 1")
        share = self._facet_means(state, "d", self._internal_shape(state, "d"), above=d)
        heights = self.lumped(self.moments(np.nan_to_num(share)))[self.nodes] - 0.5
        seams = [self.seams == name for name in dict.fromkeys(self.seams.tolist())]
        return np.concatenate([level_points(self.joint, self.seam, self.rows[k], heights[k]) for k in seams])

    def _facet_means(self, state: State, name: str, shape: tuple[int, ...], above: float | None = None) -> Array:
        """Return the means (*shape, n, 1) over each of n facets of an internal variable; nan where a law lacks it.

        With `above`, the shares of the facets where it is larger than this number.
        """
        self._require_same_joint(state)
        integrals, size = np.zeros((1 + math.prod(shape), len(self.rows))), math.prod(shape)
        for points, facets in layer_points(self, state):
            cells, facets_here = points.quadrature.cells[facets >= 0], facets[facets >= 0]
            for (fraction, law), internal in zip(points.term.law.sublayers, points.internal(), strict=True):
                if name in law.internal:
                    weights = fraction * points.quadrature.weights[cells]
                    values = internal[name].reshape(len(internal[name]), size)[cells]
                    values = values if above is None else (values > above).astype(float)
                    np.add.at(integrals[0], facets_here, weights.sum(axis=1))
                    for integral, component in zip(integrals[1:], np.moveaxis(values, -1, 0), strict=True):
                        np.add.at(integral, facets_here, (weights * component).sum(axis=1))
        volumes, *sums = state.model.comm.allreduce(integrals)
        means = np.where(volumes > 0, np.array(sums) / np.where(volumes > 0, volumes, 1.0), np.nan)
        return means.reshape(*shape, -1, 1)

    def contact(self, state: State) -> Contact:
        """Return status, jumps and tractions of contact laws at the nodes of this surface, in a state.

        Raises:
            InputError: the state's model has no contact law on this surface.
        """
        self._require_same_joint(state)
        if not (values := contact_values(self, state)):
            seams = ", ".join(state.model.contacts) or "none"
            raise InputError(f"{self.seam!r} has no contact law in {state.model!r}; seams with contact laws: {seams}")
        force_error, work_error = balance_errors(state)
        return Contact(surface=self, **values, equilibrium=force_error, clapeyron=work_error)

    def table(self, state: State) -> Table:
        """Summarise a state on S in a table with a row for each seam; entries that do not apply to a seam are None.

        - "seam", "size": the seam's name, and its area.
        - "elastic", "sliding", ...: in interface models the fraction of the seam's area with this `status`. Under
          contact laws areas are those around the nodes.
        - "normal_force": under contact laws the integral of the pressure, a force.
        - "plus", "minus": in non-monotone layers, also of full models, the volume fractions of phases 1 and -1.
        - "boundary": in such layers the mean thickness of phase 0. It is the height of the phase boundary above the
          lower face if the other phases lie above phase 0.
        - "broken", "breaking": of laws such as `Breaking` the fractions of the area that are damaged by more than 0.999,
          and less; also of full models. Other laws may add columns.
        """
        self._require_same_joint(state)
        model, rows = state.model, []
        status = self.status(state) if isinstance(model, InterfaceModel) else None
        nodal = contact_values(self, state)
        for seam in dict.fromkeys(self.seams.tolist()):
            is_in_seam, layer = self.seams == seam, model.layers.get(seam)
            seam_area = float(self.weights[is_in_seam].sum())
            row: Row = {"seam": seam, "size": seam_area}
            if seam in model.contacts:
                areas = nodal["areas"] * np.isin(np.arange(len(self.node_numbers)), self.nodes[is_in_seam])
                ratios = {name: float(areas[nodal["status"] == name].sum() / areas.sum()) for name in CONTACT_STATUSES}
                row |= ratios | {"normal_force": float(areas @ nodal["p"])}
            elif status is not None:
                areas = self.weights.sum(axis=1) * is_in_seam / seam_area
                row |= {name: float(areas @ (status[:, 0] == name)) for name in seam_statuses(model, seam)}
            if layer:
                row |= {name: share for name, share in layer_shares(state, seam).items() if name not in row}
            rows.append(row)
        columns = dict.fromkeys(name for row in rows for name in row)
        return Table({name: row.get(name) for name in columns} for row in rows)


def seam_statuses(model: Model, seam: str) -> tuple[str, ...]:
    """Return the words that `Surface.status` may give to facets of a seam in a model."""
    if seam in model.contacts:
        return CONTACT_STATUSES
    if seam not in model.layers:
        return (BONDED_STATUS if seam in model.bonds else NO_LAYER_STATUS,)
    return law_statuses(model.layers[seam].law)


def law_statuses(law: Law) -> tuple[str, ...]:
    """Return the words that `Surface.status` may give to facets of a layer with this law, in any of its sublayers."""
    return tuple(dict.fromkeys(word for _, sublayer in law.sublayers for word in sublayer.statuses))


def all_statuses(model: Model) -> tuple[str, ...]:
    """Return all words that `Surface.status` may give for a model: first `STATUSES`, then those that its laws add."""
    return tuple(dict.fromkeys((*STATUSES, *(word for seam in model.layers for word in seam_statuses(model, seam)))))


def _statuses_at_points(surface: SurfaceMesh, points: LawPoints, facets: IntArray) -> npt.NDArray[np.str_]:
    """Return words (facets, q) that tell what a layer has done at each quadrature point of its law. Collective.

    Only layers of interface models are meant, whose law has q points on each facet.

    Args:
        surface: the surface.
        points: quadrature points of the law on this rank.
        facets: for each facet where the law acts, its number on the surface. -1: it is not on this surface, and not in
            the result.
    """
    model, q, sublayers = points.state.model, points.quadrature, points.term.law.sublayers
    (layer,) = (seam_layer for seam_layer in model.layers.values() if seam_layer.key == points.term.key)
    rule, is_in_seam = surface.rule(q.degree), surface.seams == layer.name
    lower_u, upper_u = surface.side_values(points.state.u, model, rule)[:, :, is_in_seam]
    facet_openings = np.zeros(rule.weights.shape)
    facet_openings[is_in_seam] = ((upper_u - lower_u) * rule.n[:, is_in_seam]).sum(axis=0)
    point_numbers, point_openings = match_law_points(rule, facets, points), np.zeros(q.count)
    point_openings[point_numbers] = facet_openings[facets[facets >= 0]]
    plastic_strain, internal = np.zeros((q.count, 3, 3)), points.internal()
    for (fraction, law), variables in zip(sublayers, internal, strict=True):
        if (strain := law.plastic_strain(variables)) is not None:
            plastic_strain += fraction * strain
    t = np.einsum("pij,pj->pi", points.stress(), q.n)
    largest_traction = model.comm.allreduce(float(np.abs(t).max(initial=0.0)), max)
    largest_strain = float(np.abs(upper_u - lower_u).max(initial=0.0))
    largest_strain /= float(layer.thin_layer.eps) if layer.thin_layer else 1.0
    status = np.full(q.count, ELASTIC)
    for (_, law), variables in zip(sublayers, internal, strict=True):
        point_values = LayerPoints(variables, plastic_strain, t, q.n, point_openings, largest_traction, largest_strain)
        status = np.where(status == ELASTIC, law.status_at(point_values), status)
    return status[point_numbers]
