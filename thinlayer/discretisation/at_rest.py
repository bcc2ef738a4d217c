"""A layer's law at rest: its tangents, whether it is stable, and which tractions are zero where nothing jumps."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from forms.kinematics import MANDEL, ROOT2
from forms.law import BulkLaw
from forms.tangent import (
    Array,
    average_lame,
    is_checked_at_rest,
    known_at_rest,
    require_stable,
    tangent_over,
)
from thinlayer.errors import Refused


class AtRest:
    """The law of a layer, or those of its sublayers, under small strains from rest.

    Args:
        law: law of the layer, with real parameters.
        n: mean normal of S, (d,).

    Attributes:
        sublayers: (share of the thickness, law, tangent at rest) of each sublayer, or of the layer if it has none. The
            tangent is (6, 6), or None if it is not known.
    """

    def __init__(self, law: BulkLaw, n: Array) -> None:
        self.law, self.n = law, n
        self.sublayers = [(share, one, known_at_rest(one, n)) for share, one in law.sublayers]

    def over(self, dt: float) -> list[Array | None]:
        """Tangents of the sublayers under loads that have lasted dt > 0; None: it is not known, or that at rest."""
        if dt not in self._over:
            self._over[dt] = [
                tangent_over(law, self.n, dt) if law.traits.compiled else None for _, law, _ in self.sublayers
            ]
        return self._over[dt]

    @cached_property
    def _over(self) -> dict[float, list[Array | None]]:
        return {}

    def through(self, y: Array) -> tuple[Array, Array]:
        """Phi_N and Phi_T at heights -1/2 <= y <= 1/2: displacements <u> + Phi [u] of sublayers in series.

        Linear where a tangent is not known.
        """
        n = np.pad(self.n, (0, 3 - len(self.n)))
        t = np.cross(n, np.eye(3)[np.abs(n).argmin()])
        shares, found = np.array([share for share, _, _ in self.sublayers]), []
        knots = np.concatenate([[0.0], np.cumsum(shares)]) - 0.5
        for way in (n, t / np.linalg.norm(t)):
            e = np.array([(way[i] * n[j] + way[j] * n[i]) / 2 * (1 if i == j else ROOT2) for i, j in MANDEL])
            stiffness = [1.0 if C is None else float(e @ C @ e) for _, _, C in self.sublayers]
            grown = np.concatenate([[0.0], np.cumsum(shares / stiffness)])
            found.append(np.interp(y, knots, grown / grown[-1] - 0.5))
        return found[0], found[1]

    def require_stable(self) -> None:
        """Raise LawError if a stiffness at rest is negative: equilibria would be unstable."""
        for _, law, C in self.sublayers:
            if is_checked_at_rest(law):
                require_stable(law, C, self.n)

    def locks(self) -> Refused | None:
        """Why the law of order 1 locks, as displacements are linear through the layer; None: it does not."""
        largest = min(station.largest_ratio for station in self.law.stations())
        for _, law, C in self.sublayers:
            lmbda, mu = (0.0, 1.0) if C is None else average_lame(C)
            if lmbda > largest * mu:
                ratios = [f"{x:.4g} (nu = {x / (x + 1) / 2:.4f})" for x in (lmbda / mu, largest)]
                reason = (
                    f"order=1 of {type(law).__name__} with lmbda/mu = {ratios[0]} at rest locks; allowed: {ratios[1]}"
                )
                elastic = not (law.traits.remembers or law.traits.rate)
                rubber = ", or Rubber or LinearElastic if it is isotropic" if elastic else ""
                return Refused("locks", reason, f"use order=0, or mesh the layer (structure.full){rubber}")
        return None
