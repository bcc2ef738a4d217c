"""Cells, supports and loads of a structure with meshed layers, from its interface model and its layers alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import ufl
from ufl.algorithms import expand_derivatives
from ufl.algorithms.analysis import extract_constants
from ufl.corealg.traversal import traverse_unique_terminals, unique_pre_traversal
from ufl.differentiation import Derivative

from forms.base import Array
from forms.law import BulkLaw
from forms.law_tangents import depends_on_normal, evaluate, is_isotropic, tangent_at_rest
from forms.rubber import Rubber
from forms.tensors import MANDEL_BASIS, Expr, average_lame
from geometry.domain import Domain
from geometry.topology import Indices, IntArray, lagrange
from thinlayer.bounding.cells import StraightCells, mass_matrix
from thinlayer.bounding.tractions import CellLoads
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import law_with_numbers
from thinlayer.discretisation.mesh_functions import band_of
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.supports import NORMAL_COMPONENT
from thinlayer.errors import InputError, Violation
from thinlayer.solving.layer_subproblem import LayerSubproblem
from thinlayer.system.compat import ufl_replace

SHAPE_TOLERANCE = 1e-9  # difference of shapes of cells, normals or loads, over their size, that counts as rounding
MAX_POISSON_RATIO = 0.499  # above it bounds would be wide
CELL_PROBES = {2: np.array([[0.23, 0.31]]), 3: np.array([[0.23, 0.31, 0.17]])}  # places off the nodes
FACET_PROBES = {2: np.array([[0.23]]), 3: np.array([[0.23, 0.31]])}


def refusal(key: str, reason: str, remedy: str) -> InputError:
    """Return the error of a structure or goal without bounds against the continuum, for the caller to raise."""
    return Violation(key, reason, remedy).error("estimate, continuum: ")


class StructureCells:
    """Bodies and meshed layers of an estimate as straight cells, those of the bodies first.

    Attributes:
        cells: the cells, in the order of the joint with meshed layers.
        is_layer: (nc,) mask of the layers' cells.
        is_free: (nf, d) mask of the components of tractions that are not known: on inner facets, and at supports.
        has_moving_supports: whether supports prescribe displacements that are not zero.

    Args:
        model: the interface model.
        layers: its layers, meshed by themselves.
        t: time of loads and supports.

    Raises:
        InputError: the structure has no bounds against the continuum; the error's `key` names the condition.
    """

    def __init__(self, model: InterfaceModel, layers: LayerSubproblem, t: float) -> None:
        self._model, self._layers, self._layer_model, self._t = model, layers, layers.model, t
        _check_structure(model, layers)
        joint = layers.model.inflated_joint
        n_bodies, d = len(model.joint.cells), joint.dim
        self.is_layer = np.arange(len(joint.cells)) >= n_bodies
        degree = model.structure.degree
        self.cells = StraightCells(joint.points, joint.corners, joint.cell_type, degree, self._stiffnesses())
        body_points = model.domain.joint.cell_points
        difference = self.cells.A[:n_bodies] - np.swapaxes(body_points[:, 1 : d + 1] - body_points[:, :1], 1, 2)
        assert np.abs(difference).max() <= SHAPE_TOLERANCE * joint.size, "cells are not those of the interface model"
        self._body_nodes = np.asarray(model.V.dofmap.list)[model.domain.local_cells]
        self._layer_nodes = np.asarray(layers.model.V.dofmap.list)[layers.model.domain.local_cells]
        self.is_free = np.repeat(~self.cells.is_outer[:, None], d, axis=1)
        self.has_moving_supports = False
        for part, first_cell in ((model, 0), (layers.model, n_bodies)):
            self._add_supports(part, first_cell)
        self._loads: CellLoads | None = None

    def displacements(self, u: Array, w: Array) -> Array:
        """Return displacements (nc, n, d) of the cells' nodes, from those of the bodies `u` and of the layers `w`."""
        d = self.cells.d
        n = self._layer_model.V.dofmap.index_map.size_local * d
        return np.concatenate([u.reshape(-1, d)[self._body_nodes], w[:n].reshape(-1, d)[self._layer_nodes]])

    def corner_points(self, numbers: IntArray) -> Array:
        """Return the corners (k, l, d) of k cells, of bodies as in the interface model, where loads are defined."""
        x, n_bodies = self.cells.points[self.cells.corners[numbers]], len(self._model.joint.cells)
        of_bodies = numbers < n_bodies
        x[of_bodies] = self._model.domain.joint.cell_points[numbers[of_bodies]]
        return np.asarray(x)

    def stress(self, u: Array, w: Array) -> Array:
        """Return stresses (nc, k, nv) at `stress_points` of the bodies' displacements `u` and the layers' unknowns `w`.

        Where a law has a pressure field, its pressure replaces that of the displacements.
        """
        cells, U = self.cells, self.displacements(u, w)
        stress = cells.stress(U)
        has_pressure = np.flatnonzero(self._pressure_moduli)
        if len(has_pressure):
            unit = np.trace(cells.basis, axis1=1, axis2=2)
            at_points = lagrange(cells.cell_type, 1).tabulate(0, cells.stress_points)[0, :, :, 0]
            pressures = self._layers.cell_pressures(w)[has_pressure - len(self._model.joint.cells)]
            by_strain = self._pressure_moduli[has_pressure, None] * (cells.strain(U)[has_pressure] @ unit)
            stress[has_pressure] += (pressures @ at_points.T - by_strain)[..., None] * unit
        return stress

    # ---------------------------------------------------------------- laws
    def _stiffnesses(self) -> Array:
        """Return the stiffness (nc, nv, nv) of each cell (unit: stress); set eigenstresses, and moduli of pressure fields.

        Raises:
            InputError: a law with memory, or with functions of the place; an almost incompressible one; eigenstrains
                that vary.
        """
        model, joint, band = self._model, self._layer_model.inflated_joint, band_of(self._layer_model.inflated_joint)
        laws = {name: model.kinematics.law(law) for name, law in model.body_laws.items()}
        strains = {name: self._eigenstrain(model, strain, name) for name, strain in model.body_strains.items()}
        for name, seam_layer in self._layer_model.layers.items():
            in_layer = {*band.regions_of_seam[name], *(r for r, seam in band.junctions.items() if seam == name)}
            layer_strain = self._layer_model.layer_strains[name]
            strains |= dict.fromkeys(in_layer, self._eigenstrain(self._layer_model, layer_strain, name))
            sublayers = law_with_numbers(seam_layer.layer, model.structure.kinematics).sublayers
            laws |= {r: law for (_, law), r in zip(sublayers, band.regions_of_seam[name], strict=True)}
            laws |= {r: sublayers[0][1] for r, seam in band.junctions.items() if seam == name}
        normals = np.zeros((len(joint.cells), joint.dim))
        normals[:, -1] = 1.0
        normals[self.is_layer] = band.director.mean(axis=1)
        if np.abs(band.director - band.director[:, :1]).max(initial=0.0) > SHAPE_TOLERANCE:
            dependent = [name for name, law in laws.items() if name in band.regions and depends_on_normal(law)]
            if dependent:
                raise refusal("moduli", f"the law of {dependent[0]} turns with the normal of S", "use an isotropic law")
        nv = 3 * (joint.dim - 1)
        C, self._pressure_moduli = np.empty((len(joint.cells), nv, nv)), np.zeros(len(joint.cells))
        self._eigenstress = np.zeros((len(joint.cells), nv))
        indices = [*model.structure.kinematics.strain_indices(joint.dim)]
        for number, region in enumerate(joint.regions):
            in_region = np.flatnonzero(joint.region == number)
            directions, direction_of = normals[in_region[:1]], np.zeros_like(in_region)
            if depends_on_normal(laws[region]):
                directions, direction_of = np.unique(np.round(normals[in_region], 12), axis=0, return_inverse=True)
            tangents = [_tangent(laws[region], region, n) for n in directions]
            if laws[region].traits.constrained:
                self._pressure_moduli[in_region] = average_lame(tangents[0])[0]
                if strains[region].any():
                    raise refusal("eigenstrain", f"{region} has a pressure field and an eigenstrain", "leave it out")
            of_cells = np.stack(tangents)[direction_of.ravel()][:, indices]
            C[in_region], self._eigenstress[in_region] = of_cells[:, :, indices], of_cells @ strains[region]
        return C

    def _eigenstrain(self, model: Model, prescribed_strain: Expr | None, name: str) -> Array:
        """Return the components (6,) of the eigenstrain of a body or layer; `prescribed_strain` is minus that."""
        if prescribed_strain is None:
            return np.zeros(6)
        with model.forces.at.clock.at(self._t):
            values = {constant: np.asarray(constant.value) for constant in extract_constants(prescribed_strain)}
            try:
                return np.asarray(-np.einsum("rij,ij->r", MANDEL_BASIS, evaluate(prescribed_strain, values)))
            except Exception as error:
                reason = f"the eigenstrain of {name} is a function of the place"
                raise refusal("eigenstrain", reason, "give numbers, or more regions") from error

    # ---------------------------------------------------------------- interface laws
    def with_law(self, model: InterfaceModel, u: Array) -> tuple[StraightCells, Array, CellLoads]:
        """Return the bodies with interface laws of order 0: cells, their displacements (nc, n, d), and loads.

        The loads contain the tractions K [u]/eps on S: polynomials of the degree of the bodies' displacements `u`. They
        are those of `model`, on the same mesh; the estimate may have begun from laws of another order.

        Raises:
            InputError: the laws are not of order 0, the thickness varies, bodies are extended, the layers have loads,
                supports move, or there are eigenstrains.
        """
        cells, n, d = self.cells, len(self._model.joint.cells), self.cells.d
        joint, kinematics, loads = model.domain.joint, model.structure.kinematics, self.loads
        layers = {name: layer.as_thin_layer for name, layer in model.layers.items()}
        if model.bonds or any(layer.law.traits.constrained for layer in model.layers.values()):
            reason = "bodies are bonded at S, or a layer's law has a pressure field"
            raise refusal("law alone", reason, "estimate a state with an interface law of LinearElastic")
        if joint.parted is not None or any(layer.order or layer.profile for layer in layers.values()):
            raise refusal("law alone", "the law is not of order 0 on S", "use order=0, a number as eps, bodies='kept'")
        on_layer = loads.moments[cells.moment_rows[n:]] * cells.is_outer[cells.cell_facets[n:]][..., None, None]
        if on_layer.any() or loads.body_force[n:].any() or loads.eigenstress.any() or self.has_moving_supports:
            reason = "loads act on the layer, supports move, or there are eigenstrains"
            raise refusal("law alone", reason, "put loads on the bodies alone")
        bodies = StraightCells(joint.points, joint.corners, joint.cell_type, cells.degree, cells.C[:n])
        U, shape = self.displacements(u, np.zeros(len(self._layers.load)))[:n], (*bodies.facet_nodes.shape, d)
        moments, is_free, normals = np.zeros((bodies.facet_nodes.size, d)), *np.ones((2, len(bodies.facets), d))
        moments[bodies.moment_rows] = loads.moments[cells.moment_rows[:n]]
        is_free[bodies.cell_facets] = self.is_free[cells.cell_facets[:n]]
        normals[bodies.cell_facets[bodies.sign > 0]] = bodies.area_vectors[bodies.sign > 0]
        normals /= bodies.areas[:, None]
        jumps = -bodies.moment_sums(bodies.sign[..., None, None] * U[:, bodies.closure]).reshape(shape)
        indices = [*kinematics.strain_indices(d)]
        for name, layer in layers.items():
            facets, sublayers = joint.rows_of(name), law_with_numbers(model.layers[name].layer, kinematics).sublayers
            directions, direction_of = np.unique(np.round(normals[facets], 12), axis=0, return_inverse=True)
            flexibilities = np.zeros((len(directions), d, d))
            for flexibility, normal in zip(flexibilities, directions, strict=True):
                strains = bodies.basis @ normal  # of unit jumps, times eps
                for fraction, law in sublayers:
                    C = _tangent(law, name, normal)[np.ix_(indices, indices)]
                    flexibility += fraction * layer.eps * np.linalg.inv(strains.T @ C @ strains)
            K = np.linalg.inv(flexibilities)[direction_of.ravel()]
            mass = bodies.areas[facets, None, None] * mass_matrix(bodies.facet_type, cells.degree)
            moments.reshape(shape)[facets], is_free[facets] = mass @ jumps[facets] @ K, 0.0
        return bodies, U, CellLoads(loads.body_force[:n], moments, is_free > 0, loads.eigenstress[:n])

    # ---------------------------------------------------------------- supports and loads
    def _facets(self, domain: Domain, entities: Indices, first_cell: int) -> IntArray:
        """Return the numbers in `cells` of facets `entities` of a domain whose cells begin at `first_cell`."""
        table = domain.joint.table
        rows = domain.numbers(domain.joint.dim - 1, entities)
        return np.asarray(self.cells.cell_facets[table.cells[rows, 0] + first_cell, table.local[rows, 0]])

    def _add_supports(self, model: Model, first_cell: int) -> None:
        """Mark in `is_free` what the supports of a model hold; its cells begin at `first_cell`."""
        supports = model.supports
        self.has_moving_supports |= any(np.any(value.components) for value in supports.values.values())
        for entry, (place, components) in enumerate(supports.entries):
            if not isinstance(place, str):
                raise refusal("point support", f"a support acts at the point {place}", "support a facet set")
            facets = self._facets(model.domain, model.domain.facets(place, layer_sides=True), first_cell)
            for axis in components:
                coefficient = supports.values.get((entry, axis))
                if coefficient is not None and coefficient.varies:
                    raise refusal("moving support", f"the support on {place!r} moves by a function", "give a number")
                component = self._component_along(facets, place) if axis == NORMAL_COMPONENT else "xyz".index(axis)
                self.is_free[facets, component] = True

    def _component_along(self, facets: IntArray, place: str) -> int:
        """Return the index of the coordinate axis that is normal to all `facets`."""
        x = self.cells.points[self.cells.facets[facets]]
        spans = np.ptp(x, axis=1) / np.ptp(x, axis=1).max(axis=1, keepdims=True, initial=1e-300)
        flat = np.flatnonzero((spans < SHAPE_TOLERANCE).all(axis=0))
        if len(flat) != 1:
            raise refusal("inclined", f"the support on {place!r} is along no axis", "name components x, y, z")
        return int(flat[0])

    @property
    def loads(self) -> CellLoads:
        """The loads of the structure."""
        if self._loads is None:
            n_bodies, self._loads = len(self._model.joint.cells), replace(self.no_loads, eigenstress=self._eigenstress)
            for model, first_cell in ((self._model, 0), (self._layer_model, n_bodies)):
                v = ufl.TestFunction(model.V)
                with model.forces.at.clock.at(self._t):
                    self.add_densities(self._loads, model.forces.work(v, bodies_only=not first_cell), model, first_cell)
        return self._loads

    @property
    def no_loads(self) -> CellLoads:
        """Loads that are zero."""
        cells = self.cells
        return CellLoads(
            np.zeros((*cells.nodes.shape, cells.d)),
            np.zeros((cells.facet_nodes.size, cells.d)),
            self.is_free,
            np.zeros(self._eigenstress.shape),
        )

    def add_densities(self, loads: CellLoads, form: ufl.Form, model: Model, first_cell: int = 0) -> None:
        """Add the densities of a linear form, of a load or a goal, to loads.

        Args:
            loads: the loads, which are changed.
            form: the form, with one argument.
            model: the model on whose mesh it is integrated.
            first_cell: number of the first of the model's cells among all.

        Raises:
            InputError: a density that is no polynomial of a low degree, or a form of derivatives.
        """
        domain, cells, d = model.domain, self.cells, self.cells.d
        for integral in form.integrals():
            kind, tags = integral.integral_type(), integral.subdomain_id()
            if kind not in ("cell", "exterior_facet"):
                raise refusal("density", f"a load or goal is an integral of the kind {kind}", "use dx and ds")
            density = _Density(integral.integrand(), form.arguments()[0])
            is_all = tags in ("everywhere", "otherwise")
            if kind == "cell":
                mesh_cells = np.flatnonzero(np.isin(domain.cell_tags.values, tags) | is_all)
                numbers = domain.original_cells[domain.cell_tags.indices[mesh_cells]]
                loads.body_force[numbers + first_cell] += density.at_cells(self, numbers + first_cell)
                continue
            if is_all:
                raise refusal("density", "a load or goal is an integral over all facets", "name a facet set")
            facets = self._facets(
                domain, domain.facet_tags.indices[np.isin(domain.facet_tags.values, tags)], first_cell
            )
            facets = facets[cells.is_outer[facets]]
            moments = density.moments(self, facets)
            loads.moments.reshape(len(cells.facets), -1, d)[facets] += moments


