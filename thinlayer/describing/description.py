"""What a description says: a mesh file, laws, supports, loads, and what is asked; checked, without a mesh.

Its keys are the names of arguments of the package: of `geometry.read` in [mesh], of `Structure`, of `ThinLayer` in [layer],
and of `goals`. All moduli are real ones; a layer's are divided by its thickness when the layer is made.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from thinlayer.describing import entries
from thinlayer.describing.entries import Force, GoalGiven, Material, MeshFile, Place, Vector
from thinlayer.describing.section import History, Path, Section

KEYS = (
    "mesh", "units", "body", "layer", "supports", "tractions", "body_force", "loads", "plane", "element", "bodies",
    "times", "goals", "tolerance", "bonded",
)  # fmt: skip


@dataclass(frozen=True)
class Description:
    """A structure with a thin layer, and what is asked of it.

    Attributes:
        section: the whole table, for words about where entries stand.
        mesh: the mesh file.
        units: of lengths and of stresses, as texts; None: not given.
        body: region -> its law; None stands for all.
        layer: seam -> its law and thickness; None stands for all.
        supports: place -> prescribed displacements, as in `Structure`.
        tractions: name of a facet set -> components, or {"pressure": number}.
        body_force: components, or region or seam -> components; None: none.
        loads: loads at points and along edges.
        plane, element: as in `Structure`; None: its default.
        bodies: "kept" or "extended", as in `Structure.interface`.
        times: times of steps for laws with a rate or a memory; (): one solve.
        goals: name -> a quantity whose change is told.
        tolerance: quantity -> its largest relative change, for the thickness below which the layer may be dropped.
        bonded: whether to ask as well if the layer may be left out altogether.
    """

    section: Section
    mesh: MeshFile
    units: tuple[str, str] | None
    body: Mapping[str | None, Material]
    layer: Mapping[str | None, Material]
    supports: Mapping[Place, Any]
    tractions: Mapping[str, Any]
    body_force: Vector | Mapping[str, Vector] | None
    loads: tuple[Force, ...] = ()
    plane: str | None = None
    element: str | None = None
    bodies: str = "kept"
    times: tuple[float, ...] = ()
    goals: Mapping[str, GoalGiven] = field(default_factory=dict)
    tolerance: Mapping[str, float] = field(default_factory=dict)
    bonded: bool = False

    @classmethod
    def of(cls, section: Section) -> Description:
        """The description in a table; raises DescriptionError: where, what is wrong, and what is allowed."""
        section.allow(KEYS)
        goals = entries.goals(section)
        found = cls(
            section,
            entries.mesh(section),
            entries.units(section),
            {name: entries.material(one, thin=False) for name, one in entries.given(section, "body").items()},
            {name: entries.material(one, thin=True) for name, one in entries.given(section, "layer").items()},
            entries.supports(section.table("supports", "places with what they prescribe, such as LEFT = 0")),
            entries.tractions(section.table("tractions", "names of facet sets with a vector, such as TOP = [0, -50]")),
            entries.body_force(section),
            tuple(entries.load(one) for one in section.tables("loads", "place and force, or first, second and force")),
            section.text("plane", entries.PLANES),
            entries.element(section),
            entries.bodies(section),
            entries.times(section),
            goals,
            entries.tolerance(section, [*entries.ALWAYS, *(goals or ["compliance"])]),
            section.flag("bonded"),
        )
        if not (found.tractions or found.body_force or found.loads or found._moves()):
            section.refuse("nothing loads the structure; give tractions, body_force, loads, or supports that move")
        slow = [one for one in (*found.layer.values(), *found.body.values()) if one.law.traits.rate]
        if slow and not found.times:
            section.refuse(
                f"times is missing: {type(slow[0].law).__name__} depends on the rate of strains; give ends of time steps"
            )
        found._require_times()
        return found

    @property
    def histories(self) -> dict[Path, History]:
        """Keys of each value that is given by times -> its history."""
        found: dict[Path, Any] = {}
        for place, given in self.supports.items():
            found |= (
                {("supports", str(place), axis): v for axis, v in given.items()} if isinstance(given, Mapping) else {}
            )
        for name, load in self.tractions.items():
            found["tractions", name] = load["pressure"] if isinstance(load, Mapping) else load
        found |= {("loads", str(k), "force"): load.arguments["force"] for k, load in enumerate(self.loads, 1)}
        return {path: one for path, one in found.items() if isinstance(one, History)}

    def _require_times(self) -> None:
        """Raise DescriptionError unless histories reach from 0 to the last of the times."""
        for path, one in self.histories.items():
            first, last = min(one.values), max(one.values)
            if not self.times:
                self.section.refuse("a history needs times, the ends of time steps", *path)
            if first > 0 or last < self.times[-1]:
                reach = f"it is given from {first:g} to {last:g}, and times go from 0 to {self.times[-1]:g}"
                self.section.refuse(reach, *path)

    def _moves(self) -> bool:
        """Whether a support moves, or something has an eigenstrain."""
        shown = [v for one in self.supports.values() for v in (one.values() if isinstance(one, Mapping) else [one])]
        return any(shown) or any(one.eigenstrain for one in (*self.body.values(), *self.layer.values()))
