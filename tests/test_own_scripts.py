"""Layers in scripts that are not ours: on anybody's DOLFINx mesh with tags, in anybody's SNES, on one rank and on two."""

from __future__ import annotations

import re
from contextlib import redirect_stdout
from functools import cached_property, partial
from io import StringIO

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc
from scipy.optimize import brentq

from forms import (
    ContactLaw,
    HolonomicCoulomb,
    Incompressible,
    LinearElastic,
    Maxwell,
    MohrCoulomb,
    NonMonotoneUnrelaxed,
    Norton,
    Stack,
)
from forms.base import InputError
from forms.work import body, energy, work
from geometry import wall
from geometry.domain import Domain, cell_nodes
from geometry.joint import Joint
from geometry.seam import Seam
from tests.documents import PAGES
from tests.mpirun import CLONE
from tests.network_cases import WALL
from tests.on_ranks import on_ranks
from tests.refused import refused
from thinlayer import BrokenMesh, SolveError, Springs, StepProblem, Structure, ThinLayer, march
from thinlayer.parts.contact_part import ContactPart
from thinlayer.parts.form_part import FormPart
from thinlayer.parts.pressure_part import PressurePart

SCRIPTS = re.findall(r"```{code-cell} python\n(.*?)```", PAGES["thinlayer/docs/tutorials/own_script.md"], re.DOTALL)
STONE = LinearElastic.young(E=100.0, nu=0.3)
CREEP = Maxwell(6.0, 4.0, t1=1.5)
LOWER, UPPER, LAYER, TOP = 1, 2, 3, 4
PLACES = {"BOTTOM": 0.0, "S": 0.5, "TOP": 1.0}
KINDS = {name: mesh.CellType[name] for name in ("triangle", "quadrilateral", "tetrahedron", "hexahedron")}


# ---------------------------------------------------------------- the scripts
TEXTS = {"page": "".join(SCRIPTS)} | {
    name: (CLONE / "tests" / "own_scripts" / f"{name}.py").read_text()
    for name in ("bricks", "two_blocks", "glue_line", "heat")
}


def numbers(text: str) -> list[float]:
    return [float(x) for x in re.findall(r"-?\d+\.\d+", text)]


def printed(name: str) -> str:
    """What a script prints."""
    with redirect_stdout(StringIO()) as out:
        exec(compile(TEXTS[name], name, "exec"), {"__name__": "__main__"})
    return out.getvalue()


def printed_by_all() -> dict[str, str]:
    return {name: printed(name) for name in TEXTS}


@on_ranks(printed_by_all, 2)
@pytest.mark.parametrize("name", ["page", "bricks", "two_blocks"])
def test_script_on_one_rank_and_two(there, name):
    """What it prints is the same, to all digits but the last."""
    serial, parallel = printed(name), there[name]
    assert len(numbers(serial)) >= 1
    assert numbers(serial) == pytest.approx(numbers(parallel), abs=2e-8)
    if name == "two_blocks":  # jumps on S and dissipation as in a march, with nodes that are open, stick and slide
        assert len(serial.splitlines()) == 4
        for text in (serial, parallel):
            mine, march_, my_status, its_status = (line.partition(":")[2].strip() for line in text.splitlines())
            assert numbers(mine) == pytest.approx(numbers(march_), rel=1e-8)
            assert my_status == its_status
            assert min(map(int, my_status.split()[-3:])) > 0


@on_ranks(printed_by_all, 2)
def test_script_of_a_mesh_of_dolfinx(there):
    """S opens by the traction over the stiffness; the text says so."""
    for text in (printed("glue_line"), there["glue_line"]):
        assert float(re.search(r"S opens by (\S+) mm;", text)[1]) == pytest.approx(0.005, rel=1e-7)
        assert float(re.search(r"but for (\S+) of it", text)[1]) < 1e-4


@on_ranks(printed_by_all, 2)
def test_script_of_a_temperature(there):
    """It jumps by flux times eps/k."""
    for text in (printed("heat"), there["heat"]):
        assert numbers(text) == pytest.approx([3.0 * 0.05 / 0.1, 20.0 + 3.0 / 2.0 + 3.0 * 0.05 / 0.1], abs=1e-9)


# ---------------------------------------------------------------- two blocks, as a script makes them
def snes_of(problem: StepProblem) -> PETSc.SNES:
    snes = PETSc.SNES().create(MPI.COMM_WORLD)
    snes.setTolerances(rtol=1e-13, atol=1e-13, max_it=50)
    snes.getKSP().getPC().setType("lu")
    snes.getKSP().getPC().setFactorSolverType("mumps")
    problem.attach(snes)
    return snes


