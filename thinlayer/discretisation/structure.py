"""Structure: bodies, supports and loads, from which the models of a thin layer are made."""

from __future__ import annotations

from thinlayer.discretisation.full_model import FullModel
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import Bond, Layers
from thinlayer.discretisation.setup import Setup


class Structure(Setup):
    """A structure with a thin soft layer: bodies, supports and loads, given once for all of its models. Collective.

    Args:
        joint: the joint; S is where the layer is.
        body: law of the bodies (moduli: stress), or region name -> law. Any law of strains but those for layers alone
            (`Stack`, `Incompressible`, laws with phases, or of the normal of S) and those that soften. Its parameters may
            be numpy functions of places (d, n) in the joint that give n values.
        supports: place -> prescribed displacements, see `Supports`; they continue over the side of the layer. Where places
            overlap their values must agree.
        tractions: facet name -> (d,) traction (stress), constant or a function (x, t) of UFL coordinates that returns d
            components. On the bodies, and with bodies="extended" on the part of the layer's side that was theirs, so that
            the loads of all models are the same; name "NAME/LAYER" to load that side by itself: a force of order eps, which
            interface laws of order 1 have and those of order 0 have not. `Pressure(p)` acts along the inner normal.
        body_force: (d,) force per volume in the bodies, likewise, or name -> force, of regions and of seams (a single one
            is called "S"): the weight of a layer, which acts on its cells or, in the interface model, times the thickness
            and in halves on both sides of S; half of it goes to a rigid base directly. It is of order eps.
        loads: `PointLoad`, `LineLoad`.
        plane: "strain", "stress" or "axisymmetric", of a joint in 2D. In plane stress laws find the strains out of the
            plane themselves (`BulkLaw.plane_stress`). Axisymmetric: x is the distance r >= 0 from the axis of revolution,
            y the place along it, there is no twist; u_x = 0 holds on the axis by itself, and all integrals (energies,
            loads, forces, over S) are over the whole revolution.
        element: "P1", "P2" (default) on triangles and tetrahedra, "Q1", "Q2" (default) or "S2" on others.
        parts: additions to the balance of forces: `Springs`, `UflPart`, or your own `Addition`.
        strain: mean strain of a periodic joint, (d, d) symmetric numbers, or a function (x, t) of the time alone that
            returns them. Displacements u are then those beside the mean motion: bodies have the strain E + strain(u), S
            has the jump [u]. Translations that nothing prevents are held at one vertex: `supports={}` will do.
        stress: mean stress instead, likewise: the mean strain is then unknown, see `State.mean_strain`. The joint is
            periodic in all directions, and bodies are linear.
        eigenstrain: strain that the bodies would have without stress, or region name -> strain: a number (times the
            identity in three dimensions, so that in plane strain it also stresses across the plane), a symmetric table
            (d, d) or (3, 3), a function (x, t) of UFL coordinates that returns one of these, `ThermalExpansion`,
            `Prestress`, or a list of several that add up. Layers have their own, `ThinLayer(..., eigenstrain=...)`.
        comm: MPI communicator (default: the world).

    Attributes are those of `Setup`.

    Raises:
        InputError: says what cannot be built, where, and what is allowed. Names of facets and
            loads are checked when a model is made.
    """

    def full(
        self, layer: Layers, *, bodies: str = "kept", cells_through: int = 4, junctions: str | None = None
    ) -> FullModel:
        """The model whose layer is meshed. Collective.

        Args:
            layer: law and thickness of the layer; S is inflated by the thickness. Of a joint with several seams {name of a
                seam: its layer, or a `Gap` for an open joint}, or one layer for all. Layers that pass the end of a gap go
                on there. Where bodies are extended, tractions do not act on what they gave up to gaps.
            bodies: "kept" or "extended", see `geometry.inflate`.
            cells_through: number of cells through the layer's thickness; even, where layers meet. Of a law that softens it
                changes little: means of strains through the thickness drive the law, as on S, what differs from them is
                elastic. One cell will do, and takes the least time.
            junctions: name of the seam whose law holds in the cells where it meets others; elsewhere, and by default
                everywhere, it is the first of the joint's seams that end there. These cells need the law of a layer: with
                moduli that do not fall with the thickness they would tie the corners of the bodies together, and the
                model would not converge to the interface model.

        Raises:
            InputError: says what cannot be built, where, and what is allowed.
        """
        return FullModel(self, layer, bodies=bodies, cells_through=cells_through, junctions=junctions)

    def interface(self, layer: Layers, *, bodies: str = "kept") -> InterfaceModel:
        """The model whose layer is replaced by its interface law on S. Collective.

        Args:
            layer: a thin layer, or a law on S alone: a `TractionLaw` or a contact law; or a `Bond`. Of a joint with several
                seams, {name of a seam: its layer or bond; None or a `Gap` for an open joint}, or one for all.
            bodies: "kept": bodies meet on S. "extended": they stand where `full(layer, bodies="extended")` has them, each
                half of the thickness away from S (on a rigid base all of it): order 1 on a curved S, or with a thickness
                that varies, needs this. All layers then have a thickness, and seams do not meet.

        Raises:
            InputError: says what cannot be built, where, and what is allowed.
        """
        return InterfaceModel(self, layer, bodies=bodies)

    def bonded(self) -> InterfaceModel:
        """The model without layers: bodies are bonded on all of S (on a rigid base S does not move). Collective.

        Raises:
            InputError: says what cannot be built, where, and what is allowed.
        """
        return self.interface(Bond())
