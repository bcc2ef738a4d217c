"""Delamination of two arms with a crack between them: beams on glue that breaks, which specimens are compared with.

Loads and tractions of the glue bend the arms, which are clamped where the glue ends. The glue opens by w and slips by s.
Both are linear in the load P and in the tractions, which follow from w and s by the cohesive law. Newton's method solves
for w, s and P, as P may fall, and is given how far the glue is broken. The law is written here a second time. Displacements
of the load follow from the tractions and from the w and s of the load alone, by the theorem of Maxwell and Betti.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from forms import Cohesive
from forms.base import Array
from studies.snap import polygon_distances
from thinlayer import Table
from thinlayer.output.plotting.curves import LAW_COLOUR, MESHED_COLOUR
from thinlayer.running.record import Record
from thinlayer.solving.history import History

ON_S, MESHED, BEAMS, SHARP = "law on S", "meshed layer", "beams", "beams with a sharp crack"
LOOK: dict[str, Any] = {  # of curves
    "colours": {BEAMS: "black", ON_S: LAW_COLOUR, MESHED: MESHED_COLOUR, SHARP: "0.5"},
    "styles": {BEAMS: "-", ON_S: "o", MESHED: ".", SHARP: ":"},
}
STEP, ROWS = 0.1, 20  # of beams: distance of points, mm; number of equilibria before the crack grows, and as it grows
NEWTON_STEPS, NEWTON_RTOL, DIFFERENCE = 50, 1e-9, 1e-6  # of beams; step of difference quotients, relative to the onset


def precrack(length: float) -> Any:
    """Return the damage of glue with a crack from x = 0 to a length, as a function of places x (d, n): 1 there, else 0."""
    return lambda x: 1.0 * (x[0] < length)


@dataclass(frozen=True)
class Beams:
    """Two arms of unit width on glue, which a load P opens at their ends and bends in the middle of a span.

    Attributes:
        glue: its law, with linear softening and the criterion of Benzeggagh and Kenane.
        E: modulus of the arms, in plane strain or plane stress.
        height: height of an arm.
        length: distance from the ends of the arms, where the crack begins, to the end of the glue or to the middle.
        crack: length of the precrack.
        opening, bending: force that opens each arm, and force that bends both, over P.
        shear: stiffness of an arm in shear; inf: Euler's theory.
    """

    glue: Cohesive
    E: float
    height: float
    length: float
    crack: float
    opening: float = 0.0
    bending: float = 0.0
    shear: float = math.inf

    def opened(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Array:
        """Return the opening at the distance x from clamped ends due to unit forces on both arms at the distance y."""
        least, most = np.minimum(x, y), np.maximum(x, y)
        return np.asarray(4 * least**2 * (3 * most - least) / (self.E * self.height**3) + 2 * least / self.shear)

    def toughness(self, B: Array | float) -> Array:
        """Return the toughness at a mode mixity."""
        return np.asarray(self.glue.G_I + (self.glue.G_II - self.glue.G_I) * B**self.glue.eta)

    def tractions(self, z: Array) -> tuple[Array, Array]:
        """Return (2, n) tractions at openings and slips z (2, n), and how far the glue is: 0 at the onset, 1 broken."""
        K, strength = (self.glue.K_N, self.glue.K_T), (self.glue.t_N, self.glue.t_T)
        released = np.array(K)[:, None] * np.array([np.maximum(z[0], 0), z[1]]) ** 2 / 2
        Y = np.maximum(released.sum(axis=0), 1e-300)
        i = (released / Y).T @ (2 * np.array(K) / np.square(strength))
        k, xi = self.toughness(released[1] / Y) * i, np.sqrt(Y * i)
        share = (xi - 1) / (k - 1)
        left = 1 - np.clip(share * k / np.maximum(xi, 1), 0, 1)
        return np.array([K[0] * np.where(z[0] > 0, left, 1), K[1] * left]) * z, share

    def sharp(self, a: npt.ArrayLike) -> Table:
        """Return displacements and forces for sharp cracks of lengths `a` in arms that do not part elsewhere."""
        lengths: Array = np.asarray(a, float)
        G_I, G_II = 12 * (self.opening * lengths) ** 2, 9 / 16 * (self.bending * lengths) ** 2  # times P^2/(E h^3)
        P: Array = np.sqrt(self.toughness(G_II / (G_I + G_II)) * self.E * self.height**3 / (G_I + G_II))
        compliance = 8 * self.opening**2 * lengths**3 + self.bending**2 * (2 * self.length**3 + 3 * lengths**3) / 8
        return Table.of({"displacement": P * compliance / (self.E * self.height**3), "force": P})

    def envelope(self, longest: float) -> Table:
        """Return equilibria as the glue softens at the precrack, and then as the crack grows up to a length.

        Columns: "displacement", at which P does work; "force" P; "crack", its length; "dissipated".
        """
        glue, L, axial = self.glue, self.length, self.E * self.height / 8
        n = round((L - self.crack) / STEP) + 1
        x = np.linspace(L - self.crack, 0, n)  # from the clamped end
        weights = np.full(n, x[0] - x[1])
        weights[[0, -1]] /= 2  # of the trapezoidal rule
        F = np.zeros((2, n, 2, n))  # openings and slips that tractions cause
        F[0, :, 0], F[1, :, 1] = self.opened(x, x[:, None]) * weights, np.minimum(x, x[:, None]) / axial * weights
        slip = 1.5 * self.bending * x * (2 * L - x) / (self.E * self.height**2)
        by_load = np.array([self.opening * self.opened(x, L), slip])
        # compliance without glue; in the other half of the span the glue is sound
        beyond = L * axial / glue.K_T - (axial / glue.K_T) ** 1.5
        bent = (5 * L**3 + 9 * beyond) / (8 * self.E * self.height**3)
        compliance = self.opening**2 * self.opened(L, L) + self.bending**2 * bent

        def solve(z: Array, P: float, point: int, goal: float) -> tuple[Array, float]:
            for _ in range(NEWTON_STEPS):
                (t, share), J = self.tractions(z), np.eye(2 * n + 1)
                r = np.append((z - by_load * P).ravel() + F.reshape(2 * n, -1) @ t.ravel(), share[point] - goal)
                J[:-1, -1], J[-1, -1] = -by_load.ravel(), 0.0
                for k, d in enumerate(DIFFERENCE * glue.t_T / glue.K_T * np.eye(2)[:, :, None]):
                    (t_1, share_1), (t_0, share_0) = self.tractions(z + d), self.tractions(z - d)
                    columns = slice(k * n, k * n + n)
                    J[:-1, columns] += ((F * (t_1 - t_0)).sum(axis=2) / (2 * d[k])).reshape(2 * n, n)
                    J[-1, k * n + point] = ((share_1 - share_0) / (2 * d[k]))[point]
                dz = np.linalg.solve(J, -r)
                z, P = z + dz[:-1].reshape(2, n), P + float(dz[-1])
                if np.abs(dz[:-1]).max() < NEWTON_RTOL * np.abs(z).max():
                    return z, P
            raise ArithmeticError(f"beams have not converged at the crack {self.crack + x[0] - x[point]:g}")

        K = np.repeat([glue.K_N, glue.K_T], n)
        z: Array = np.linalg.solve(np.eye(2 * n) + F.reshape(2 * n, -1) * K, by_load.ravel()).reshape(2, n)
        P = 1 / math.hypot(glue.K_N * z[0, 0] / glue.t_N, glue.K_T * z[1, 0] / glue.t_T)  # at the onset
        z, table = z * P, [(0.0, 0.0, self.crack)]
        ends = np.linspace(0, (longest - self.crack) / (x[0] - x[1]), ROWS + 1)[1:].round().astype(int)
        for point, share in [*((0, share) for share in np.linspace(0, 1, ROWS)), *((int(end), 1.0) for end in ends)]:
            z, P = solve(z, P, point, share)
            t, _ = self.tractions(z)
            table.append((compliance * P - float((by_load * t * weights).sum()), P, self.crack + x[0] - x[point]))
        u, force, a = np.array(table).T
        work = np.concatenate([[0.0], np.cumsum((force[1:] + force[:-1]) * np.diff(u) / 2)])
        return Table.of({"displacement": u, "force": force, "crack": a, "dissipated": work - force * u / 2})


def path_table(history: History, length: float) -> Table:
    """Return the path of a model with glue of a length, with the columns of beams.

    The table of the history must have the additional columns "displacement" and "force".
    """
    rows = history.table
    columns = {"displacement": rows["displacement"], "force": rows["force"], "crack": length * rows["broken"]}
    return Table.of(columns | {"dissipated": np.cumsum(rows["dissipated"])})


def check_sharp(record: Record, beams: Beams, envelope: Table, low: float, label: str = "") -> None:
    """Check that sharp cracks need larger forces than cracks of the same lengths in beams, by a share of at least `low`."""
    grown = slice(ROWS, None)
    excess = beams.sharp(envelope["crack"][grown])["force"] / envelope["force"][grown] - 1
    record.check(f"{label}force of sharp cracks of the same lengths over that of beams, less 1", excess.min(), low=low)


def compare(record: Record, path: Table, beams: Table, rtol: float, label: str = "") -> None:
    """Check a model's stiffness and largest force against beams, and how far its path is from theirs."""
    ours, theirs = (np.stack([curve["displacement"], curve["force"]], axis=1) for curve in (path, beams))
    ratio = ours[1, 1] / ours[1, 0] / (theirs[1, 1] / theirs[1, 0])
    record.check_near(f"{label}stiffness of the sound specimen over that of beams", ratio, 1.0, rtol)
    ratio = ours[:, 1].max() / theirs[:, 1].max()
    record.check_near(f"{label}largest force over that of beams", ratio, 1.0, rtol)
    distances = polygon_distances(ours[path["crack"] < beams["crack"][-1]], theirs)
    record.check(f"{label}largest distance of the path from that of beams, over its size", distances.max(), high=rtol)
