"""What is given of layers that are to be meshed, checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from forms.base import is_finite
from geometry.errors import GeometryError, place, refuse, unknown
from geometry.inflating.bands import Posts, level_heights
from geometry.joint import Joint, Profile
from geometry.topology import BoolArray, FloatArray, IntArray

WAYS = ("kept", "extended")
THINNEST = 1e-11  # thickness of a meshed layer over the size of its joint
Given = TypeVar("Given")


def claims_of(joint: Joint, junctions: Sequence[str], gaps: Sequence[str]) -> list[str]:
    """Names of the seams with cells, in the order of their claims to those of junctions."""
    for what, names in (("junctions", junctions), ("gaps", gaps)):
        for name in names:
            if name not in joint.seams:
                raise GeometryError(f"{what}: {unknown('seam', name, joint.seams)}")
    claims = [name for name in dict.fromkeys([*junctions, *joint.seams]) if name not in gaps]
    if not claims:
        raise GeometryError("all seams are gaps: there is no layer to mesh; use the interface model")
    return claims


def facets_with_cells(joint: Joint, gaps: Sequence[str], meshed: BoolArray | None) -> BoolArray:
    """(n_S,) which facets of S get cells: those of `meshed`, None being all, that are in no gap.

    Raises:
        GeometryError: `meshed` is none of n_S truth values; no facet gets cells; S branches, or seams meet, at a facet
            that gets none.
    """
    in_gaps = np.isin(np.array([*joint.seams])[joint.seam_numbers], list(gaps))
    if meshed is None:
        return np.asarray(~in_gaps)
    chosen, n = np.asarray(meshed), len(joint.surface_rows)
    if chosen.dtype != bool or chosen.shape != (n,):
        raise GeometryError(f"meshed has shape {chosen.shape} and type {chosen.dtype}; it needs {n} truth values")
    without = np.unique(joint.table.vertices[joint.surface_rows[~chosen & ~in_gaps]])
    lacking = "S branches, or seams meet, at {at}: the facets of S there need cells"
    refuse(np.isin(without, joint.meetings), joint.points[without], lacking)
    if not (chosen & ~in_gaps).any():
        raise GeometryError("no facet of S gets cells: there is no layer to mesh; use the interface model")
    return np.asarray(chosen & ~in_gaps)


def by_seam(joint: Joint, given: Given | Mapping[str, Given], what: str, *default: Given) -> dict[str, Given]:
    """A value for each seam, from one for all, or from {name of a seam: value}; others get the default, if one is given.

    Raises:
        GeometryError: a value for an unknown seam, or none for a seam.
    """
    if not isinstance(given, Mapping):
        return dict.fromkeys(joint.seams, given)
    for name in given:
        if name not in joint.seams:
            raise GeometryError(f"{what}: {unknown('seam', name, joint.seams)}")
    missing = [name for name in joint.seams if name not in given]
    if missing and not default:
        raise GeometryError(f"{what}: the seam {missing[0]!r} has none; give {what}={{{missing[0]!r}: ..., ...}}")
    return {name: given[name] if name in given else default[0] for name in joint.seams}


def check_layering(cells_through: int, bodies: str) -> None:
    """Raise GeometryError unless cells_through >= 1 and `bodies` is "kept" or "extended"."""
    if bodies not in WAYS:
        raise GeometryError(unknown("way to make room for the layer (bodies=...)", bodies, WAYS))
    if not is_finite(cells_through) or int(cells_through) != cells_through or cells_through < 1:
        raise GeometryError(
            f"cells_through is {cells_through!r}; the layer needs a whole number >= 1 of cells through its thickness"
        )


@dataclass(frozen=True)
class Layering:
    """What is given of the layers, by the names of their seams.

    Attributes:
        eps: thickness.
        fractions: of the sublayers.
        heights: of the levels of nodes.
        thickness: (n_S, k) at the nodes of each facet of S.
        varying: names of the seams with a profile.
    """

    eps: dict[str, float]
    fractions: dict[str, Sequence[float]]
    heights: list[FloatArray]
    thickness: FloatArray
    varying: tuple[str, ...]

    @classmethod
    def of(
        cls,
        joint: Joint,
        eps: float | Mapping[str, float],
        profile: Profile | Mapping[str, Profile | None] | None,
        cells_through: int,
        fractions: Sequence[float] | Mapping[str, Sequence[float]],
    ) -> Layering:
        """From the arguments of `inflate`.

        Raises:
            GeometryError: a size or fractions out of range; S reaches a periodic side; S ends inside the bodies.
        """
        sizes, shares = by_seam(joint, eps, "eps"), by_seam(joint, fractions, "fractions", ())
        profiles = by_seam(joint, profile, "profile", None)
        for name in joint.seams:
            one, some = sizes[name], shares[name]
            which = "" if len(joint.seams) == 1 else f" of {name!r}"
            if not is_finite(one) or one <= 0:
                raise GeometryError(f"the layer's thickness eps{which} is {one!r}; it must be > 0")
            if one < THINNEST * (size := float(np.ptp(joint.points, axis=0).max())):
                raise GeometryError(
                    f"the layer's thickness eps{which} is {one:.3g}, which coordinates do not resolve beside bodies of "
                    f"{size:.3g}; use the interface model"
                )
            if len(some) and not (all(map(is_finite, some)) and min(some) > 0 and abs(sum(some) - 1) <= 1e-12):
                raise GeometryError(f"the fractions {tuple(some)}{which} of sublayers must be > 0 and add up to 1")
        if joint.tip is not None:
            raise GeometryError(
                f"S ends inside the bodies (near {place(joint.tip)}): the layer has no room at its tip and cannot be "
                "meshed; use the interface model"
            )
        thickness = np.empty(joint.surface.shape)
        for number, name in enumerate(joint.seams):
            here = joint.seam_numbers == number
            thickness[here] = float(sizes[name]) * joint.relative_thickness(profiles[name], name)[joint.surface[here]]
        return cls(
            {name: float(one) for name, one in sizes.items()},
            shares,
            [level_heights(joint.degree, cells_through, shares[name]) for name in joint.seams],
            thickness,
            tuple(name for name in joint.seams if profiles[name] is not None),
        )


def check_junctions(joint: Joint, posts: Posts, seams: IntArray, meeting: IntArray, layers: Layering) -> None:
    """Raise GeometryError where layers meet that cannot be meshed there.

    Args:
        joint: the joint before inflating.
        posts: all posts at the nodes of S.
        seams: numbers of the seams of the posts at junctions.
        meeting: these posts.
        layers: the layers.
    """
    names, x = np.array(list(joint.seams))[seams], joint.points[posts.nodes[meeting]]
    reasons = {
        "the sublayers of one layer have no place in the others": [
            n for n, some in layers.fractions.items() if len(some)
        ],
        "junctions are meshed between layers of uniform thickness only": layers.varying,
        "junctions are meshed between straight-sided cells only": [*joint.seams] if joint.degree == 2 else [],
    }
    for reason, of_seams in reasons.items():
        where = "S branches at {at}, where three or more bodies meet"
        refuse(np.isin(names, list(of_seams)), x, f"{where}: {reason}; use the interface model")
    odd = posts.top[meeting] % 2 > 0
    through = f"cells_through is {posts.top[meeting][odd.argmax()]}" if odd.any() else ""
    refuse(odd, x, f"{through}: layers meet at {{at}} and need an even number of cells there")
