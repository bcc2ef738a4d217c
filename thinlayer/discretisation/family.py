"""Families of models: those that differ in the laws of their layers or in their loads, and share all else."""

from __future__ import annotations

from typing import Protocol


class Destroyable(Protocol):
    """An object that holds memory which is not Python's."""

    def destroy(self) -> None:
        """Free the memory."""


class Family:
    """What the models of a family have in common, beside their mesh and space: a place where solvers keep matrices.

    Nothing is kept as long as the family has one model. What is kept is freed with the last model, or by `close`.

    Attributes:
        several: whether there are models that were derived from others.
    """

    def __init__(self) -> None:
        self.several = False
        self._kept: dict[str, Destroyable] = {}

    def keep(self, name: str, thing: Destroyable) -> None:
        """Keep an object for later solves, in place of another one of this name, which is freed."""
        if name in self._kept:
            self._kept[name].destroy()
        self._kept[name] = thing

    def take(self, name: str) -> Destroyable | None:
        """The object of this name, which the family has no more until it is given back by `keep`; None: there is none."""
        return self._kept.pop(name, None)

    def close(self) -> None:
        """Free what is kept. Collective."""
        for thing in self._kept.values():
            thing.destroy()
        self._kept = {}