def tagged(grid, dim, value):
    """Tags of cells or facets by their centres (n, 3); -1: none."""
    grid.topology.create_connectivity(dim, grid.topology.dim)
    n = grid.topology.index_map(dim).size_local
    values = value(mesh.compute_midpoints(grid, dim, np.arange(n, dtype=np.int32))).astype(np.int32)
    entities = np.flatnonzero(values >= 0).astype(np.int32)
    return mesh.meshtags(grid, dim, entities, values[entities])


class Blocks:
    """Two blocks of height 1/2 and a layer between them, 2 long."""

    def __init__(self, kind: str, degree: int, upper=UPPER, plane: str = "strain") -> None:
        self.kind, self.d = kind, 3 if kind in ("tetrahedron", "hexahedron") else 2
        ghosts, cell = mesh.GhostMode.shared_facet, KINDS[kind]
        if self.d == 2:
            box = [(0, 0), (2, 1)]
            self.grid = mesh.create_rectangle(MPI.COMM_WORLD, box, (6, 4), cell, ghost_mode=ghosts)
        else:
            box = [(0, 0, 0), (2, 1, 1)]
            self.grid = mesh.create_box(MPI.COMM_WORLD, box, (4, 2, 2), cell, ghost_mode=ghosts)
        self.cells = tagged(self.grid, self.d, lambda x: np.where(x[:, 1] > 0.5, UPPER, LOWER))
        self.facets = tagged(self.grid, self.d - 1, lambda x: np.where(abs(x[:, 1] - 0.5) < 1e-9, LAYER, -1))
        self.broken = BrokenMesh(self.grid, self.cells, self.facets, {LAYER: upper}, plane)
        self.V = self.broken.space(("Lagrange", degree, (self.d,)))
        self.u, self.move = fem.Function(self.V), fem.Constant(self.grid, np.zeros(self.d))
        self.bcs = [
            fem.dirichletbc(value, fem.locate_dofs_geometrical(self.V, lambda x, y=y: np.isclose(x[1], y)), self.V)
            for y, value in ((0, np.zeros(self.d)), (1, self.move))
        ]
        if plane == "axisymmetric":
            axis = mesh.locate_entities_boundary(self.grid, 1, lambda x: np.isclose(x[0], 0))
            sub = self.V.sub(0)
            self.bcs.append(fem.dirichletbc(0.0, fem.locate_dofs_topological(sub, 1, axis), sub))
        self.v = ufl.TestFunction(self.V)
        self.rest = ufl.inner(fem.Constant(self.grid, np.zeros(self.d)), self.v) * ufl.dx
        self.dx = ufl.Measure("dx", domain=self.grid, subdomain_data=self.cells)

    def solve(self, terms, moves, dt, form=None, parts=()) -> StepProblem:
        problem = StepProblem(form or self.rest, self.u, self.bcs, terms, parts)
        snes = snes_of(problem)
        for move in moves:
            self.move.value[:] = move
            problem.begin(dt)
            snes.solve(None, self.u.x.petsc_vec)
            while problem.switch():
                snes.solve(None, self.u.x.petsc_vec)
            problem.accept()
        snes.destroy()
        return problem

    @cached_property
    def joint(self) -> Joint:
        """The same mesh, as a joint."""
        d, grid = self.d, self.grid
        grid.topology.create_connectivity(d - 1, 0)
        x = np.array(grid.geometry.x[:, :d])
        at = lambda y: tagged(grid, d - 1, lambda m: np.where(abs(m[:, 1] - y) > 1e-9, -1, 0)).indices
        facets = lambda y: np.asarray(mesh.entities_to_geometry(grid, d - 1, at(y)), np.int64)
        sets = {name: facets(y) for name, y in PLACES.items()}
        return Joint(
            x, cell_nodes(grid).astype(np.int64), self.kind, self.cells.values - LOWER, ("LOWER", "UPPER"), sets,
            seams={"S": Seam(("LOWER",), ("UPPER",))},
        )  # fmt: skip

    def difference(self, other: fem.Function, original) -> float:
        """Largest difference to a displacement of a model of the joint, over the largest displacement."""

        def of_cells(f):
            V = f.function_space
            dofs = np.asarray(V.dofmap.list)
            values = f.x.array.reshape(-1, self.d)[dofs]
            x = V.tabulate_dof_coordinates()[dofs] @ np.array([1.0, 0.1234, 0.05678])
            return np.take_along_axis(values, np.argsort(x, axis=1)[..., None], axis=1)

        mine, its = of_cells(self.u)[original], of_cells(other)
        return float(np.abs(mine - its).max() / np.abs(its).max())


