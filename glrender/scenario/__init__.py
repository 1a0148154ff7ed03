"""From a scenario to States: a source of trajectory, a source of attitude and a time sampler, joined."""

from __future__ import annotations

from .attitude import Attitude, Fixed, Geometry, Pointing, Spin
from .belief.belief import Belief, BodyBelief, CameraBelief, SpacecraftBelief
from .disturbances import Disturbed, Jitter
from .dynamics import GravityGradient, RigidBody
from .encounter import Encounter
from .epochs import Epoch
from .files.aem import attitude_of_aem
from .files.ccsds import trajectory_of_oem
from .files.horizons import trajectory_of_horizons
from .files.scenario_file import load_believed_scene, load_scenario, scenario_of_table
from .files.state_files import attitude_of_csv, attitude_of_parquet, trajectory_of_csv, trajectory_of_parquet
from .files.sum_files import SumImage, image_of_sum
from .files.tables import AttitudeTable, Segments, TrajectoryTable
from .instruments.focal_plane import FittedCamera, FocalPlane
from .instruments.isd import Isd
from .kepler import Kepler
from .paths import AtRest, Hovering, OfFunction, Trajectory, circular_orbit
from .random_states import RandomStates
from .samplers import EqualTurns, Exponential, FixedRate, Linear, Times
from .scenario import Scenario
from .spice.instrument import camera_of_kernel
from .spice.kernels import Spice
from .spice.sources import SpiceAttitude, SpiceTrajectory
from .torques import DustImpacts, GasDrag, Plate, Thruster, Wheels

__all__ = ["AtRest", "Attitude", "AttitudeTable", "Belief", "BodyBelief", "CameraBelief", "Disturbed", "DustImpacts",
           "Encounter", "Epoch", "EqualTurns", "Exponential", "FittedCamera", "Fixed", "FixedRate", "FocalPlane",
           "GasDrag", "Geometry", "GravityGradient", "Hovering", "Isd", "Jitter", "Kepler", "Linear", "OfFunction",
           "Plate", "Pointing", "RandomStates", "RigidBody", "Scenario", "Segments", "SpacecraftBelief", "Spice",
           "SpiceAttitude", "SpiceTrajectory", "Spin", "SumImage", "Thruster", "Times", "Trajectory", "TrajectoryTable",
           "Wheels", "attitude_of_aem", "attitude_of_csv", "attitude_of_parquet", "camera_of_kernel", "circular_orbit",
           "image_of_sum", "load_believed_scene", "load_scenario", "scenario_of_table", "trajectory_of_csv",
           "trajectory_of_horizons", "trajectory_of_oem", "trajectory_of_parquet"]
