"""The stages of a substep: one abstract class each, which a term derives from. In the order in which the engine keeps their parameters.

``given`` are the arguments of the stage's laws, before ``p`` and ``o``; the numpy ``twin`` is given the same, and then the parameters.

Forces are summed over axial, strand, hinge, facet, solid (with what alters it), membrane, plate, layer, body, surface, touch, grip and
observer terms, then v <- velocity(v + dt F / m), in rounds with what is viscous in a solid or a sheet, or then contacts, then move.

A solid is a grid of cells (``physics.grids``); deformed is the deformation gradient F (3, 3) from the grid's axes to the room, rate [1/s]
its rate. ``home`` [m] is where the material was in frame 0. A solid that grew or flowed has a rest shape G of its own: laws but the
viscous see deformed = F G^-1, and the stress is pulled back, P = det(G) P(F G^-1) G^-T. See ``physics.materials``.

Where a system has material points (``physics.points``), body forces act on them instead of on nodes, and only then are there the stages
"surface", "touch", "grip" and "slip"; m [kg] is what a point carries of its body, for springs that must hold it.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

from .base import Term

__all__ = [
    "ARGUMENTS",
    "CELLS",
    "EASED",
    "HINGES",
    "POINTS",
    "SHEETS",
    "STAGED",
    "STAGES",
    "STAGE_CLASSES",
    "AxialTerm",
    "BodyTerm",
    "BranchTerm",
    "ContactTerm",
    "FacetTerm",
    "FlowTerm",
    "GripTerm",
    "GrowthTerm",
    "HingeBranchTerm",
    "HingeFlowTerm",
    "HingeTerm",
    "LayerTerm",
    "LinksTerm",
    "MaterialTerm",
    "MembraneTerm",
    "MoveTerm",
    "ObserverTerm",
    "PlateTerm",
    "SetupTerm",
    "SheetBranchTerm",
    "SheetFlowTerm",
    "SlipTerm",
    "SolidTerm",
    "StrandTerm",
    "SurfaceTerm",
    "TouchTerm",
    "VelocityTerm",
    "ViscousMembraneTerm",
    "ViscousPlateTerm",
    "ViscousTerm",
]


class KernelTerm(Term):
    """A term whose ``law`` is fused into the kernels."""

    law: ClassVar[Any] = None  # a Warp function of ``given``, the parameters' vector p and where the term's own begin in it, o

    @staticmethod
    @abstractmethod
    def twin(*given, **parameters) -> Any:
        """The same law in numpy."""


class RememberingTerm(KernelTerm):
    """A term that remembers q between substeps, 0 in frame 0. Law and evolve both see the substep's start, unless the stage says else.

    ``evolve`` (as the law, and dt before p) is its memory after the substep, which must not overshoot what it tends to however long dt is.
    """

    evolve: ClassVar[Any] = None

    @staticmethod
    @abstractmethod
    def twin_evolve(*given, **parameters) -> Any:
        """The same memory in numpy."""


class HardTerm(KernelTerm):
    """A term that is a stiff spring between two places."""

    @staticmethod
    @abstractmethod
    def hardness(**parameters) -> tuple[float, float]:
        """(stiffness / m [1/s^2], damping / m [1/s]) at given parameters, for stability."""
        ...


class AxialTerm(KernelTerm):
    """The tension along a spring [N]; positive pulls its ends together."""

    stage = "axial"
    given = ("length", "rate", "rest", "stiffness")


class StrandTerm(RememberingTerm):
    """The tension along a spring [N] that remembers a number q.

    ``link`` is 1 for a spring that ties a controller, else 0; ``middle`` [m] is where the spring's middle was in frame 0; ``t`` [s] is the
    time since then.
    """

    stage = "strand"
    given = ("length", "rate", "rest", "stiffness", "link", "middle", "t", "q")


class HingeTerm(KernelTerm):
    """The moment of a hinge [N m], the work per change of kappa.

    A hinge is three nodes in a row; kappa holds its curvature about two material axes, 2 tan(angle / 2) = 2 tan(k l / 2), and its twist
    [rad]; rate [1/s] is theirs, natural (n1, n2, 0) the wanted curvature, span [m] the length that the hinge stands for (``physics.rods``).
    """

    stage = "hinge"
    given = ("kappa", "rate", "natural", "span")


class HingeFlowTerm(KernelTerm):
    """How the natural curvature of a rope flows in a substep: what of its elastic curvature becomes natural (``physics.fabrics``).

    ``strain`` holds the curvature [1/m] about both material axes beyond the natural one, and 0; ``curved`` is 2. Only hinges of a chain
    remember; twist, which is at rest in every substep, is not remembered.
    """

    stage = "hinge_flow"
    given = ("strain", "curved", "dt")


class HingeBranchTerm(RememberingTerm):
    """Springs beside a rope's bending that remember q, as ``strain``: the curvature at which its elasticity would resist as they do.

    ``strain`` and ``curved`` as ``HingeFlowTerm`` has them; the law sees q after the substep.
    """

    stage = "hinge_branch"
    given = ("strain", "curved", "q")


class FacetTerm(KernelTerm):
    """The force on a facet [N], which its three corners share.

    ``area`` [m^2] is its area vector, outward where the skin is closed, v [m/s] its mean velocity, m [kg] the mass that it carries, and
    ``swell`` what the skin enclosed in frame 0 over what it encloses now: 1 where it is open (``physics.skin``).
    """

    stage = "facet"
    given = ("area", "v", "m", "swell", "dt")


class GrowthTerm(KernelTerm):
    """What the rest shape of a solid differs by from frame 0, G - 1. ``at`` is from the body's middle, in the grid's axes and rms radii."""

    stage = "growth"
    given = ("at",)


class FlowTerm(KernelTerm):
    """How the rest shape of a solid flows in a substep, D: G <- (1 + D) G."""

    stage = "flow"
    given = ("deformed", "home", "mu", "lame", "dt")


class SolidTerm(KernelTerm):
    """The first Piola-Kirchhoff stress of a solid's elasticity [Pa].

    It may declare ``moduli`` (p, o), and ``twin_moduli`` in numpy: Lame's constants (mu, lambda) [Pa] at small strains, of which other
    terms and the cells' bending make theirs.
    """

    stage = "solid"
    given = ("deformed",)
    moduli: ClassVar[Any] = None

    @staticmethod
    def twin_moduli(**parameters) -> tuple[float, float]:
        """The same moduli in numpy: none."""
        return 0.0, 0.0


class MaterialTerm(KernelTerm):
    """More of a solid's stress [Pa]."""

    stage = "material"
    given = ("deformed", "home", "mu", "lame")


