"""Every effect that Saltus knows, by the name under which logs, profiles and reports speak of it."""

from typing import Any

from saltus.effects.actuator_lag import ActuatorLag
from saltus.effects.backlash import Backlash
from saltus.effects.battery_sag import BatterySag
from saltus.effects.camera_latency import CameraLatency
from saltus.effects.command_delay import CommandDelay
from saltus.effects.depth_bias import DepthBias
from saltus.effects.depth_noise import DepthNoise
from saltus.effects.depth_scale import DepthScale
from saltus.effects.edge_holes import EdgeHoles
from saltus.effects.effect import Effect
from saltus.effects.encoder_quantisation import EncoderQuantisation
from saltus.effects.feedforward_delay import FeedforwardDelay
from saltus.effects.frame_drop import FrameDrop
from saltus.effects.heightmap_shift import HeightmapShift
from saltus.effects.hole_fill import HoleFill
from saltus.effects.imu_bias import ImuBias
from saltus.effects.imu_latency import ImuLatency
from saltus.effects.offsets_and_factors import (
    Armature,
    BaseInertia,
    CameraFov,
    CameraHeight,
    CameraPitch,
    ComOffset,
    ContactCompliance,
    CoulombFriction,
    EncoderBias,
    FootFriction,
    PayloadMass,
    TorqueGain,
    ViscousFriction,
)
from saltus.effects.range_clip import RangeClip
from saltus.effects.sample_and_hold import SampleAndHold
from saltus.effects.stiction import Stiction
from saltus.effects.temporal_smear import TemporalSmear
from saltus.effects.torque_saturation import TorqueSaturation
from saltus.effects.torque_speed_limit import TorqueSpeedLimit
from saltus.effects.velocity_filter import VelocityFilter

_CLASSES: tuple[type[Effect[Any]], ...] = (
    CommandDelay,
    FeedforwardDelay,
    ActuatorLag,
    TorqueSpeedLimit,
    TorqueSaturation,
    TorqueGain,
    BatterySag,
    Backlash,
    ViscousFriction,
    CoulombFriction,
    Stiction,
    Armature,
    EncoderBias,
    EncoderQuantisation,
    VelocityFilter,
    SampleAndHold,
    DepthScale,
    DepthBias,
    DepthNoise,
    EdgeHoles,
    RangeClip,
    HoleFill,
    FrameDrop,
    TemporalSmear,
    CameraLatency,
    CameraPitch,
    CameraHeight,
    CameraFov,
    HeightmapShift,
    PayloadMass,
    ComOffset,
    BaseInertia,
    FootFriction,
    ContactCompliance,
    ImuBias,
    ImuLatency,
)
EFFECTS: dict[str, type[Effect[Any]]] = {kind.name: kind for kind in _CLASSES}
