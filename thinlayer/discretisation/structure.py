"""Structure: bodies, supports and loads, from which the models of a thin layer are made."""

from __future__ import annotations

from thinlayer.discretisation.full_model import FullModel
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import Bond, Layers
from thinlayer.discretisation.setup import Setup


class Structure(Setup):
    """A structure with a thin soft layer: bodies, supports and loads, shared by all of its models. Collective.

    Args:
        joint: the joint; the layer is on S.
        body: law of the bodies (moduli: stress), or region name -> law. Allowed are laws of strains that do not
            soften, except laws only for layers: `Stack`, `Incompressible`, laws with phases, and laws that depend on
            the normal of S. Parameters may be numpy functions of places (d, n) in the joint that return n values.
        supports: place -> prescribed displacements, see `Supports`; they continue over the side of the layer. Where
            places overlap their values must agree.
        tractions: facet name -> (d,) traction (stress), constant or a function (x, t) of UFL coordinates that returns d
            components. It acts on the bodies. With bodies="extended" it also acts on the part of the layer's side that
            was theirs, so that all models have the same loads. The name "NAME/LAYER" loads the layer's side alone: this
            force of order eps is in interface laws of order 1, but not in those of order 0. `Pressure(p)` acts along
            the inner normal.
        body_force: (d,) force per volume in the bodies, constant or a function (x, t). Or name -> force, for regions
            and seams; a single seam is called "S". On a seam it is the weight of the layer, of order eps. It acts on
            the layer's cells or, in the interface model, times the thickness and in halves on both sides of S. On a
            rigid base one half acts directly on the base.
        loads: `PointLoad`, `LineLoad`.
        plane: "strain", "stress" or "axisymmetric", for a joint in 2D. In plane stress laws compute the strains out of
            the plane themselves (`BulkLaw.plane_stress`). Axisymmetric: x is the distance r >= 0 from the axis of
            revolution, y the place along it, and there is no twist. On the axis u_x = 0 is prescribed automatically.
            All integrals (energies, loads, forces, over S) are over the whole revolution.
        element: "P1", "P2" (default) on triangles and tetrahedra, "Q1", "Q2" (default) or "S2" on others.
        parts: further parts of the balance of forces: `Springs`, `UflPart`, or a user-defined `PartDefinition`.
        strain: mean strain of a periodic joint, (d, d) symmetric numbers, or a function (x, t) of the time alone that
            returns them. Displacements u then exclude the mean motion: bodies have the strain E + strain(u), S has the
            jump [u]. Translations that nothing prevents are fixed at one vertex, so `supports={}` is allowed.
        stress: mean stress instead, likewise: the mean strain is then unknown, see `State.mean_strain`. The joint must
            be periodic in all directions, and the bodies linear.
        eigenstrain: strain that the bodies would have without stress, or region name -> strain. Allowed are a number, a
            symmetric table (d, d) or (3, 3), and a function (x, t) of UFL coordinates that returns one of these;
            `ThermalExpansion`, `Prestress`, or a list of several that add up. A number multiplies the identity in three
            dimensions, so that in plane strain it also causes stress across the plane. Layers have their own
            eigenstrain, `ThinLayer(..., eigenstrain=...)`.
        comm: MPI communicator (default: the world).

    The attributes are described in `Setup`.

    Raises:
        InputError: the message says what cannot be built, where, and what is allowed. Names of facets and loads are
            checked when a model is made.
    """

    def full(
        self, layer: Layers, *, bodies: str = "kept", cells_through: int = 4, junctions: str | None = None
    ) -> FullModel:
        """Make the model whose layer is meshed. Collective.

        Args:
            layer: law and thickness of the layer; S is inflated by the thickness. For a joint with several seams {name
                of a seam: its layer, or a `Gap` for an open joint}, or one layer for all. A layer continues past the
                end of a gap. With extended bodies, tractions do not act on the parts that bodies gave up to gaps.
            bodies: "kept" or "extended", see `geometry.inflate`.
            cells_through: number of cells through the layer's thickness; even where layers meet. For a law that softens
                it has little effect, and a single cell is sufficient and fastest: means of strains through the
                thickness drive the law, as on S, and deviations from them are elastic.
            junctions: name of a seam whose law also fills the cells where it meets other seams. At other junctions, and
                by default, this is the law of the first of the joint's seams that end there. These cells need the law
                of a layer, with moduli that decrease with the thickness. Other laws would tie the corners of the bodies
                together, and the model would not converge to the interface model.

        Raises:
            InputError: the message says what cannot be built, where, and what is allowed.
        """
        return FullModel(self, layer, bodies=bodies, cells_through=cells_through, junctions=junctions)

    def interface(self, layer: Layers, *, bodies: str = "kept") -> InterfaceModel:
        """Make the model whose layer is replaced by its interface law on S. Collective.

        Args:
            layer: a thin layer, or a law on S alone: a `TractionLaw` or a contact law; or a `Bond`. For a joint with
                several seams {name of a seam: its layer or bond; None or a `Gap` for an open joint}, or one for all.
            bodies: "kept": bodies meet on S. "extended": bodies are where `full(layer, bodies="extended")` has them,
                each half of the thickness away from S (on a rigid base all of it). Order 1 needs this on a curved S, or
                with a thickness that varies. All layers must then have a thickness, and seams must not meet.

        Raises:
            InputError: the message says what cannot be built, where, and what is allowed.
        """
        return InterfaceModel(self, layer, bodies=bodies)

    def bonded(self) -> InterfaceModel:
        """Make the model without layers: bodies are bonded on all of S (on a rigid base S is fixed). Collective.

        Raises:
            InputError: the message says what cannot be built, where, and what is allowed.
        """
        return self.interface(Bond())
