"""Keys of laws in states and in files: of their memory, their stored energy, and the pressure of a layer."""

from __future__ import annotations

from dataclasses import dataclass, replace

LAYER_KIND, CONTACT_KIND, BODY_KIND, PRESSURE_KIND, BUBBLE_KIND = "layer", "contact", "body", "pressure", "bubble"


@dataclass(frozen=True)
class Key:
    """Key of a law's memory, energy or pressure: in states and files a text "KIND", "KIND NAME" or "KIND NAME/MEMBER".

    Attributes:
        kind: "layer", "contact", "body", "pressure" or "bubble"; or the key of a user-defined part.
        name: name of the seam or body. In joints with one seam it is "", or the number of a sublayer as in "layer 1".
        member: number of a sublayer as in "layer BED/1", or "forms" for all laws in UFL forms together; "": the key is
            that of the whole.
    """

    kind: str
    name: str = ""
    member: str = ""

    @classmethod
    def parse(cls, text: str) -> Key:
        """Return the key that a text such as "layer BED/1" stands for."""
        whole, _, member = text.partition("/")
        kind, _, name = whole.partition(" ")
        return cls(kind, name, member)

    def __str__(self) -> str:
        return self.kind + (self.name and f" {self.name}") + (self.member and f"/{self.member}")

    @property
    def pressure_key(self) -> Key:
        """Key of the pressure in a layer, made from the key of the layer's law."""
        return replace(self, kind=PRESSURE_KIND)

    @property
    def bubble_key(self) -> Key:
        """Key of the bubble amplitude of a layer of order 2, made from the key of the layer's law."""
        return replace(self, kind=BUBBLE_KIND)

    def numbered(self, k: int) -> Key:
        """Return the key of the law number `k`, from 1, of several laws with this key.

        Sublayers are counted from the lower face.
        """
        return Key(self.kind, str(k)) if self in (Key(LAYER_KIND), Key(BODY_KIND)) else Key.parse(f"{self}/{k}")

    def belongs_to(self, layer: Key) -> bool:
        """Return whether this key is that of a layer, or of the layer's sublayers, forms or own unknowns.

        `layer` is the key of the layer.
        """
        return self in (layer.pressure_key, layer.bubble_key) or (
            self.kind == layer.kind and layer.name in ("", self.name)
        )
