"""The physics that a system can have: one term, one file. Removing a term from a system's list removes that physics."""

from .added_mass import AddedMass
from .air_drag import AirDrag
from .anisotropy import Anisotropy
from .base import Effect, Term
from .bending import Bending
from .bending_damping import BendingDamping
from .compression_softening import CompressionSoftening
from .controller_delay import ControllerDelay
from .controller_springs import ControllerSprings
from .coulomb_ground import CoulombGround
from .creep import Creep
from .dahl_friction import DahlFriction
from .damage import Damage
from .dashpot import Dashpot
from .directional_ground import DirectionalGround
from .fibres import Fibres
from .fung import Fung
from .gravity import Gravity
from .gravity_tilt import GravityTilt
from .grip_compliance import GripCompliance
from .grip_points import GripPoints
from .grip_slip import GripSlip
from .ground import Ground
from .ground_adhesion import GroundAdhesion
from .ground_pose import GroundPose
from .grown_shape import GrownShape
from .hidden_obstacle import HiddenObstacle
from .hidden_tether import HiddenTether
from .inflation import Inflation
from .internal_friction import InternalFriction
from .kelvin_voigt import KelvinVoigt
from .layer_contact import LayerContact
from .linear_drag import LinearDrag
from .maxwell import Maxwell
from .membrane import Membrane
from .membrane_damping import MembraneDamping
from .membrane_slack import MembraneSlack
from .membrane_stiffening import MembraneStiffening
from .neo_hookean import NeoHookean
from .neo_hookean_membrane import NeoHookeanMembrane
from .norton_creep import NortonCreep
from .observer import Observer
from .plasticity import Plasticity
from .plate_bending import PlateBending
from .plate_damping import PlateDamping
from .plate_drag import PlateDrag
from .plate_stiffening import PlateStiffening
from .pressure import Pressure
from .quadratic_drag import QuadraticDrag
from .rest_shape import RestShape
from .rope_creep import RopeCreep
from .rope_friction import RopeFriction
from .rope_relaxing import RopeRelaxing
from .rope_yielding import RopeYielding
from .second_hand import SecondHand
from .self_collision import SelfCollision
from .sheet_creep import SheetCreep
from .sheet_friction import SheetFriction
from .sheet_relaxing import SheetRelaxing
from .sheet_tension import SheetTension
from .sheet_yielding import SheetYielding
from .sliding_hand import SlidingHand
from .soft_grip import SoftGrip
from .soft_ground import SoftGround
from .springs import Springs
from .stiffness_field import StiffnessField
from .stiffness_patch import StiffnessPatch
from .strain_stiffening import StrainStiffening
from .stribeck_ground import StribeckGround
from .surface_drag import SurfaceDrag
from .tearing import Tearing
from .tension_compression import TensionCompression
from .torsion import Torsion
from .viscoelastic import Viscoelastic
from .wind import Wind
from .yarns import Yarns
from .yielding import Yielding

__all__ = [
    "AddedMass",
    "AirDrag",
    "Anisotropy",
    "Bending",
    "BendingDamping",
    "CompressionSoftening",
    "ControllerDelay",
    "ControllerSprings",
    "CoulombGround",
    "Creep",
    "DahlFriction",
    "Damage",
    "Dashpot",
    "DirectionalGround",
    "Effect",
    "Fibres",
    "Fung",
    "Gravity",
    "GravityTilt",
    "GripCompliance",
    "GripPoints",
    "GripSlip",
    "Ground",
    "GroundAdhesion",
    "GroundPose",
    "GrownShape",
    "HiddenObstacle",
    "HiddenTether",
    "Inflation",
    "InternalFriction",
    "KelvinVoigt",
    "LayerContact",
    "LinearDrag",
    "Maxwell",
    "Membrane",
    "MembraneDamping",
    "MembraneSlack",
    "MembraneStiffening",
    "NeoHookean",
    "NeoHookeanMembrane",
    "NortonCreep",
    "Observer",
    "Plasticity",
    "PlateBending",
    "PlateDamping",
    "PlateDrag",
    "PlateStiffening",
    "Pressure",
    "QuadraticDrag",
    "RestShape",
    "RopeCreep",
    "RopeFriction",
    "RopeRelaxing",
    "RopeYielding",
    "SecondHand",
    "SelfCollision",
    "SheetCreep",
    "SheetFriction",
    "SheetRelaxing",
    "SheetTension",
    "SheetYielding",
    "SlidingHand",
    "SoftGrip",
    "SoftGround",
    "Springs",
    "StiffnessField",
    "StiffnessPatch",
    "StrainStiffening",
    "StribeckGround",
    "SurfaceDrag",
    "Tearing",
    "TensionCompression",
    "Term",
    "Torsion",
    "Viscoelastic",
    "Wind",
    "Yarns",
    "Yielding",
]
