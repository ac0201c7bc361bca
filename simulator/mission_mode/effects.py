"""Deviations from the nominal Mission Mode, by name: `gyrocal mission --effect NAME=SIZE[,PARAMETER=VALUE…]`.

An effect changes the config that the loop flies. Sizes are in the effect's unit; zero is the nominal spacecraft unless the
text says otherwise. They are effects of a whole spacecraft in its control loop and not of a recording, and so are apart from
those of `simulator.effects`, which act on a gyro stream and its references.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gyrocal.errors import InputError
from simulator.effects.settings import read_number, split_text
from simulator.mission_mode.config import DAY, HorizonError, MissionConfig, apply_compensation
from simulator.mission_mode.mounting import ALIGNED_AT, build_mounted_sensors
from simulator.sensors.sun import build_trmm_alignments

Parameters = Mapping[str, float]
Change = Callable[[MissionConfig, float, Parameters], MissionConfig]
DEG_H_IN_RAD_S = math.radians(1.0) / 3600.0  # rad/s
AXES = "xyz"


@dataclass(frozen=True)
class MissionEffect:
    """An effect."""

    name: str  # this and the next two are for the command line
    unit: str
    summary: str
    bounds: tuple[float, float]  # of the size
    change: Change  # from a config, a size and parameters to the config with the effect
    parameters: Mapping[str, float] = field(default_factory=dict)  # names with their defaults
    axes: str = ""  # axes it may be about; "" for none


@dataclass(frozen=True)
class MissionSetting:
    """An effect with its size and parameters; the axis is among the parameters, as its number."""

    effect: str
    size: float
    parameters: Parameters


def _set_elevation(config: MissionConfig, size: float, parameters: Parameters) -> MissionConfig:
    boresights = math.radians(parameters["tilt_deg"]), -math.radians(size)
    return replace(config, boresights=boresights, sun_sensors=build_mounted_sensors(config.mounting, boresights))


def _set_horizon_noise(config: MissionConfig, size: float, parameters: Parameters) -> MissionConfig:
    return replace(config, horizon=replace(config.horizon, sigma=math.radians(size), time_constant_s=parameters["tau_s"]))


def _set_horizon_season(config: MissionConfig, size: float, parameters: Parameters) -> MissionConfig:
    return replace(config, horizon=replace(config.horizon, season=math.radians(size)))


def _set_transfer_scale(config: MissionConfig, size: float, parameters: Parameters) -> MissionConfig:
    """Give the true β of DSS-2 another scale than the tables, about the angle at which the ground aligned it.

    B_true = (1 + s) B − s B₀ with the bracket B of R (5), and B₀ that of the yaw update at the alignment's sun angle: an
    alignment made there has taken out what the scale does there.
    """
    first, second = config.sun_sensors
    angle = math.radians(ALIGNED_AT[1])
    sun = np.array([-math.cos(angle), -math.sin(angle), 0.0]) @ build_trmm_alignments(*config.boresights)[1]
    beta = apply_compensation(second.coefficients_beta, 1.0 + size, -size * float(sun[1] / sun[2]))
    return replace(config, sun_sensors=(first, replace(second, coefficients_beta=beta)))


def _set_rate_walk(config: MissionConfig, size: float, parameters: Parameters) -> MissionConfig:
    rrw = np.broadcast_to(np.asarray(config.gyro.rrw, dtype=float), 3).copy()
    rrw[int(parameters["axis"])] = size * DEG_H_IN_RAD_S / math.sqrt(DAY)
    return replace(config, gyro=replace(config.gyro, rrw=rrw))


def _set_bias_gain(config: MissionConfig, size: float, parameters: Parameters) -> MissionConfig:
    return replace(config, controller=replace(config.controller, bias_gain=size))


def _set_cross_track_error(config: MissionConfig, size: float, parameters: Parameters) -> MissionConfig:
    angle, phase = 1e3 * size / config.orbit.radius, math.radians(parameters["phase_deg"])
    node = -angle * math.cos(phase) / math.sin(config.orbit.inclination)
    return replace(config, ephemeris=replace(config.ephemeris, node=node, inclination=angle * math.sin(phase)))


def _set_printed_coefficients(config: MissionConfig, size: float, parameters: Parameters) -> MissionConfig:
    return replace(config, printed_coefficients=size > 0)


def _set_late_filter(config: MissionConfig, size: float, parameters: Parameters) -> MissionConfig:
    return replace(config, filter_off_first=size <= 0)


TAU_S = HorizonError().time_constant_s
ALL_MISSION_EFFECTS = (
    MissionEffect(
        "boresight_elevation", "deg", "the sun sensors look so far toward zenith; nominal is 29.4", (-40.0, 40.0),
        _set_elevation,
        {"tilt_deg": 20.0},
    ),
    MissionEffect(
        "printed_coefficients", "", "1: the second upload has (c, d) of R (6) as printed", (0.0, 1.0), _set_printed_coefficients
    ),
    MissionEffect(
        "late_filter_upload", "", "1: the S filter is turned off with the second upload", (0.0, 1.0), _set_late_filter
    ),
    MissionEffect(
        "dss_transfer", "1", "the β head of DSS-2 has another scale than the tables", (-0.05, 0.05), _set_transfer_scale
    ),
    MissionEffect(
        "horizon_noise", "deg", "radiance of the horizon: noise of each quadrant that is correlated in time", (0.0, 1.0),
        _set_horizon_noise, {"tau_s": TAU_S},
    ),
    MissionEffect(
        "horizon_season", "deg", "the winter hemisphere's limb is lower, by this times the sine of the latitude in January",
        (-1.0, 1.0), _set_horizon_season,
    ),
    MissionEffect("gyro_walk", "deg/h/sqrt(day)", "random walk of the gyro's bias", (0.0, 10.0), _set_rate_walk, axes=AXES),
    MissionEffect(
        "bias_gain", "1", "share of a yaw update that goes into the yaw bias; nominal is 1", (0.0, 1.9), _set_bias_gain
    ),
    MissionEffect(
        "cross_track", "km", "the ephemeris on board is off across the track, with the sine of the latitude argument",
        (-100.0, 100.0), _set_cross_track_error, {"phase_deg": 0.0},
    ),
)  # fmt: skip
MISSION_EFFECTS: Mapping[str, MissionEffect] = {effect.name: effect for effect in ALL_MISSION_EFFECTS}


def parse(text: str) -> MissionSetting:
    """Parse NAME[:AXIS]=SIZE[,PARAMETER=VALUE…]; an `InputError` is one line that says what is wrong with it."""
    name, axis, size, given = split_text(text)
    effect = MISSION_EFFECTS.get(name)
    if effect is None:
        raise InputError(f"effect {name or text}: Mission Mode has none of that name; there are {', '.join(MISSION_EFFECTS)}")
    unknown = [key for key in given if key not in effect.parameters]
    if unknown:
        raise InputError(f"{name}: no parameter {unknown[0]}; it has {', '.join(effect.parameters) or 'none'}")
    values = {**effect.parameters, **{key: read_number(name, key, value) for key, value in given.items()}}
    if bool(axis) != bool(effect.axes) or (axis or "") not in effect.axes:
        raise InputError(f"{name}: " + (f"give an axis, {name}:{effect.axes[-1]}=SIZE" if effect.axes else "has no axis"))
    if axis:
        values["axis"] = float(effect.axes.index(axis))
    return MissionSetting(name, read_number(name, "size", size or "''", *effect.bounds, effect.unit), values)


def apply_mission_settings(config: MissionConfig, settings: Sequence[MissionSetting]) -> MissionConfig:
    """Apply effects to a config in the order of `ALL_MISSION_EFFECTS`: a mounting comes before what changes it."""
    order = list(MISSION_EFFECTS)
    for chosen in sorted(settings, key=lambda setting: order.index(setting.effect)):
        config = MISSION_EFFECTS[chosen.effect].change(config, chosen.size, chosen.parameters)
    return config
