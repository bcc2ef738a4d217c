"""Mohr-Coulomb layers in models: columns against the law at a point, symmetries, three dimensions, ranks, the studies."""

from __future__ import annotations

import numpy as np
import pytest
import ufl

from forms import LinearElastic, MohrCoulomb, MohrCoulombMonodirectional
from geometry import block
from studies.fig3_mohr_coulomb import R_X, glue_law
from studies.problems import MORTAR_LAW, sheared
from studies.rates import COULOMB, FLOOR, SHEAR_TIMES, fig2_bar, metal_blocks
from tests import closed_forms
from tests.columns_in_time import check_balance, check_same
from tests.own_laws import layer_of
from thinlayer import Structure, Surface, ThinLayer, compare, march, solve
from thinlayer.pointwise.drive import PointHistory, drive

# layers whose thickness tends to zero under the same load, and columns of any height
pytestmark = [pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning"), pytest.mark.few(5)]

BODY = LinearElastic.young(100.0, 0.3)
LMBDA, MU = 60.0, 40.0
FULL = MohrCoulomb(LMBDA, MU, cohesion=0.1, friction_angle=30.0)
LAWS = {
    "psi = 0": FULL,
    # nu = 0.21 < (1 - sin(Omega))/2: s_33 is not between
    "edges": MohrCoulomb(30.0, MU, cohesion=0.02, friction_angle=12.0),
    "psi = 10": MohrCoulomb(LMBDA, MU, cohesion=0.1, friction_angle=30.0, elastic_fraction=0.02, dilatancy_angle=10.0),
    "monodirectional": MohrCoulombMonodirectional(LMBDA, MU, cohesion=0.1, friction_angle=30.0),
    "unilateral": MohrCoulombMonodirectional(LMBDA, MU, 0.1, 30.0, elastic_fraction=0.2, unilateral=True),
}
# jumps (w_T, w_N): pressed, sheared until it yields, unloaded, sheared back, opened beyond the apex, pressed again
PATH = np.array(
    [[0.0, -0.01], [0.03, -0.012], [0.06, -0.012], [0.045, -0.02], [-0.04, -0.01], [-0.04, 0.02], [0.0, -0.02]]
)
PATH_3D = np.array([[0.0, 0.0, -0.01], [0.06, 0.0, -0.012], [0.04, 0.06, -0.012], [-0.04, 0.04, -0.01]])
EXACT = 1e-9  # relative, as in the columns of other laws


def at_a_point(law, jumps) -> PointHistory:
    names = ("w_T", "w_N") if jumps.shape[1] == 2 else ("w_T1", "w_T2", "w_N")
    n = (0.0, 1.0, 0.0)[: jumps.shape[1]]
    return drive(law, [dict(zip(names, map(float, w), strict=True)) for w in jumps], n=n)


def xyz(frame: np.ndarray) -> np.ndarray:
    """Components along x, y(, z) of those in the frame of an S whose normal is y."""
    return frame if frame.shape[1] == 2 else frame[:, [0, 2, 1]]


def column(law, jumps, eps: float, angle: float = 0.0, on_s=None) -> tuple:
    """A block on a layer whose solution is uniform: marches of both models, and what the law does at a point.

    The block's outer faces move as the jumps say and as the block strains under the law's tractions; free is what is
    inside, and S. The elements are linear: the layer's own sides then have no nodes but those on its faces. At the end
    of step k the time is k. The block is turned by an angle about the third axis. The law on S may be another one.
    """
    d = jumps.shape[1]
    point = at_a_point(law, jumps)
    turn = np.eye(d)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    K = closed_forms.elastic_stiffness(BODY.lmbda, BODY.mu, np.eye(d)[1])
    slopes = np.linalg.solve(K, xyz(point.tractions).T).T
    w, slopes = xyz(point.jumps) @ turn.T, slopes @ turn.T

    def component(i):
        def u(x, t):
            height = sum(float(turn[k, 1]) * x[k] for k in range(d))
            hats = [ufl.max_value(0, 1 - abs(t - (k + 1))) for k in range(len(w))]
            parts = zip(hats, w[:, i], slopes[:, i], strict=True)
            return sum(hat * (float(a) + height * float(b)) for hat, a, b in parts)

        return u

    where = block(1.0, 0.5, 0.25, structured=True, depth=0.5 if d == 3 else None).rotated(angle)
    support = {axis: component(i) for i, axis in enumerate("xyz"[:d])}
    sides = ["LEFT", "RIGHT", "TOP"] + ["BACK", "FRONT"] * (d == 3)
    turned = Structure(where, body=BODY, supports=dict.fromkeys(sides, support), element="P1")
    times = [float(k + 1) for k in range(len(w))]
    limit = march(turned.interface(layer_of(on_s or law, eps)), times)
    return limit, march(turned.full(ThinLayer(law, eps, at=1.0), cells_through=1), times), point


def check_jumps(history, surface: Surface, point: PointHistory) -> None:
    """Jumps on S, and tractions at the end, are those at the point at every step."""
    size = np.sqrt(surface.integral(1.0))
    for k, w in enumerate(point.jumps):
        difference = surface.frame(surface.jump(history.at(k + 1.0))) - np.reshape(w, (-1, 1, 1))
        assert surface.norm(difference) < EXACT * np.abs(point.jumps).max() * size, k
    t = surface.frame(surface.traction(history.last)) - np.reshape(point.tractions[-1], (-1, 1, 1))
    assert surface.norm(t) < EXACT * np.abs(point.tractions).max() * size


def check_path(limit, full, point: PointHistory) -> None:
    """Both models agree at every step, and with the law at the point."""
    check_same(limit, full)
    check_jumps(limit, Surface(limit.model), point)


# ---------------------------------------------------------------- columns
@pytest.mark.parametrize(("name", "eps"), zip(LAWS, [0.3, 1e-4, 0.3, 1e-4, 0.3], strict=True))
def test_both_models_follow_the_law_at_a_point(name, eps):
    """The path crosses both limits of the closed form, reaches edges and apex, and comes back."""
    limit, full, point = column(LAWS[name], PATH, eps)
    check_path(limit, full, point)
    for history in (limit, full):
        assert np.abs(history.table["imbalance"]).max() < 1e-9
        assert (history.table["dissipated"] >= -1e-16).all()
    assert limit.table["dissipated"].sum() == pytest.approx(point.energies[:, 1].sum(), rel=1e-9)
    assert (point.energies[:, 1] > 0).sum() >= 3


@pytest.mark.parametrize("name", ["edges", "psi = 10", "monodirectional"])
def test_three_dimensions(name):
    """Shear whose direction turns in S, where no plane of strain is given."""
    limit, full, point = column(LAWS[name], PATH_3D, 0.02, angle=0.3)
    check_path(limit, full, point)
    check_balance(full)
    assert point.energies[-1, 1] > 0


# ---------------------------------------------------------------- problems of the studies
@pytest.mark.long
def test_order_1_and_the_floor_that_coulombs_law_leaves():
    """Blocks that are sheared to and fro: |t_T| <= C - tan(Omega) t_N on S is not the limit."""
    (joint, setup), law, times = sheared(1 / 8), MORTAR_LAW, (0.5, 1.0, 1.5)
    plates, rows = Structure(joint, **setup), {"right": [], "wrong": []}
    for eps in (1 / 64, 1 / 128):
        full = march(plates.full(ThinLayer(law, eps, at=1.0)), times)
        for name, limit in (("right", law), ("wrong", COULOMB)):
            rows[name].append(compare(full, march(plates.interface(ThinLayer(limit, eps, at=1.0)), times)))
    for error, (low, high) in FLOOR.items():
        right, wrong = ([row[f"error_{error}"] for row in rows[name]] for name in rows)
        assert 0.9 < np.log2(right[0] / right[1]) < 1.3  # it comes down to 1
        assert low < wrong[1] < high
        assert wrong[1] > 4 * right[1]


def test_plastic_bodies_dissipate_beside_a_plastic_layer():
    joint, setup = metal_blocks(1 / 8)
    history = march(Structure(joint, **setup).interface(ThinLayer(MORTAR_LAW, 1 / 16, at=1.0)), SHEAR_TIMES[:4])
    total, bodies = (history.table[name].sum() for name in ("dissipated", "dissipated bodies"))
    assert min(bodies, total - bodies) > 0.01 * history.last.audit.total


def test_newton_is_quadratic(capfd):
    """The bar of Fig. 2 without cohesion, all loads in one step: the residual's exponent doubles at the end.

    The shear force on S is that of an independent code.
    """
    joint, setup = fig2_bar((8.0, 4.0, 0.4))
    model = Structure(joint, **setup).interface(ThinLayer(glue_law(0.0), 1.0))
    state = solve(model, options={"snes_monitor": None})
    norms = [float(line.split()[-1]) for line in capfd.readouterr().out.splitlines() if "SNES Function norm" in line]
    assert state.report.iterations <= 7
    surface = Surface(model)
    assert surface.integral(surface.frame(surface.traction(state))[0]) == pytest.approx(R_X, rel=2e-4)
    assert state.report.homotopy_steps == 0
    exponents = np.log10(np.array(norms) / norms[0])
    exponents = exponents[exponents > -9][-3:]  # before rounding
    assert exponents[0] < -1
    assert (exponents[1:] < 1.8 * exponents[:-1]).all()
