"""Contact problems whose reports must not depend on the number of ranks."""

from __future__ import annotations

from pathlib import Path

from forms import HolonomicCoulomb, IncrementalCoulomb, LinearElastic
from geometry import block, sandwich
from studies.problems import sliding_bar
from tests.contact_bars import contact, coulomb, stacked
from tests.on_ranks import alone
from thinlayer import Structure, Surface, march, piecewise, solve


def to_and_fro(folder=None, last=4.0, method=None):
    joint = block(3.0, 1.0, 0.25, structured=True)
    law = IncrementalCoulomb(300.0, 80.0, 0.4)
    supports = {"TOP": {"x": piecewise({0: 0.0, 2: 0.06, 4: -0.06}), "y": -0.02}}
    model = Structure(joint, body=LinearElastic.young(400.0, 0.3), supports=supports, element="P1").interface(law)
    times = [0.5 * k for k in range(1, round(2 * last) + 1)]
    return march(model, times, out=folder, resume=folder is not None, method=method)


def reports():
    states = {}
    joint, setup = sliding_bar(31)
    for method in (None, "newton", "multigrid"):
        model = Structure(joint, **setup).interface(HolonomicCoulomb.of_layer(15e8, 5e8, friction=1.0))
        states[f"bar {method}"] = solve(model, method=method)
    joint, setup = sliding_bar(6, depth=True)
    model = Structure(joint, **setup).interface(HolonomicCoulomb.of_layer(15e4, 5e4, friction=0.7))
    states["cube"] = solve(model)
    joint = sandwich(6, 3, 2, 1.0, depth=4.0)
    bodies = {"LOWER": LinearElastic.young(5e3, 0.3), "UPPER": LinearElastic.young(9e3, 0.2)}
    loads = {"TOP": lambda x, t: (8.0, 6 - 6 * x[0], 2.0)}
    data = {"body": bodies, "supports": {"BOTTOM": 0.0}, "tractions": loads, "element": "P1"}
    model = Structure(joint, **data).interface(HolonomicCoulomb(7e4, 2e4, 0.9, 1.0))
    states["two bodies"] = solve(model)
    joint, setup = stacked("triangle")
    states["degree 2"] = solve(Structure(joint, **setup | {"element": "P2"}).interface(coulomb("middle")))
    states["to and fro"] = to_and_fro().last
    return {name: Surface(state.model).contact(state) for name, state in states.items()}


def contents() -> dict[str, dict]:
    return {name: content(report) for name, report in reports().items()}


def resumed(folder: Path) -> dict[str, list]:
    """Of a march that one rank stops while its block slides forth, and two ranks end."""
    alone(lambda: to_and_fro(folder / "march", 2.5))
    return content(contact(to_and_fro(folder / "march").last))


def content(report):
    arrays = {"u_T": report.u_T, "u_N": report.u_N, "p": report.p, "t_T": report.t_T}
    entries = {"status": report.status.tolist(), "clapeyron": report.clapeyron}
    return entries | {name: array.ravel().tolist() for name, array in arrays.items()}
