"""A body to play with: a net of springs on the made recording, nothing of it fitted."""

from dataclasses import replace

from twinbench.benchmark.conformance.scene import recording
from twinbench.methods.phystwin.body import Place, build
from twinbench.methods.phystwin.config import Config
from twinbench.methods.phystwin.twin import PhysTwinTwin

MADE = recording()
VALUES = dict(global_spring_Y=2e3, object_radius=0.012, object_max_neighbours=20, controller_radius=0.03, controller_max_neighbours=20)
VALUES |= dict(collide_elas=0.1, collide_fric=0.5, collide_object_elas=0.5, collide_object_fric=0.3, collision_dist=0.004)
VALUES |= dict(dashpot_damping=5.0, drag_damping=1.0)


def springs(added=(), **changes):
    """A net of springs on the made recording, hung from its hand, with ``added`` physics."""
    place = Place.of(replace(MADE, **changes))
    return PhysTwinTwin(build(VALUES, place, added), place, Config())
