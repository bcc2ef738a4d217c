"""Results of scalar fields: names, files, pictures, points, estimates, derivatives, fits, warnings, refusals."""

from contextlib import nullcontext

import numpy as np
import pytest
import ufl

from forms import AnisotropicConduction, Conduction, Heat, LinearElastic
from geometry import sandwich
from tests.refused import refused
from thinlayer import (
    Film,
    InputError,
    Measurement,
    Probe,
    QuadraticCriterion,
    RangeWarning,
    Structure,
    Surface,
    ThinLayer,
    Zoom,
    compare,
    derivative,
    estimate,
    fields,
    fit,
    goals,
    homogenised_stiffness,
    march,
    plotting,
    read_measurements,
    sensitivity,
    solve,
    strength,
    sweep,
    thin_enough,
)

JOINT = sandwich(1, 0.4, 0.6, h=0.25, cell="quadrilateral")
DATA = {"k_lower": 2.0, "k_upper": 0.5, "k": 0.05, "eps": 0.05, "flux": 1.0, "Q": 0.3, "h": 0.7, "T_f": 2.0, "T_0": 1.0}
GOALS = [goals.Compliance(), goals.PointValue((0.6, 0.6)), goals.Inflow("BOTTOM"), goals.MeanFlux()]


def _plates(body=None, *, rate=False, **data):
    """A film below, supports on the right, a flux into the top, a source in the layer."""
    d = DATA | data
    k = {name: d[f"k_{name.lower()}"] for name in JOINT.bodies}
    return Structure(
        JOINT,
        body={name: Heat(k[name], 1.0) if rate else Conduction(k[name]) for name in k},
        supports={"RIGHT": d["T_0"]},
        fluxes={"TOP": d["flux"]},
        sources={"S": d["Q"]},
        parts=[Film("BOTTOM", d["h"], d["T_f"])],
        initial=0.5 if rate else None,
    )


def _interface(order=1, **data):
    d = DATA | data
    return _plates(**data).interface(ThinLayer(Conduction(d["k"]), d["eps"], order=order))


def _column(load=0.0, layer=None, **data):
    structure = Structure(JOINT, **{"body": Conduction(1.0), "supports": {"BOTTOM": 0}, "fluxes": {"TOP": load}} | data)
    return solve(structure.interface(layer or ThinLayer(Conduction(0.1), 0.05)))


# ---------------------------------------------------------------- names, files, pictures
def test_columns_and_sentences_speak_of_fluxes():
    def run(eps):
        layer = ThinLayer(Conduction(0.05), eps)
        return compare(solve(_plates().full(layer)), solve(_plates().interface(layer)))

    table = sweep(run, [0.1, 0.05])
    assert table.columns[:5] == ["eps", "error_flux", "error_jump", "order_flux", "order_jump"]
    labels = [line.get_label() for line in plotting.rates(table).axes[0].lines]
    assert labels[:2] == ["flux", "jump"]
    result = estimate(solve(_interface(order=0)), goals=GOALS)
    assert "% in flux" in str(result)
    assert [row["quantity"] for row in result.table][:2] == ["flux", "jump"]
    assert [*result.goals] == ["compliance", "value at (0.6, 0.6)", "inflow BOTTOM", "mean flux"]
    refused(InputError, "a scalar field has none", lambda: estimate(result.state, goals=goals.Reaction("RIGHT", (1,))))
    refused(
        InputError,
        "allowed: flux, jump",
        lambda: thin_enough(_plates(), ThinLayer(Conduction(1), 0.1), 0.1, "traction"),
    )


def test_files_have_values_and_fluxes(tmp_path):
    import pyvista

    state = solve(_interface())
    fields.write(state, tmp_path / "run.pvd")
    blocks = pyvista.read(tmp_path / "run_pvd" / "0000.vtm")
    assert {*blocks["bodies"].point_data.keys()} == {"T"}
    assert {*blocks["bodies"].cell_data.keys()} == {"flux", "region"}
    assert {*blocks["S"].point_data.keys()} == {"flux", "jump", "normal", "T", "T_lower", "T_upper"}
    upper, lower = (blocks["S"].point_data[f"T_{side}"] for side in ("upper", "lower"))
    assert blocks["S"].point_data["jump"] == pytest.approx(upper - lower)
    assert blocks["bodies"].point_data["T"].max() == pytest.approx(state.u.x.array.max())


def test_pictures_show_values_on_undeformed_bodies():
    state = solve(_interface())
    axes, bar = plotting.field(state, plotting.View(unit="K")).axes
    assert bar.get_xlabel() == "T (K)"
    assert axes.dataLim.height == pytest.approx(1.0, abs=0.01)
    assert [row.get_ylabel() for row in plotting.along(Surface(state.model), state, unit="K").axes] == [
        "flux",
        "jump (K)",
    ]
    refused(InputError, "a scalar field has none", lambda: plotting.field(state, plotting.View("x")))