class _Density:
    """Density of a linear form per volume or area, a function of the place and of the outward normal.

    Args:
        integrand: the integrand, UFL, linear in `argument`.
        argument: the form's test function.

    Raises:
        InputError: the form contains derivatives of its argument.
    """

    def __init__(self, integrand: Expr, argument: Expr) -> None:
        expanded = expand_derivatives(integrand)
        derivatives = (node for node in unique_pre_traversal(expanded) if isinstance(node, Derivative))
        if any(argument in traverse_unique_terminals(node) for node in derivatives):
            raise refusal("density", "a goal depends on strains", "give means of displacements on facets or cells")
        self._components = []
        for k in range(argument.ufl_shape[0]):
            unit = ufl.as_vector([float(i == k) for i in range(argument.ufl_shape[0])])
            self._components.append(expand_derivatives(ufl_replace(expanded, {argument: unit})))
        symbols = {node for c in self._components for node in traverse_unique_terminals(c)}
        self._constants = {c: np.asarray(c.value) for part in self._components for c in extract_constants(part)}
        self._places = [node for node in symbols if isinstance(node, ufl.SpatialCoordinate)]
        self._normals = [node for node in symbols if isinstance(node, ufl.FacetNormal)]

    def _values(self, x: Array, n: Array) -> Array:
        """Return the values (..., d) at places `x` (..., d) with normals `n` (..., d)."""
        out = np.empty(x.shape)
        varies = bool(self._places or self._normals)
        for index in np.ndindex(*x.shape[:-1]) if varies else [(0,) * (x.ndim - 1)][: x.size]:
            values = self._constants | dict.fromkeys(self._places, x[index]) | dict.fromkeys(self._normals, n[index])
            try:
                out[index] = [float(evaluate(component, values)) for component in self._components]
            except Exception as error:
                reason = f"the values of a load or goal are not known ({error})"
                raise refusal("density", reason, "give numbers, or polynomials of x") from error
        if not varies and x.size:
            out[:] = out[(0,) * (x.ndim - 1)]
        return out

    def at_cells(self, structure: StructureCells, numbers: IntArray) -> Array:
        """Return the values (k, n, d) at the nodes of k cells.

        Raises:
            InputError: they are no polynomials of a degree below that of displacements.
        """
        cells, corners = structure.cells, structure.corner_points(numbers)
        x, probes = cells.element.points, CELL_PROBES[cells.d]
        vertex = lagrange(cells.cell_type, 1).tabulate(0, np.vstack([x, probes]))[0, :, :, 0]
        values = self._values(vertex @ corners, np.zeros((len(corners), len(vertex), cells.d)))
        linear = np.insert(vertex @ corners, 0, 1.0, axis=2)[:, :, : 1 + (cells.degree - 1) * cells.d]
        fitted = linear @ (np.linalg.pinv(linear) @ values)
        _require_degree(values, fitted, cells.degree - 1, "volume")
        return values[:, : len(x)]

    def moments(self, structure: StructureCells, facets: IntArray) -> Array:
        """Return the moments (k, m, d) on k facets, in the order of `facet_nodes`.

        Raises:
            InputError: the values are no polynomials of the degree of displacements.
        """
        cells = structure.cells
        first, m = cells.facet_cells[facets, 0], cells.facet_nodes.shape[1]
        local = (cells.cell_facets[first] == facets[:, None]).argmax(axis=1)
        corners = structure.corner_points(first)
        out = np.empty((len(facets), m, cells.d))
        mass = mass_matrix(cells.facet_type, cells.degree)
        probes = np.vstack([cells.facet_element.points, FACET_PROBES[cells.d]])
        for facet in range(cells.sign.shape[1]):
            positions = np.flatnonzero(local == facet)
            v = lagrange(cells.cell_type, 1).points[lagrange(cells.cell_type, 1).entity_closure_dofs[-2][facet]]
            vertex = lagrange(cells.cell_type, 1).tabulate(0, v[0] + probes @ (v[1:] - v[0]))[0, :, :, 0]
            areas = cells.areas[facets[positions]]
            normals = cells.area_vectors[first[positions], facet] / areas[:, None]
            x = vertex @ corners[positions]
            values = self._values(x, np.broadcast_to(normals[:, None], x.shape))
            fitted = cells.facet_element.tabulate(0, probes)[0, :, :, 0] @ values[:, :m]
            _require_degree(values, fitted, cells.degree, "area")
            rank = cells.moment_rows[first[positions], facet] - facets[positions, None] * m
            out[positions[:, None], rank] = areas[:, None, None] * (mass @ values[:, :m])
        return out


