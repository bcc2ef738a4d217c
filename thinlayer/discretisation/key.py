"""Keys of laws in states and in files: of their memory, their stored energy, and the pressure of a layer."""

from __future__ import annotations

from dataclasses import dataclass, replace

LAYER_KIND, CONTACT_KIND, BODY_KIND, PRESSURE_KIND = "layer", "contact", "body", "pressure"


@dataclass(frozen=True)
class Key:
    """A key, as text "KIND", "KIND NAME" or "KIND NAME/PART". States and files have the texts.

    Attributes:
        kind: what it is the key of, such as `LAYER_KIND`.
        name: name of the seam or body. In joints with one seam it is "", or the number of a sublayer as in "layer 1".
        part: number of a sublayer as in "layer BED/1", or "forms" for the laws in UFL forms; "": all.
    """

    kind: str
    name: str = ""
    part: str = ""

    @classmethod
    def parse(cls, text: str) -> Key:
        """Return the key with a text."""
        whole, _, part = text.partition("/")
        kind, _, name = whole.partition(" ")
        return cls(kind, name, part)

    def __str__(self) -> str:
        return self.kind + (self.name and f" {self.name}") + (self.part and f"/{self.part}")

    @property
    def pressure(self) -> Key:
        """Key of the pressure in a layer."""
        return replace(self, kind=PRESSURE_KIND)

    def numbered(self, k: int) -> Key:
        """Return the key of sublayer k, counted from the lower face, or of the k-th of several laws."""
        return Key(self.kind, str(k)) if self in (Key(LAYER_KIND), Key(BODY_KIND)) else Key.parse(f"{self}/{k}")

    def belongs_to(self, layer: Key) -> bool:
        """Whether it is the key of a layer, of one of its sublayers or forms, or of its pressure."""
        return self == layer.pressure or (self.kind == layer.kind and layer.name in ("", self.name))