MOVES = {
    "Mohr-Coulomb": (MohrCoulomb(60.0, 40.0, cohesion=0.2, friction_angle=30.0, elastic_fraction=0.02), 0.01),
    "Norton": (Norton(lmbda=3.0, mu=2.0, eta=5.0, p=2.5), 0.02),
    "two sublayers": (Stack((0.3, Maxwell(6.0, 4.0, t1=1.5, t2=2.0)), (0.7, LinearElastic(3.0, 2.0))), 0.02),
    "functions, order 1": (LinearElastic(lambda x: 6 + 3 * x[0], lambda x: 4 - x[0] ** 2 / 2), 0.02),
    "sublayers, order 1": (Stack((0.3, LinearElastic(6.0, 1.0)), (0.7, LinearElastic(3.0, 2.0))), 0.02),
}


MODELS = [
    ("triangle", "Mohr-Coulomb", "strain"),
    ("quadrilateral", "functions, order 1", "strain"),
    ("quadrilateral", "sublayers, order 1", "axisymmetric"),
    ("tetrahedron", "Norton", "strain"),
    ("hexahedron", "Mohr-Coulomb", "strain"),
    ("triangle", "two sublayers", "stress"),
]


@pytest.mark.parametrize(("kind", "name", "plane"), MODELS)
def test_same_as_a_model(kind, name, plane):
    """The same mesh, bodies, layer and steps, as a Model and in a script: displacements and energies."""
    law, eps = MOVES[name]
    layer = ThinLayer(law, eps, order=int("order 1" in name), edges="plain", at=1.0)
    degree = 2 if kind != "hexahedron" else 1
    blocks = Blocks(kind, degree, plane=plane)
    kinematics, along = blocks.broken.kinematics, 0.0 if plane == "axisymmetric" else 0.004
    moves = [np.array([along * k, -0.001 * k, 0.002 * k][: blocks.d]) for k in (1, 2, 3)]
    rule = {"quadrature_degree": 2 * degree + ("quad" in kind) * 2}
    dx = blocks.dx if plane == "strain" else blocks.dx(metadata=rule)
    terms = [body(kinematics.law(STONE), dx, kinematics), *blocks.broken.layer(LAYER, layer)]
    problem = blocks.solve(terms, moves, 0.5)
    top = dict(zip("xyz", [lambda x, t, k=k: 2 * t * moves[0][k] for k in range(blocks.d)], strict=False))
    element = f"{'PQ'[kind[0] in 'hq']}{degree}"
    structure = Structure(blocks.joint, plane=plane, body=STONE, supports={"BOTTOM": 0.0, "TOP": top}, element=element)
    model = structure.interface(layer)
    history = march(model, [0.5, 1.0, 1.5])
    assert blocks.difference(history.last.u, model.domain.original_cells) < 1e-8
    if problem.compiled:
        assert sum(problem.energies.values())[1] == pytest.approx(np.sum(history.table["dissipated"]), rel=1e-8)


# ---------------------------------------------------------------- closed forms
@pytest.mark.parametrize("kind", ["triangle", "hexahedron"])
def test_hyperelastic_column(kind):
    """Blocks that are pressed between rollers: one equation, neo-Hooke's stress = stiffness of the layer times its jump."""
    blocks = Blocks(kind, 1)
    d, u, v = blocks.d, blocks.u, blocks.v
    F = ufl.Identity(d) + ufl.grad(u)
    psi = 50 * (ufl.tr(F.T * F) - d - 2 * ufl.ln(ufl.det(F))) + 75 * ufl.ln(ufl.det(F)) ** 2
    for axis in (0, 2)[: d - 1]:
        for place in (0, [2, 1, 1][axis]):
            sub = blocks.V.sub(axis)
            at = mesh.locate_entities_boundary(blocks.grid, d - 1, lambda x, a=axis, p=place: np.isclose(x[a], p))
            blocks.bcs.append(fem.dirichletbc(0.0, fem.locate_dofs_topological(sub, d - 1, at), sub))
    terms = blocks.broken.layer(LAYER, ThinLayer(LinearElastic(60.0, 40.0), 0.01, at=1.0))
    blocks.solve(terms, [np.array([0.0, -0.2, 0.0][:d])], 0.0, ufl.derivative(psi * ufl.dx, u, v))

    def stress(s):
        return 100 * ((1 + s) - 1 / (1 + s)) + 150 * np.log(1 + s) / (1 + s)

    s = brentq(lambda s: stress(s) - 140.0 * (-0.2 - s), -0.5, 0.0, xtol=1e-15)
    jump = blocks.broken.interface(LAYER).jump(u)[1]
    assert fem.assemble_scalar(fem.form(jump * blocks.broken.dS(LAYER))) / 2 == pytest.approx(-0.2 - s, rel=1e-10)