def _require_degree(values: Array, polynomial: Array, degree: int, where: str) -> None:
    """Raise InputError if values differ from those of a polynomial of a degree; `where` is "volume" or "area"."""
    if np.abs(values - polynomial).max(initial=0.0) > SHAPE_TOLERANCE * np.abs(values).max(initial=0.0):
        reason = f"a load or goal per {where} is no polynomial of degree {degree} in each cell"
        raise refusal("density", reason, "give one that is, or constants")


def _tangent(law: BulkLaw, region: str, n: Array) -> Array:
    """Return the stiffness (6, 6) of a law in Mandel's order (unit: stress); `n` (d,) is the normal of the layer."""
    traits = law.traits
    if law.fields or traits.varies:
        raise refusal("moduli", f"moduli of {region} are functions of the place", "give numbers, or more regions")
    if traits.remembers or traits.rate:
        raise refusal("memory", f"the law of {region} has a memory or a rate", "use LinearElastic")
    if traits.constrained and not isinstance(law, Rubber):
        raise refusal("volume", f"the law of {region} is incompressible", "use Rubber")
    if (C := tangent_at_rest(law, n)) is None:
        raise refusal("moduli", f"the stiffness of {region} is not known", "write a method stiffness(n) in its class")
    if is_isotropic(C):
        lmbda, mu = average_lame(C)
        if lmbda > 2 * MAX_POISSON_RATIO * (lmbda + mu):
            reason = f"{region} has a Poisson ratio above {MAX_POISSON_RATIO}: bounds would be wide"
            raise refusal("volume", reason, "use a smaller one")
    return C