# ---------------------------------------------------------------- points
def test_values_at_points_and_inside_a_layer_with_a_source():
    """Of a column supports at both ends: the source d leaves by both, and the layer's middle is d eps/(8 k) hotter."""
    Q, k, eps = 3.0, 0.1, 0.05
    state = _column(
        layer=ThinLayer(Conduction(k), eps), sources={"S": Q}, supports={"BOTTOM": 0, "TOP": 0}, fluxes=None
    )
    lower = (
        Q * eps * (0.6 + eps / k / 2) / (1.0 + eps / k)
    )  # flux into the lower body: by the resistances on both sides
    probe, zoom = Probe(state), Zoom(state)
    assert probe.value([(0.3, -0.2), (0.3, 0.3)]) == pytest.approx([lower * 0.2, (Q * eps - lower) * 0.3])
    assert probe.value((0.3, 0.0), side="lower") == pytest.approx(lower * 0.4)
    assert probe.flux((0.3, -0.2)) == pytest.approx([0, lower, 0], abs=1e-12)
    heights, values = zoom.through((0.5, 0.0), 5)
    faces = lower * 0.4, (Q * eps - lower) * 0.6
    linear = np.interp(heights, (-0.5, 0.5), faces)
    assert values == pytest.approx(linear + Q * eps**2 / (2 * k) * (0.25 - heights**2), rel=1e-9)
    assert zoom.flux((0.5, 0.0), -0.5)[1] == pytest.approx(lower)


def test_what_is_of_displacements_is_refused_by_name():
    state = solve(_interface())
    probe, zoom = Probe(state), Zoom(state)
    for call, words in (
        (lambda: probe.stress((0.3, 0.3)), "stress is for laws of a displacement; .*take flux"),
        (lambda: probe.displacement((0.3, 0.3)), "take value"),
        (lambda: zoom.stress((0.3, 0.0)), "take flux"),
        (lambda: zoom.corners, "corners: a strength is for laws of a displacement"),
        (lambda: strength(state, QuadraticCriterion(1, 1)), "strength is for"),
        (lambda: plotting.zoomed(zoom), "zoomed is for"),
    ):
        refused(InputError, words, call)
    mechanical = solve(Structure(JOINT, body=LinearElastic(1, 1), supports={"BOTTOM": 0}).bonded())
    for call, words in (
        (lambda: Surface(mechanical.model).flux(mechanical), "flux is for laws of a scalar field; .* take traction"),
        (lambda: Probe(mechanical).value((0.3, 0.3)), "take displacement"),
        (lambda: goals.PointValue((0.3, 0.3)).check(mechanical.model), "give 2 numbers"),
    ):
        refused(InputError, words, call)


# ---------------------------------------------------------------- derivatives, estimates
def test_derivatives_by_all_data():
    """Values are linear in all loads, and stay as they are if all conductivities and flows grow alike."""
    state = solve(_interface(order=0))
    change = sensitivity(state)
    flows, supports = {"flux TOP", "source S"}, {"film BOTTOM.T", "support RIGHT T"}
    conductivities = {"LOWER.k", "UPPER.k", "S.k", "film BOTTOM.h"}
    for goal, degree in zip(GOALS[1:], (0, 1, 1), strict=True):
        by, value = change.of(goal), goal.value_in(state)
        assert {*by} == {*flows, *supports, *conductivities, "S.eps"}
        assert sum(by[name] for name in flows | supports) == pytest.approx(value)
        assert sum(by[name] for name in flows | conductivities) == pytest.approx(degree * value, abs=1e-8)
        assert by["S.eps"] == pytest.approx(by["source S"] - by["S.k"])
    for name, key in (("film BOTTOM.h", "h"), ("UPPER.k", "k_upper")):
        ends = [solve(_interface(order=0, **{key: DATA[key] * (1 + sign * 1e-3)})) for sign in (1, -1)]
        for goal in GOALS:
            difference = (goal.value_in(ends[0]) - goal.value_in(ends[1])) / 2e-3
            assert change.of(goal)[name] == pytest.approx(difference, rel=1e-5), (name, goal.name)
    assert derivative(state, GOALS[2], ["S.k"]).by["S.k"] == pytest.approx(change.of(GOALS[2])["S.k"])


