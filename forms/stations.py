"""Stations: heights in a layer at which its interface law of order 1 evaluates the law of the layer's material."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

import ufl

from forms.tensors import Expr, three_dimensional

LawType = TypeVar("LawType")  # a law of strains, `forms.law.BulkLaw`
# heights and weights of the Gauss points of the interval from -1/2 to 1/2, through the thickness, by their number
GAUSS_RULES = {
    2: ((-(12**-0.5), 1 / 2), (12**-0.5, 1 / 2)),
    3: ((-(0.15**0.5), 5 / 18), (0.0, 4 / 9), (0.15**0.5, 5 / 18)),
}
# lmbda/mu at which the jump's error of order 1 grows by a third if displacements are linear through the layer
LOCKING_RATIO = 12.0


class Faces(NamedTuple):
    """Displacements of the two faces of a layer at a place of S, UFL, in d dimensions; or another unknown there.

    The unknown has c components: d displacements, or the one value of a scalar field.

    Attributes:
        n: unit normal of S, from the lower to the upper face, (d,).
        eps: thickness of the layer.
        jump: displacement [u] of the upper face minus that of the lower face, (c,).
        grad_jump: gradient (c, d) of [u] along S.
        mean_strain_s: strain (3, 3) along S of the mean displacement <u> of both faces, or a prescribed strain; it is
            uniform through the layer.
        across: function that gives the strain (3, 3) of a jump (c,) over a unit of length along a normal (d,)
            (`Kinematics.strain_across`).
        along: function that gives the strain (3, 3) along S of the unknown on S. Its arguments are its gradient along S
            (c, d) and its values (c,) (`Kinematics.strain_along`).
        grad_eps: gradient (d,) of the thickness along S; None: the thickness is uniform.
        gradient_along: function that gives the gradient (d,) along S of a scalar on S, UFL of parameters of laws there;
            None: gradients along S count as zero.
    """

    n: Expr
    eps: Expr
    jump: Expr
    grad_jump: Expr
    mean_strain_s: Expr
    across: Callable[[Expr, Expr], Expr]
    along: Callable[[Expr, Expr], Expr]
    grad_eps: Expr | None = None
    gradient_along: Callable[[Expr], Expr] | None = None

    def strain_across(self, z: float = 0.0) -> Expr:
        """Return the strain (3, 3) across the layer that the jump [u] causes: sym([u] (x) (n - z grad_S eps))/eps.

        Where the thickness varies, the surface of points with the height z is inclined by z grad_S eps; this changes
        its normal.

        Args:
            z: height divided by the thickness, from -1/2 at the lower to 1/2 at the upper face.
        """
        n = self.n if self.grad_eps is None or z == 0 else self.n - z * self.grad_eps
        return self.across(self.jump, n) / self.eps

    @property
    def strain_difference(self) -> Expr:
        """Strain (3, 3) along S of the upper face minus that of the lower face, sym(grad_S [u])."""
        return self.along(self.grad_jump, self.jump)

    @property
    def strain_change(self) -> Expr:
        """Strain (3, 3) of the layer at the upper face minus that at the lower, for displacements linear in the height.

        It is `strain_difference`; where the thickness varies, it is eps sym(grad_S ([u]/eps)).
        """
        if self.grad_eps is None:
            return self.strain_difference
        return self.strain_difference + self.strain_across(0.5) - self.strain_across(-0.5)

    @property
    def n_dyad(self) -> Expr:
        """Tensor n (x) n (3, 3), with the unit normal n."""
        return ufl.outer(three_dimensional(self.n), three_dimensional(self.n))

    def in_plane(self, e: Expr) -> Expr:
        """Return the in-plane part P e P (3, 3) of a strain `e` (3, 3), where P = I - n (x) n."""
        projector = ufl.Identity(3) - self.n_dyad
        return projector * e * projector

    def with_scaled_jump(self, normal: Expr, tangential: Expr) -> Faces:
        """Return the same faces with the normal jump multiplied by `normal`, the tangential jump by `tangential`.

        The mean displacement of the faces does not change.
        """
        n = self.n
        jump = tangential * self.jump + (normal - tangential) * ufl.dot(n, self.jump) * n
        grad_jump = tangential * self.grad_jump + (normal - tangential) * ufl.outer(n, ufl.dot(n, self.grad_jump))
        return self._replace(jump=jump, grad_jump=grad_jump)


@dataclass(frozen=True)
class Station(Generic[LawType]):
    """A height in a layer at which the interface law of order 1 evaluates a law, with its weight and the strain there.

    The energy of the layer per area of S is eps times the sum of weight times energy over all stations. Only this sum
    is meaningful: the strain at one station may differ from the layer's strain at any height.

    Attributes:
        law: the law.
        station_weight: weight of the station in an integral over the height from -1/2 to 1/2.
        strain: function that returns the strain (3, 3), UFL, linear in displacements and in prescribed strains. Its
            arguments are the law, with parameters that are UFL expressions on S, and the displaced faces.
        mobility: function of the same law that returns the flux along S over the pressure's gradient and eps^3; 0
            without a pressure.
        max_lame_ratio: lmbda/mu for small strains, beyond which this strain makes the layer lock.
        strain_laws: laws that `strain` gets, as a tuple, in place of `law`, such as those of all sublayers; (): `law`.
    """

    law: LawType
    station_weight: float
    strain: Callable[[LawType, Faces], Expr]
    mobility: Callable[[LawType], Expr] = lambda law: 0
    max_lame_ratio: float = math.inf
    strain_laws: tuple[Any, ...] = ()


AnyStation = Station[Any]  # of a law of any class; a list of stations may have laws of several


def gauss_stations(
    law: LawType, difference: Callable[[LawType, Faces], Expr] | None = None, count: int = 2
) -> list[Station[LawType]]:
    """Return `count` stations, 2 or 3, at the Gauss points through the thickness, for a strain linear in the height.

    Args:
        law: the law.
        difference: function that returns the strain (3, 3) at the upper face minus that at the lower face. Its
            arguments are those of `Station.strain`: the law and the displaced faces. None: displacements are linear in
            the height (`Faces.strain_change`), which locks for lmbda/mu > `LOCKING_RATIO`.
        count: number of stations.
    """
    strain_change = difference or (lambda law, faces: faces.strain_change)

    def at(z: float) -> Callable[[LawType, Faces], Expr]:
        return lambda law, faces: faces.strain_across() + faces.mean_strain_s + z * strain_change(law, faces)

    max_ratio = math.inf if difference else LOCKING_RATIO
    return [Station(law, weight, at(z), max_lame_ratio=max_ratio) for z, weight in GAUSS_RULES[count]]
