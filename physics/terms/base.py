"""What a term is.

A term states one law at one stage of a substep, as a Warp function that is generic in its precision; the engine fuses the laws of all terms
into one kernel and derives their adjoints, so a term never writes a gradient. ``p[o], p[o+1], ...`` are the term's own parameters.

stage       law                                                      returns
"axial"     (length, rate, rest, stiffness, p, o)                    tension along the spring [N], positive pulls its ends together
"strand"    (length, rate, rest, stiffness, link, middle, t, q, p, o) tension along a spring that remembers q [N]
"hinge"     (kappa, rate, natural, span, p, o)                       moment of a hinge [N m], the work per change of kappa
"facet"     (area, v, m, swell, dt, p, o)                            force on a facet [N], which its three corners share
"growth"    (at, p, o)                                               what the rest shape of a solid differs by from frame 0, G - 1
"flow"      (deformed, home, mu, lame, dt, p, o)                     how it flows in a substep, D: G <- (1 + D) G
"solid"     (deformed, p, o)                                         first Piola-Kirchhoff stress of its elasticity [Pa]
"material"  (deformed, home, mu, lame, p, o)                         more of it [Pa]
"branch"    (stress, deformed, rate, home, mu, lame, q, p, o)        more of it that remembers q [Pa]
"viscous"   (rate, p, o)                                             second Piola-Kirchhoff stress [Pa], linear in the Green strain's rate
"membrane"  (strain, rate, p, o)                                      stress resultants of a sheet [N/m]
"plate"     (curvature, rate, p, o)                                   moments per length of a sheet [N]
"layer"     (apart, rate, m, p, o)                                   force on the first of two places [N]; they meet within p[o]
"body"      (x, v, home, m, p, o)                                    force on one particle [N]; it was at ``home`` in frame 0
"surface"   (x, v, home, area, m, p, o)                          force on a point of the skin [N] that stands for an area [m^2]
"touch"     (x, v, m, q, p, o)                                   force of the ground on a point of the skin [N] that remembers q (3,)
"grip"      (apart, rate, m, p, o)                               force of a hand on a point [N] that lags apart [m] behind it
"observer"  (x, v, home, y, u, m, p, o)                              force on one particle that was seen at y [m], moving with u [m/s]
"velocity"  (v, dt, p, o)                                            velocity after the stage [m/s]
"contact"   (xi, xj, vi, vj, mi, mj, p, o)                           impulse on particle i [N s]; pairs meet within p[o]
"move"      (x, v, dt, p, o)                                         position and velocity after the substep
"links"     none: the term only adds springs
"setup"     ``prepare``, in torch: what the system is made of, before it moves (masses, rest lengths, controllers' paths)

A strand term also declares ``evolve`` (length, rate, rest, stiffness, link, middle, t, q, dt, p, o), its memory after the substep: one
number a spring, 0 in frame 0, which must not overshoot what it tends to, however long dt is. Law and evolve both see the substep's start.
``link`` is 1 for a spring that ties a controller, else 0; ``middle`` [m] is where the spring's middle was in frame 0; ``t`` [s] is the time
since then.

Contacts are between particles of one system that approach: (xj - xi) . (vj - vi) < -1e-4 m^2/s. Pairs are looked up once a frame; a contact
term with a parameter ``collide_neighbours`` of 0 leaves out those that start closer than p[o]. Driven particles do not yield.

A hinge is three nodes in a row; kappa holds its curvature about two material axes, 2 tan(angle / 2) = 2 tan(k l / 2), and its twist [rad];
rate [1/s] is theirs, natural (n1, n2, 0) the wanted curvature, span [m] the length that the hinge stands for. See ``physics.rods``.

A facet is three particles; area [m^2] is its area vector, outward where the skin is closed, v [m/s] its mean velocity, m [kg] the mass
that it carries, and swell what the skin enclosed in frame 0 over what it encloses now: 1 where it is open. See ``physics.skin``.

A solid is a grid of cells (``physics.grids``); deformed is the deformation gradient F (3, 3) from the grid's axes to the room, rate [1/s]
its rate. A solid term may declare ``moduli`` (p, o), and ``twin_moduli`` in numpy: Lame's constants (mu, lambda) [Pa] at small strains,
of which other terms and the cells' bending make theirs. A solid that grew or flowed has a rest shape G of its own: laws but the viscous see
deformed = F G^-1, and the stress is pulled back, P = det(G) P(F G^-1) G^-T. ``home`` [m] is where the material was in frame 0, ``at`` the
same from the body's middle, in the grid's axes and rms radii. A branch term declares ``evolve`` (stress, deformed, rate, home, mu, lame, q,
dt, p, o), its memory after the substep, a matrix (3, 3) at each material point, 0 in frame 0; its law sees q as it is then; ``stress`` [Pa]
is that of the elasticity. See ``physics.materials``. Viscous stresses act on velocities after the "velocity" stage, in rounds. See
``physics.rounds``.

A sheet is a triangulation (``physics.sheets``); strain is Green's, curvature [1/m] what angles between triangles make of it beyond that at
rest, rate [1/s, 1/m/s] theirs; all of them and what laws return are symmetric tensors in a triangle's plane, written (11, 22, 12), where
work is S_11 E_11 + S_22 E_22 + 2 S_12 E_12. Laws are the same in all directions.

Layers of a sheet and strands of a rope, or of several in one system, meet as vertices and triangles, and as edges; apart [m] is the way
from the second to the first nearest place, rate [m/s] its change, m [kg] what the pair carries. See ``physics.layers``. A layer term
declares ``hardness`` as below.

Where a system has material points (``physics.points``), body forces act on them instead of on nodes, and only then are there the stages
"surface", "touch" and "grip"; m [kg] is what a point carries of its body, for springs that must hold it. A touch term declares ``evolve``
(x, v, m, q, dt, p, o), too: its law sees the memory after the substep, which is how far friction is stretched. A touch or grip term also
declares ``hardness``, (stiffness / m [1/s^2], damping / m [1/s]) at given parameters, for stability.

A law builds a vector whole, ``type(x)(a, b, c)``, or writes each component of a new one once: Warp's adjoint of a component that is written
over is wrong.

Forces are summed over axial, strand, hinge, facet, solid (with what alters it), membrane, plate, layer, body, surface, touch, grip and
observer terms, then v <- velocity(v + dt F / m), then damping in rounds or contacts, then move.
"""