def test_derivatives_at_the_end_of_a_march():
    def value(sign=0):
        d = DATA | {"k": DATA["k"] * (1 + sign * 1e-3)}
        history = march(_plates(rate=True, **d).interface(ThinLayer(Heat(d["k"], 0.8), d["eps"])), [0.1, 0.2])
        return history if not sign else GOALS[2].value_in(history.last)

    assert derivative(value(), GOALS[2], ["S.k"]).by["S.k"] == pytest.approx((value(1) - value(-1)) / 2e-3, rel=1e-5)


@pytest.mark.filterwarnings("ignore:.*order 0 leaves out:thinlayer.errors.RangeWarning")
@pytest.mark.parametrize(("k", "bonded"), [(0.01, True), (5.0, False)])
def test_bounds_hold_of_the_structure_with_its_layer_meshed(k, bonded):
    layer, structure = ThinLayer(Conduction(k), 0.1, order=0), _plates()
    state = solve(structure.bonded() if bonded else structure.interface(layer))
    result = estimate(state, layer if bonded else None, goals=GOALS)
    meshed = solve(structure.full(layer, cells_through=4))
    for goal in GOALS:
        error, true = result.goals[goal.name], goal.value(meshed, result.better.model)
        rounding = 1e-9 * error.scale
        assert error.lower - rounding <= true <= error.upper + rounding, goal.name
        assert error.better == pytest.approx(true, rel=1e-4), goal.name


def test_a_fit_finds_a_conductivity(tmp_path):
    path, model = tmp_path / "data.csv", _interface(k=0.08)
    state = solve(model)
    values = [goal.value_in(state) for goal in GOALS[1:]]
    rows = zip(("value,0.6 0.6", "inflow,BOTTOM", "flux,"), values, strict=True)
    path.write_text("\n".join(["quantity,place,value,deviation", *(f"{row},{value!r},0.01" for row, value in rows)]))
    measurements = read_measurements(path)
    assert [m.goal.name for m in measurements] == [goal.name for goal in GOALS[1:]]
    assert isinstance(measurements[0], Measurement)
    assert fit(_interface(), measurements, ["S.k"]).values["S.k"] == pytest.approx(0.08)


# ---------------------------------------------------------------- ranges
COSINE, HELD = (lambda x, t: ufl.cos(ufl.pi * x[0])), {"LEFT/LOWER": 0, "LEFT/UPPER": 1}
FOIL = AnisotropicConduction.layered(along=100.0, across=0.1)


@pytest.mark.parametrize(
    ("words", "layer", "data"),
    [
        ("more than delta = 0.456, .* along S with errors .*use order=2", ThinLayer(FOIL, 0.05), {}),
        ("order 0 leaves out the flux along the layer.*use order=1", ThinLayer(Conduction(30), 0.1, order=0), {}),
        (r"insulated at \(0, 0\), between bodies", ThinLayer(Conduction(3.0), 0.05), {"supports": HELD}),
        ("", ThinLayer(FOIL, 0.02, order=2), {}),
        ("", ThinLayer(Conduction(0.3), 0.05), {"supports": HELD}),
        ("", ThinLayer(Conduction(30), 0.05), {}),
        ("", ThinLayer(Conduction(0.01), 0.05, order=0), {"element": "Q1"}),
    ],
)
def test_warnings_where_a_law_leaves_its_range(words, layer, data, recwarn):
    """With a number and a remedy; none of those of displacements."""
    if words:
        with pytest.warns(RangeWarning, match=words):
            _column(COSINE, layer, **data)
    else:
        _column(COSINE, layer, **data)
        assert [str(warning.message) for warning in recwarn if warning.category is RangeWarning] == []


def test_steps_that_are_short_beside_the_time_of_a_layer():
    """Order 2 lacks a mode with a quarter of the time; at order 1 its mean through the layer is wrong by 5 %."""
    structure = Structure(JOINT, body=Heat(1, 1), supports={"BOTTOM": 0}, fluxes={"TOP": 1}, initial=20)
    law, means = Heat(1 / 16, 16), []
    models = [structure.full(ThinLayer(law, 1 / 16))]
    models += [structure.interface(ThinLayer(law, 1 / 16, order=order)) for order in (1, 2)]
    for model, words in zip(models, ("", "layer in 0.101, longer than a step, 0.05.*use order=2", ""), strict=True):
        with pytest.warns(RangeWarning, match=words) if words else nullcontext():
            means.append(Surface(model).displacements(march(model, [0.05, 0.1]).last).mean())
    assert [abs(mean / means[0] - 1) > 2e-3 for mean in means[1:]] == [True, False]
    with pytest.warns(RangeWarning, match="in 0.0253, longer than a step, 0.02.*; mesh the layer"):
        march(models[2], [0.02])


def test_a_periodic_cell_has_no_stiffness():
    refused(InputError, "periodic joint", lambda: homogenised_stiffness(_interface()))