class BranchTerm(RememberingTerm):
    """More of a solid's stress [Pa] that remembers q, a matrix (3, 3) at each material point, as it is after the substep.

    ``stress`` [Pa] is that of the elasticity.
    """

    stage = "branch"
    given = ("stress", "deformed", "rate", "home", "mu", "lame", "q")


class ViscousTerm(KernelTerm):
    """The second Piola-Kirchhoff stress [Pa], linear in the Green strain's rate; on velocities, in rounds (``physics.rounds``)."""

    stage = "viscous"
    given = ("rate",)


class MembraneTerm(KernelTerm):
    """The stress resultants of a sheet [N/m].

    A sheet is a triangulation (``physics.sheets``); strain is Green's. It and what the law returns are symmetric tensors in a triangle's
    plane, written (11, 22, 12), where work is S_11 E_11 + S_22 E_22 + 2 S_12 E_12; the law is the same in all directions.
    """

    stage = "membrane"
    given = ("strain",)


class PlateTerm(KernelTerm):
    """The moments per length of a sheet [N]: as ``MembraneTerm``, of the curvature [1/m] that triangles make beyond that at rest."""

    stage = "plate"
    given = ("curvature",)


class SheetFlowTerm(KernelTerm):
    """How the rest shape of a sheet flows in a substep: what of its elastic strain, or curvature, becomes rest (``physics.fabrics``).

    ``strain`` is in a triangle's plane, as ``MembraneTerm`` has it, or where ``curved`` is 1, and not 0, the curvature [1/m].
    """

    stage = "sheet_flow"
    given = ("strain", "curved", "dt")


class SheetBranchTerm(RememberingTerm):
    """Springs beside a sheet that remember q, a tensor as ``strain``: the strain at which its elasticity would resist as they do.

    ``strain`` and ``curved`` as ``SheetFlowTerm`` has them; the law sees q after the substep.
    """

    stage = "sheet_branch"
    given = ("strain", "curved", "q")


class ViscousMembraneTerm(KernelTerm):
    """More stress resultants of a sheet [N/m], linear in the strain's rate [1/s]; on velocities, in rounds (``physics.rounds``)."""

    stage = "viscous_membrane"
    given = ("rate",)


class ViscousPlateTerm(KernelTerm):
    """More moments per length of a sheet [N], linear in the curvature's rate [1/(m s)]; on velocities, in rounds."""

    stage = "viscous_plate"
    given = ("rate",)