def _check_structure(model: InterfaceModel, layers: LayerSubproblem) -> None:
    """Raise InputError unless all of the structure can be described by straight cells."""
    joint, structure = model.joint, model.structure
    if model.domain.comm.size > 1:
        raise refusal("ranks", "cells are gathered on one rank only", "run on one rank")
    if structure.plane == "axisymmetric" or model.n_components != joint.dim:
        raise refusal(
            "kinematics",
            "bounds exist for plane and 3D elasticity alone",
            "ask for `with_finer_ends`, and solve with finer cells",
        )
    elements = ("Q1", "Q2") if joint.cell_type == "quadrilateral" else ("P1", "P2")
    if joint.cell_type == "hexahedron" or model.element not in elements:
        reason = f"cells are of the type {joint.cell_type}, elements {model.element}"
        raise refusal("cells", reason, "use triangles or tetrahedra with P1 or P2, or quadrilaterals with Q1 or Q2")
    if joint.degree > 1:
        raise refusal("curved", "cells are curved", "make a joint with straight ones (degree 1)")
    if joint.periods or structure.strain is not None or structure.stress is not None:
        raise refusal("periodic", "the joint is a periodic cell", "take a structure with supports")
    if structure.parts or structure.loads:
        reason = "springs, plates or other parts, or forces at points or lines, act on the structure"
        raise refusal("parts", reason, "use supports and tractions on facet sets")
    if model.bonds or {*joint.seams} != {*layers.seams}:
        raise refusal("seams", "not all seams have a layer in the estimate", "estimate all layers, with seam='S'")