def test_wall_in_running_bond():
    """14 elastic bricks, 2 laws, T-junctions: the energy that a program with another numbering of unknowns found."""
    domain = Domain.of(wall(3, 4, (1.0, 0.5), 0.25, cell="triangle"))
    grid, pieces = domain.mesh, domain.to_local(domain.joint.split_mesh.pieces).astype(np.int32)
    bricks = mesh.meshtags(grid, 2, np.arange(len(pieces), dtype=np.int32), pieces)
    (bed,), (head,) = domain.values("BED"), domain.values("HEAD")
    for rule in ({head: (-1, 0), bed: (0, 1)}, (bed, head)):
        broken = BrokenMesh(grid, bricks, domain.facet_tags, rule)
        V = broken.space(("Lagrange", 2, (2,)))
        assert V.dofmap.index_map.size_global == 550
        u = fem.Function(V)
        terms = [body(LinearElastic.young(20.0, 0.2), ufl.Measure("dx", domain=grid))]
        terms += broken.layer(bed, ThinLayer(LinearElastic(0.8, 2.1), 0.1, at=1.0))
        terms += broken.layer(head, ThinLayer(LinearElastic(0.4, 1.3), 0.2, at=1.0))
        ends = [fem.locate_dofs_geometrical(V, lambda x, y=y: np.isclose(x[1], y)) for y in (0, 2)]
        bcs = [fem.dirichletbc(np.array(w), dofs, V) for w, dofs in zip([(0.0, 0.0), (0.1, -0.05)], ends, strict=True)]
        problem = StepProblem(work(terms[:1], u, ufl.TestFunction(V)), u, bcs, terms[1:])
        snes_of(problem).solve(None, u.x.petsc_vec)
        problem.accept()
        assert fem.assemble_scalar(fem.form(energy(terms, u))) == pytest.approx(WALL["P2"], rel=1e-11)


def test_phases_without_a_joint():
    """Columns are facets of S: all switch at once under a uniform push beyond the fall, none before."""
    law = NonMonotoneUnrelaxed(0.0, 10.0, alpha=1.5, transformation_energy=0.15, chi=[[0, 0], [0, 1]]).scaled(1 / 0.1)
    for push, share in ((0.05, 0.0), (0.2, 1.0)):
        blocks = Blocks("triangle", 1)
        terms = blocks.broken.layer(LAYER, ThinLayer(law, 0.1, at=1.0))
        terms = [body(LinearElastic.young(1e6, 0.0), blocks.dx), *terms]
        problem = blocks.solve(terms, [np.array([0.0, -push * 0.1])], 1.0)
        term, memory = problem.compiled["layer"], problem.state.memory["layer"]
        phase = memory[:, list(law.internal).index("phase")]
        assert term.columns.n_columns == 6
        assert np.abs(phase) == pytest.approx(share)


# ---------------------------------------------------------------- what is refused
def test_refused_tags():
    blocks = Blocks("triangle", 1)
    grid, cells, facets = blocks.grid, blocks.cells, blocks.facets
    mixed = tagged(grid, 1, lambda x: np.where((abs(x[:, 1] - 0.5) < 1e-9) | (x[:, 1] < 1e-9), LAYER, -1))
    uniform = tagged(grid, 2, lambda x: 0 * x[:, 0])
    some = tagged(grid, 2, lambda x: np.where(x[:, 0] > 1, UPPER, -1))
    for bodies, tags, S, message in [
        (some, facets, LAYER, "24 cells have no tag"),
        (uniform, facets, LAYER, r"6 facets of S lie inside a body.*\(.*, 0.5\)"),
        (cells, mixed, LAYER, "6 of 12 facets with tag 3 lie on the boundary"),
        (cells, facets, {LAYER: {LOWER, UPPER}}, "the same body on both sides"),
    ]:
        refused(InputError, message, BrokenMesh, grid, bodies, tags, S)
    refused(InputError, "S has no tag 9; give a tag of S: 3", lambda: blocks.broken.interface(9))