class LayerTerm(HardTerm):
    """The force on the first of two places [N]; they meet within p[o].

    Layers of a sheet and strands of a rope, or of several in one system, meet as vertices and triangles, and as edges; apart [m] is the
    way from the second to the first nearest place, rate [m/s] its change, m [kg] what the pair carries (``physics.layers``).
    """

    stage = "layer"
    given = ("apart", "rate", "m")


class BodyTerm(KernelTerm):
    """The force on one particle [N]; it was at ``home`` in frame 0."""

    stage = "body"
    given = ("x", "v", "home", "m")


class SurfaceTerm(KernelTerm):
    """The force on a point of the skin [N] that stands for an area [m^2]."""

    stage = "surface"
    given = ("x", "v", "home", "area", "m")


class TouchTerm(RememberingTerm, HardTerm):
    """The force of the ground on a point of the skin [N] that remembers q (3,), how far friction is stretched after the substep."""

    stage = "touch"
    given = ("x", "v", "m", "q")


class GripTerm(HardTerm):
    """The force of a hand on a point [N] that lags apart [m] behind it; ``hand`` is its number (``System.hands``)."""

    stage = "grip"
    given = ("apart", "rate", "m", "hand")


class SlipTerm(KernelTerm):
    """How far what a ``hand`` of that number holds has slid in it after a substep [m], 0 in frame 0; all of it slides as one.

    It lags ``apart`` [m] behind the hand beside the ``slid`` [m] before, the mean over the m [kg] that are held, and is pulled by ``pull``
    [N] in all for that. What it tends to must not be overshot however long dt is.
    """

    stage = "slip"
    given = ("apart", "pull", "m", "hand", "slid", "dt")


class ObserverTerm(KernelTerm):
    """The force on one particle that was seen at y [m], moving with u [m/s]."""

    stage = "observer"
    given = ("x", "v", "home", "y", "u", "m")


class VelocityTerm(KernelTerm):
    """The velocity after the stage [m/s]."""

    stage = "velocity"
    given = ("v", "dt")


class ContactTerm(KernelTerm):
    """The impulse on particle i [N s]; pairs meet within p[o].

    Contacts are between particles of one system that approach: (xj - xi) . (vj - vi) < -1e-4 m^2/s. Pairs are looked up once a frame; a
    term with a parameter ``collide_neighbours`` of 0 leaves out those that start closer than p[o]. Driven particles do not yield.
    """

    stage = "contact"
    given = ("xi", "xj", "vi", "vj", "mi", "mj")


class MoveTerm(KernelTerm):
    """The position and velocity after the substep."""

    stage = "move"
    given = ("x", "v", "dt")


class LinksTerm(Term):
    """Only adds springs."""

    stage = "links"


class SetupTerm(Term):
    """What the system is made of, before it moves (masses, rest lengths, controllers' paths), in torch."""

    stage = "setup"

    @staticmethod
    @abstractmethod
    def prepare(batch, inputs, values) -> Any:
        """``inputs`` (``physics.inputs``) of a ``batch`` with what the term's ``values``, name -> (systems,), make of them."""


_SPRINGS = (AxialTerm, StrandTerm, HingeTerm, HingeFlowTerm, HingeBranchTerm, FacetTerm)
_CELLS = (GrowthTerm, FlowTerm, SolidTerm, MaterialTerm, BranchTerm, ViscousTerm)
_SHEETS = (MembraneTerm, PlateTerm, SheetFlowTerm, SheetBranchTerm, ViscousMembraneTerm, ViscousPlateTerm)
_EASED = (ViscousTerm, ViscousMembraneTerm, ViscousPlateTerm)
_POINTS = (BodyTerm, SurfaceTerm, TouchTerm, GripTerm, SlipTerm)
_STAGED = (*_SPRINGS, *_CELLS, *_SHEETS, LayerTerm, *_POINTS, ObserverTerm, VelocityTerm, ContactTerm, MoveTerm)

TERMS = ()  # none of these is a term that can be used
STAGE_CLASSES: dict[str, type[Term]] = {c.stage: c for c in (*_STAGED, LinksTerm, SetupTerm)}
STAGES = tuple(STAGE_CLASSES)
STAGED = tuple(c.stage for c in _STAGED)  # whose laws are in the kernels
CELLS = tuple(c.stage for c in _CELLS)  # of solids: what they do they do in a grid's cells
SHEETS = tuple(c.stage for c in _SHEETS)
HINGES = tuple(c.stage for c in _SPRINGS[2:5])  # of what bends as ropes do
EASED = tuple(c.stage for c in _EASED)  # in rounds
POINTS = tuple(c.stage for c in _POINTS[1:])  # at material points alone
ARGUMENTS = {c.stage: c.given for c in _STAGED}
