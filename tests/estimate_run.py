"""Structures of which errors are estimated."""

from __future__ import annotations

from functools import cache

from forms import LinearElastic
from geometry import block, sandwich
from thinlayer import RigidPlate, Structure, Surface, ThinLayer, estimate, goals, solve
from thinlayer.estimating.result import Estimate

LOWER, UPPER = LinearElastic.young(E=70.0, nu=0.2), LinearElastic.young(E=110.0, nu=0.31)
GLUE, SOFT = LinearElastic.shear(3.0, 0.35), LinearElastic.shear(1.1, 0.485)
LOADS = {2: (0.3, -1.0), 3: (0.3, -1.0, 0.2)}
EPS = 0.05
KINDS = ("between", "rubber", "base", "moved", "plate", "inclined", "heated", "bonded")


def structure(kind: str, dim: int = 2) -> Structure:
    """A structure of a kind, none of whose numbers are alike."""
    sizes = {} if dim == 2 else {"depth": 0.7}
    load = LOADS[dim]
    if kind == "base":
        return Structure(block(1.3, 0.4, 0.3, h_ends=0.15, **sizes), body=UPPER, supports={}, tractions={"TOP": load})
    joint = sandwich(1.3, 0.3, 0.4, 0.3, h_ends=0.05 if kind == "rubber" else 0.15, **sizes)
    given = {"body": {"LOWER": LOWER, "UPPER": UPPER}, "supports": {"BOTTOM": 0}, "tractions": {"TOP": load}}
    if kind == "moved":
        given["supports"] = {"BOTTOM": 0, "TOP": {"y": -0.013, "x": lambda x, t: 0.004 * x[0]}}
        given["tractions"] = {"LEFT/UPPER": load}
    if kind == "plate":
        given["parts"] = [RigidPlate("TOP", force=(0.7, -0.4), moment=0.3)]
        given["tractions"] = {"RIGHT/UPPER": load}
    if kind == "inclined":
        return Structure(joint.rotated(0.3), body=LOWER, supports={"BOTTOM": {"n": 0.01}, "LEFT/LOWER": {"x": 0}},
                         tractions={"TOP": load})  # fmt: skip
    if kind == "heated":
        given["eigenstrain"] = {"UPPER": 0.002}
    return Structure(joint, **given)


def chosen(kind: str, dim: int = 2) -> list[goals.Goal]:
    """Goals of all kinds that a structure has."""
    load = LOADS[dim]
    place = "TOP" if kind == "moved" else "BOTTOM"
    found = [goals.Compliance()]
    found += [goals.MeanTraction(load), goals.Functional("mean of u_y", lambda u, model: u[1] * model.dx)]
    found.append(goals.Displacement((0.41, 0.17, 0.2)[:dim] if kind != "inclined" else (0.35, 0.25), load))
    if kind != "base":
        found.append(goals.Reaction(place, load))
    return found


@cache
def estimated(kind: str, dim: int = 2):
    """The estimate of a kind of structure."""
    layer, made = ThinLayer(SOFT if kind == "rubber" else GLUE, EPS, at=1.0), structure(kind, dim)
    if kind == "bonded":
        return estimate(solve(made.bonded()), layer, goals=chosen(kind, dim))
    return estimate(solve(made.interface(layer)), goals=chosen(kind, dim))


def total(found: Estimate, goal: str) -> float:
    """The integral of the density of a goal."""
    return float(Surface(found.better.model).integral(found.density(goal)))


def numbers(kind: str, dim: int = 2) -> dict[str, float]:
    """Errors, changes of goals and the totals of their densities."""
    found = estimated(kind, dim)
    out = {"traction": found.traction, "jump": found.jump}
    for name, goal in found.goals.items():
        square = Surface(found.better.model).norm(found.density(name))
        out |= {name: goal.change, f"total {name}": total(found, name), f"square {name}": square}
    return {f"{kind} {dim}D {name}": value for name, value in out.items()}


def several() -> dict[str, float]:
    """Numbers of several structures."""
    return numbers("between") | numbers("rubber") | numbers("base") | numbers("between", 3) | numbers("plate")
