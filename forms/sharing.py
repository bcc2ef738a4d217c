"""Sharing: how linear elastic sublayers in series share the jump and the strains along S, for the law of order 1."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import ufl
from ufl.classes import Zero

from forms.kinematics import Expr, jump_strain, lift
from forms.law import BulkLaw, LawError, Step
from forms.stations import GAUSS, Faces, Station


@dataclass(frozen=True)
class Sharing:
    """Linear elastic sublayers in series.

    Across the layer they share the jump as at order 0: displacements are <u> + (Phi - I/2) [u], where Phi, (d, d), is zero
    at the lower face and grows by a_i S_i through the i-th sublayer to I at the upper one. With the acoustic tensors A_i
    and R_i = A_i^-1 the shares are S_i = R_i R^-1, R = sum_i a_i R_i. Strains along S are those of these displacements,
    so that the order of the sublayers matters.

    The tractions of these strains on planes parallel to S would not be equal through the layer. They become so as each
    sublayer is strained by a further sym(g_i (x) n), with mean zero: without that a nearly incompressible sublayer would
    lock.

    Attributes:
        sublayers: (fraction of the thickness, law), from the lower to the upper face. Laws are proportional and symmetric.
    """

    sublayers: tuple[tuple[float, BulkLaw], ...]

    def stations(self) -> list[Station]:
        """Two for each sublayer, at its Gauss points."""
        return [Station(law, a / 2, self._strain(k, z)) for k, (a, law) in enumerate(self.sublayers) for z in GAUSS]

    def _strain(self, k: int, z: float) -> Callable[[Faces], Expr]:
        """Strain at the height z, from -1/2 to 1/2, of the k-th sublayer."""
        law = self.sublayers[k][1]

        def strain(faces: Faces) -> Expr:
            n = faces.n
            parts, stiffness = self._parts(faces)
            mean = sum(a * R * traction(one, straight(0.0), n) for a, one, R, straight in parts)
            _, _, R, straight = parts[k]
            missing = stiffness * mean - traction(law, straight(z), n)
            return straight(z) + jump_strain(R * missing, n)

        return strain

    def _parts(self, faces: Faces) -> tuple[list[tuple[float, BulkLaw, Expr, Callable[[float], Expr]]], Expr]:
        """For each sublayer (fraction, law, R, height in it -> strain of the shared jump); and the whole's R^-1."""
        n, (fractions, laws) = faces.n, zip(*self.sublayers, strict=True)
        identity = ufl.Identity(len(n))
        compliances = [ufl.inv(acoustic(law, n)) for law in laws]
        stiffness = ufl.inv(sum(a * R for a, R in zip(fractions, compliances, strict=True)))
        moved, height, found = -identity / 2, -0.5, []
        for a, law, R in zip(fractions, laws, compliances, strict=True):
            found.append((a, law, R, _straight(faces, a, R * stiffness, moved, height)))
            moved, height = moved + a * R * stiffness, height + a
        return found, stiffness


def _straight(faces: Faces, a: float, share: Expr, moved: Expr, height: float) -> Callable[[float], Expr]:
    """Strain of a sublayer with this share of the jump, whose lower face has the displacement <u> + moved [u]."""

    def at(z: float) -> Expr:
        along = faces.turned(moved + (z + 0.5) * a * share).difference
        return faces.turned(share).across(height + (z + 0.5) * a) + faces.mean + along

    return at


def traction(law: BulkLaw, e: Expr, n: Expr) -> Expr:
    """Traction (d,) of a linear law on a plane of normal n (d,), for a strain e."""
    t = ufl.dot(law.stress(Step(e, n)), lift(n))
    return ufl.as_vector([t[i] for i in range(len(n))])


def acoustic(law: BulkLaw, n: Expr) -> Expr:
    """Acoustic tensor (d, d) of a linear law.

    Raises:
        LawError: the law has a stress without a strain.
    """
    if not isinstance(ufl.as_ufl(law.stress(Step(ufl.zero(3, 3), n))), Zero):
        raise LawError(
            f"order=1 of a Stack: the sublayer {type(law).__name__} has a stress at zero strain; use order=0, or give the "
            "strain as an eigenstrain of the layer"
        )
    d = len(n)
    columns = [traction(law, jump_strain(ufl.unit_vector(k, d), n), n) for k in range(d)]
    return ufl.as_matrix([[column[i] for column in columns] for i in range(d)])