def test_refused_layers_parts_and_steps():
    blocks, quadratic = Blocks("triangle", 1), Blocks("triangle", 2)
    V, rest, law = quadratic.V, quadratic.rest, LinearElastic(6.0, 4.0)
    thin = partial(ThinLayer, eps=0.1, at=1.0)
    for layer, message in [
        (thin(Incompressible(mu=1.0)), "pressure of its own"),
        (thin(law, order=1, edges="free"), "edges='free' of a layer on a mesh of one's own"),
        (thin(law, eigenstrain=1e-3), "eigenstrain=... of a layer on a mesh of one's own"),
        (thin(law, order=1, profile=lambda x: 1 + x[0]), "a thickness that varies needs bodies at their true places"),
        (thin(Maxwell(52.0, 4.0, t1=1.5), order=1), "order=1 of Maxwell with lmbda/mu = 13"),
        (HolonomicCoulomb(K_N=1.0, K_T=1.0, friction=0.3), "a ContactLaw is for ContactPart"),
    ]:
        refused(InputError, message, blocks.broken.layer, LAYER, layer)
    contact = blocks.broken.contact_surface(LAYER, blocks.V)
    refused(InputError, "no threshold", ContactPart, ContactLaw(1.0, 1.0), contact)
    cubic = quadratic.broken.space(("Lagrange", 3, (2,)))
    refused(InputError, "contact laws act at nodes", quadratic.broken.contact_surface, LAYER, cubic)
    (term,) = quadratic.broken.layer(LAYER, thin(law))
    springs = FormPart("springs", quadratic.u, F=ufl.inner(quadratic.u, quadratic.v) * ufl.ds)
    elsewhere = fem.functionspace(quadratic.grid, ("Lagrange", 1, (2,)))
    away = fem.dirichletbc(np.zeros(2), np.array([0], np.int32), elsewhere)
    for form, bcs, terms, parts, message in [
        (rest, (), [], [PressurePart(V, term, 1.0)], "'pressure' has unknowns of its own"),
        (rest, (), [], [springs, springs], "two parts are called 'springs'"),
        (rest, (), [], [Springs("TOP", normal=1.0)], "allowed: what derives from"),
        (rest, [away], [], [], "of another space than u"),
        (rest + ufl.inner(quadratic.u, quadratic.u) * ufl.dx, (), [], [], "linear in one test function"),
        (rest, (), [body(CREEP, ufl.Measure("dx", domain=quadratic.grid)(1))], [], r"dx\(1\) has no tags"),
    ]:
        refused(InputError, message, StepProblem, form, quadratic.u, bcs, terms, parts)
    u = fem.Function(elsewhere)
    with pytest.raises(InputError, match="do not jump across S"):
        StepProblem(ufl.inner(u, ufl.TestFunction(elsewhere)) * ufl.dx, u, (), [term])
    creeping = [body(STONE, quadratic.dx), *quadratic.broken.layer(LAYER, thin(CREEP))]
    problem = StepProblem(rest, quadratic.u, quadratic.bcs, creeping)
    refused(InputError, "no step has begun", lambda: problem.accept())
    refused(InputError, "allowed: >= 0", lambda: problem.begin(-1.0))
    problem.begin(0.0)
    quadratic.move.value[:] = (0.1, 0.0)
    refused(SolveError, "of the forces of loads and stresses is out of balance", lambda: problem.accept())
    quadratic.move.value[:] = (1e-4, 0.0)  # a residual below 1 in the user's units
    refused(SolveError, "of the forces of loads and stresses is out of balance", lambda: problem.accept())


def test_upper_side_changes_signs_alone():
    blocks = [Blocks("triangle", 2, upper) for upper in (UPPER, {LOWER}, (0, -1), None)]
    for block in blocks:
        terms = [body(STONE, block.dx), *block.broken.layer(LAYER, ThinLayer(LinearElastic(6.0, 4.0), 0.1, at=1.0))]
        block.solve(terms, [np.array([0.1, -0.05])], 0.0)
    jumps = [block.broken.interface(LAYER).jump(block.u)[0] * block.broken.dS(LAYER) for block in blocks]
    slips = [fem.assemble_scalar(fem.form(jump)) for jump in jumps]
    assert slips[0] * np.array([1, -1, -1, 1]) == pytest.approx(slips, rel=1e-12)
    assert slips[0] > 0
