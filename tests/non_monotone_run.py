"""Numbers of non-monotone layers, from marches that may be cut short and resumed."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from forms import LinearElastic, NonMonotone, NonMonotoneUnrelaxed, Tabulated
from geometry import sandwich
from geometry.joint import Joint
from studies.problems import phases_on_s
from thinlayer import Structure, Surface, ThinLayer, march
from thinlayer.discretisation.model import Model

CHI = np.array([[-0.3, 0.5], [0.5, 0.9]])
C = Tabulated([(20.0, 0.03), (50.0, 0.016), (100.0, 0.008)])
HALF, END = 0.6, 1.0


def warmer(x: Any, t: float) -> Any:
    """Temperature: 20 at the left end, growing to the right and in time."""
    return 20 + 35 * x[0] * (1 + t)


HEATED = NonMonotoneUnrelaxed(60.0, 40.0, 1.2, C, CHI, T=warmer)
LAWS = {"relaxed": NonMonotone(60.0, 40.0, 1.2, 0.015, CHI), "heated": HEATED}


@cache
def joint() -> Joint:
    return sandwich(1.0, 0.5, 0.5, 0.125, cell="quadrilateral", structured=True)


def models(law: Any) -> list[Model]:
    """S and the meshed layer between two blocks; the upper side is sheared and pulled, more at its right end."""
    top = {"x": lambda x, t: 0.03 * t, "y": lambda x, t: t * (0.05 * x[0] - 0.01)}
    setup = {"body": LinearElastic.young(100.0, 0.3), "supports": {"BOTTOM": 0.0, "TOP": top}, "element": "Q1"}
    blocks, layer = Structure(joint(), **setup), ThinLayer(law, 0.05, at=1.0)
    return [blocks.interface(layer), blocks.full(layer, cells_through=2)]


def numbers(out: Path, end: float, resume: bool = False) -> dict[str, float]:
    """Of every law and model: norms on S and phases at each time, times and energies of snaps. Collective."""
    found = {}
    for name, law in LAWS.items():
        pair = models(law)
        surface = Surface(pair[0])
        for model in pair:
            case = f"{name} {model.name}"
            history = march(model, [t for t in (HALF, END) if t <= end], out=out / case, resume=resume)
            for k, snap in enumerate(history.snaps):
                found |= {f"{case} snap {k} t": snap.t, f"{case} snap {k} lost": snap.lost}
            for t in (t for t in (HALF, END) if t <= end):
                state, at, row = history.at(t), f"{case} {t}", np.flatnonzero(history.t <= t)[-1]
                x, phase = phases_on_s(state)
                found |= {f"{at} traction": surface.norm(surface.traction(state)), f"{at} phase": float(phase @ x)}
                found |= {f"{at} jump": surface.norm(surface.jump(state)), f"{at} energy": history.table["energy"][row]}
    return found


def half(out: Path) -> dict[str, float]:
    return numbers(out, HALF)