from dataclasses import dataclass, field, replace
from typing import ClassVar

from ...datasets.collection import nearest
from ..parameters import Parameter

__all__ = ["ARGUMENTS", "CELLS", "SHEETS", "STAGED", "STAGES", "Effect", "Term"]

CELLS = ("growth", "flow", "solid", "material", "branch", "viscous")  # of solids: what they do they do in a grid's cells
SHEETS = ("membrane", "plate")
SPRINGS, POINTS = ("axial", "strand", "hinge", "facet"), ("body", "surface", "touch", "grip")
STAGED = (*SPRINGS, *CELLS, *SHEETS, "layer", *POINTS, "observer", "velocity", "contact", "move")  # whose laws are in the kernels
STAGES = (*STAGED, "links", "setup")
# what a law is given, before p and o; its numpy twin is given the same, and then the parameters
ARGUMENTS = {
    "axial": ("length", "rate", "rest", "stiffness"),
    "strand": ("length", "rate", "rest", "stiffness", "link", "middle", "t", "q"),
    "hinge": ("kappa", "rate", "natural", "span"),
    "facet": ("area", "v", "m", "swell", "dt"),
    "growth": ("at",),
    "flow": ("deformed", "home", "mu", "lame", "dt"),
    "solid": ("deformed",),
    "material": ("deformed", "home", "mu", "lame"),
    "branch": ("stress", "deformed", "rate", "home", "mu", "lame", "q"),
    "viscous": ("rate",),
    "membrane": ("strain", "rate"),
    "plate": ("curvature", "rate"),
    "layer": ("apart", "rate", "m"),
    "body": ("x", "v", "home", "m"),
    "surface": ("x", "v", "home", "area", "m"),
    "touch": ("x", "v", "m", "q"),
    "grip": ("apart", "rate", "m"),
    "observer": ("x", "v", "home", "y", "u", "m"),
    "velocity": ("v", "dt"),
    "contact": ("xi", "xj", "vi", "vj", "mi", "mj"),
    "move": ("x", "v", "dt"),
}


@dataclass(frozen=True)
class Effect:
    """What a term means to someone who asks which physics a twin lacks.

    name        of the effect, as diagnoses print it
    says        one clause in plain words, after "the twin lacks that ..."
    amplitudes  the parameters that are 0 where the effect is absent, and in which it is nearly linear while it is small
    typical     values of a noticeable effect: where tests look, and the scale of a search
    shapes      values to try of the other parameters, by name
    place       prefix of parameters ``<place>_x, _y, _z`` [m] that say where on the body (frame 0) or in the room it is, or ""
    within      the name of the parameter that says how far around ``place`` it reaches [m], or ""
    motion      what to record in order to see it
    """

    name: str
    says: str
    amplitudes: tuple[str, ...]
    typical: dict[str, float]
    shapes: dict[str, tuple[float, ...]] = field(default_factory=dict)
    place: str = ""
    within: str = ""
    motion: str = ""


@dataclass(frozen=True)
class Term:
    """One law with its parameter values.

    Subclasses declare ``name``, ``stage``, ``parameters`` and ``law`` (and ``evolve`` if it remembers), or ``prepare``.
    """

    values: dict[str, float] = field(default_factory=dict)

    name: ClassVar[str]
    stage: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    law: ClassVar = None
    evolve: ClassVar = None
    moduli: ClassVar = None
    hardness: ClassVar = None
    effect: ClassVar[Effect | None] = None

    def __post_init__(self):
        known = {p.name: p for p in self.parameters}
        for name, value in self.values.items():
            if name not in known:
                raise ValueError(f"{self.name} has no parameter {name!r}; {nearest(name, known) if known else 'known: none'}")
            p = known[name]
            if not p.low <= value <= p.high:
                raise ValueError(f"{name} must lie in [{p.low:g}, {p.high:g}] {p.unit}, got {value}")
        object.__setattr__(self, "values", {p.name: float(self.values.get(p.name, p.value)) for p in self.parameters})

    def with_values(self, **values) -> "Term":
        """The same term with some parameters changed."""
        return replace(self, values={**self.values, **values})
