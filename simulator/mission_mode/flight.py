"""Mission Mode flown: R's control loop with its sensors, its on-board tables and the days on which they change.

    >>> from simulator.mission_mode.config import MissionConfig
    >>> run = simulate_mission(MissionConfig(), seconds=6000.0, seed=1)
    >>> len(run.orbits), len(run.telemetry)
    (2, 100)

`MissionConfig` configures the run, `simulator.mission_mode.loop` simulates it. A run goes from event to event, an upload or the
start or end of a yaw maneuver, with everything constant in between. Errors are those of the commanded frame of
`simulator.mission_mode.target_frame`, small angles about the body axes with A_true = exp(−[ε×]) A_commanded; knowledge is
estimate − ε.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from gyrocal.arrays import Array
from simulator.mission_mode.calendar import compute_sun_angle, find_plane_crossings
from simulator.mission_mode.config import DAY, Forward, MissionConfig, OnBoardTables, YawManeuver, build_uploads
from simulator.mission_mode.loop import YEARLY, fly
from simulator.mission_mode.magnetic_field import compute_sidereal_angle
from simulator.mission_mode.state import NEVER, ORBIT_COLUMNS, SUN_STEP, TELEMETRY, UPDATES, Plant, Sensors, Slew, State, Tables
from simulator.mission_mode.state import ROTATION_NAMES as ROTATION_NAMES
from simulator.mission_mode.target_frame import compute_commanded_attitude
from simulator.mission_mode.wheels import build_wheel_pyramid
from simulator.sensors.sun import build_trmm_alignments
from simulator.streams import generator
from simulator.truth.orbit import compute_lvlh_rate
from simulator.truth.rotation import convert_to_quaternion
from simulator.truth.sun import compute_julian_date, compute_sun_vector

Event = OnBoardTables | YawManeuver | str  # an upload, the start of a maneuver, its "end", or the end of a "day"

COLDEST = "1998-01-15T00:00:00+00:00"  # when the horizon's season is at its largest
SECONDS_PER_HOUR = 3600.0
SLEW_NUMBERS = (
    *(f"pointing_{axis}_deg" for axis in ROTATION_NAMES),
    *(f"targeting_{axis}_deg" for axis in ROTATION_NAMES),
    "bias_yaw_deg_h",
)


@dataclass(frozen=True)
class MissionRun:
    """Tables of a run; angles in degrees."""

    # every so many cycles: t_s, error_*_deg and estimate_*_deg of roll, pitch, yaw, bias_yaw_deg_h on board, wheel_*_nms
    # (momentum), quadrants used by the Earth sensor, normal (0 from a yaw maneuver's start to the next update), raw_*_deg_s
    # (gyro's rate over the cycle before), angle_*_deg (penetration angles before the table's biases)
    telemetry: pd.DataFrame
    # a row a yaw update: t_s, sensor (1, 2), update_deg, bias_deg_h (new), bias_solved (whether it was solved for),
    # measured_deg, error_yaw_deg (true), forward ("+x", "-x"), sun_angle_deg (Sun's angle from the body's XZ plane toward −Y)
    updates: pd.DataFrame
    # a row a yaw maneuver: start_s, stop_s, forward after it; pointing_*_deg, the true error at its end; targeting_*_deg, true
    # minus propagated by gyro from the true attitude at its start; bias_yaw_deg_h at its start
    slews: pd.DataFrame
    # a row an orbit, over its cycles in normal pointing (NaN without): t_s of its start, forward, samples, lost (cycles not in
    # normal pointing), rms_error_*_deg, rms_knowledge_*_deg, largest_error_*_deg, largest_knowledge_*_deg, jitter_*_deg
    # (largest peak to peak over 1 s), apparent_bias_*_deg_h (mean of ω − G ω_raw, the bias that an attitude solution would
    # find), momentum_nms and wheel_nms (largest of the wheels together and of one), moment_am2 (largest of a torquer),
    # three_quadrants (share of cycles)
    orbits: pd.DataFrame


def simulate_mission(
    config: MissionConfig,
    *,
    days: float | None = None,
    seconds: float | None = None,
    seed: int = 0,
    telemetry_every: int | None = 120,
    progress: Callable[[int], None] | None = None,
) -> MissionRun:
    """Simulate a run from its epoch.

    A `ValueError` if not one of days and seconds is given, nothing is to be flown, or a yaw maneuver starts within another one.

    Parameters
    ----------
    config : of the run
    days, seconds : how long; one of them
    seed : of the noise; one seed gives one run, and uploads do not change what is drawn
    telemetry_every : cycles from one row of telemetry to the next; None for no telemetry
    progress : told after each whole day flown that it is one more; changes nothing else
    """
    if (days is None) == (seconds is None):
        raise ValueError("give days or seconds, not both")
    span = seconds if seconds is not None else DAY * (days or 0.0)
    cycle_s = config.controller.cycle_s
    cycles = round(span / cycle_s)
    if cycles < 1 or (telemetry_every is not None and telemetry_every < 1):
        raise ValueError("the time and telemetry_every must be positive")
    stops = [maneuver.start_s + maneuver.duration_s for maneuver in config.maneuvers]
    if any(later.start_s < stop for later, stop in zip(config.maneuvers[1:], stops[:-1], strict=True)):
        raise ValueError("a yaw maneuver starts within another one, or they are not in order")
    every = telemetry_every or cycles + 1
    telemetry = np.full((0 if telemetry_every is None else -(-cycles // every), len(TELEMETRY)), np.nan)
    return _Flight(config, cycles, seed).fly(every, telemetry, progress)


def build_flight_schedule(config: MissionConfig, days: float) -> MissionConfig:
    """Schedule R's uploads on their days, and a yaw maneuver whenever the Sun crosses the orbit plane, for some days.

    Alignment on December 11, the gyro and DSS coefficients on February 27, 1998. A maneuver is centred on its crossing.
    """
    start = compute_julian_date(config.epoch)
    dates = [(compute_julian_date(date) - start) * DAY for date in ("1997-12-11T12:00:00+00:00", "1998-02-27T12:00:00+00:00")]
    moments = find_plane_crossings(config.epoch, config.orbit, days)
    standard = YawManeuver(0.0)
    maneuvers = tuple(replace(standard, start_s=float(t) - 0.5 * standard.duration_s) for t in moments)
    forward: Forward = "+x" if compute_sun_angle(config.epoch, config.orbit, 0.0) > 0 else "-x"
    uploads = tuple(zip(dates, build_uploads(config), strict=True))
    return replace(config, uploads=uploads, maneuvers=maneuvers, forward=forward)


class _Flight:
    """A run under way."""

    def __init__(self, config: MissionConfig, cycles: int, seed: int):
        self.config, self.cycles = config, cycles
        self.cycle_s = config.controller.cycle_s
        self.rng, self.extra = generator(seed, 0, "mission_mode"), generator(seed, 0, "mission_effects")
        self.wander = generator(seed, 0, "mission_walk")
        orbits = int((cycles - 1) * self.cycle_s / config.orbit.period) + 1
        self.plant = _build_plant(config, cycles * self.cycle_s)
        self.orbits = np.zeros((orbits, ORBIT_COLUMNS))
        self.updates = np.empty((2 * orbits + 4, len(UPDATES)))
        self.tables = config.tables
        self.forward = config.forward
        self.state = _build_initial_state(config, self.extra)

    def fly(self, every: int, telemetry: Array, progress: Callable[[int], None] | None) -> MissionRun:
        """Fly from event to event; telemetry (rows, 21) gets a row every so many cycles."""
        slew, updates, cycle, bias = self._build_resting_slew(), 0, 0, 0.0
        slews: list[dict[str, float | str]] = []
        for event_cycle, event in [*self._list_events(progress is not None), (self.cycles, None)]:
            sensors = _build_flight_sensors(self.config, self.tables)
            tables = _build_tables(self.config, self.tables)
            streams, outputs = (self.rng, self.extra, self.wander), (every, telemetry, self.updates, updates, self.orbits)
            updates = fly(*streams, cycle, event_cycle, self.plant, sensors, tables, slew, self.state, *outputs)
            cycle = event_cycle
            if event == "day" and progress is not None:
                progress(1)
            elif isinstance(event, OnBoardTables):
                self.tables = event
                if event.bias is not None:
                    self.state.bias[:] = event.bias
            elif isinstance(event, YawManeuver):
                bias = float(self.state.bias[2])
                angle = np.pi if self.forward == "+x" else -np.pi  # N: +180° from +x to −x, −180° back
                slew = Slew(slew.yaw, angle, event.start_s, event.duration_s, event.ramp_fraction)
            elif event == "end":
                self.forward = "-x" if self.forward == "+x" else "+x"
                slews.append(self._tabulate_slew(slew, bias))
                slew = self._build_resting_slew()
        table = pd.DataFrame(slews, columns=["start_s", "stop_s", "forward", *SLEW_NUMBERS])
        return MissionRun(_tabulate(telemetry, TELEMETRY), self._tabulate_updates(updates), table, self._tabulate_orbits())

    def _list_events(self, daily: bool) -> list[tuple[int, Event]]:
        """List events in order, each with the cycle before which it takes place; without maneuvers that end after the run."""
        events: list[tuple[int, Event]] = [(int(np.ceil(t_s / self.cycle_s)), tables) for t_s, tables in self.config.uploads]
        for maneuver in self.config.maneuvers:
            # A cycle before the start, where the true error is noted, and one after the end.
            start = int(np.floor(maneuver.start_s / self.cycle_s))
            stop = int(np.floor((maneuver.start_s + maneuver.duration_s) / self.cycle_s)) + 1
            if stop <= self.cycles:
                events += [(start, maneuver), (stop, "end")]
        day = round(DAY / self.cycle_s)
        events += [(k, "day") for k in range(day, self.cycles, day) if daily]
        return sorted(((max(cycle, 0), event) for cycle, event in events if cycle < self.cycles), key=lambda entry: entry[0])

    def _build_resting_slew(self) -> Slew:
        return Slew(0.0 if self.forward == "+x" else np.pi, 0.0, 0.0, 0.0, 0.5)

    def _tabulate_slew(self, slew: Slew, bias: float) -> dict[str, float | str]:
        """Tabulate errors at a slew's end: of pointing, and of targeting, pointing less the error propagated by gyro alone."""
        error = self.state.past[0]
        targeting = np.rad2deg(error - self.state.probe)
        return {
            "start_s": slew.start,
            "stop_s": slew.start + slew.duration,
            "forward": self.forward,
            **{f"pointing_{axis}_deg": value for axis, value in zip(ROTATION_NAMES, np.rad2deg(error), strict=True)},
            **{f"targeting_{axis}_deg": value for axis, value in zip(ROTATION_NAMES, targeting, strict=True)},
            "bias_yaw_deg_h": np.rad2deg(bias) * SECONDS_PER_HOUR,
        }

    def _tabulate_updates(self, count: int) -> pd.DataFrame:
        table = _tabulate(self.updates[:count], UPDATES).astype({"sensor": int, "bias_solved": bool})
        forward = self._find_forward_axis(table["t_s"].to_numpy())
        beta = np.rad2deg(compute_sun_angle(self.config.epoch, self.config.orbit, table["t_s"].to_numpy()))
        return table.assign(forward=forward, sun_angle_deg=np.where(forward == "+x", beta, -beta))

    def _tabulate_orbits(self) -> pd.DataFrame:
        rows = self.orbits
        samples = np.where(rows[:, 0] > 0, rows[:, 0], np.nan)
        start = self.config.orbit.period * np.arange(len(rows), dtype=float)
        forward = self._find_forward_axis(start)
        table: dict[str, object] = {"t_s": start, "forward": forward, "samples": rows[:, 0], "lost": rows[:, 1]}
        for i, axis in enumerate(ROTATION_NAMES):
            table[f"rms_error_{axis}_deg"] = np.rad2deg(np.sqrt(rows[:, 2 + i] / samples))
            table[f"rms_knowledge_{axis}_deg"] = np.rad2deg(np.sqrt(rows[:, 5 + i] / samples))
            for name, column in (("largest_error", 8), ("largest_knowledge", 11), ("jitter", 14)):
                table[f"{name}_{axis}_deg"] = np.rad2deg(np.where(samples > 0, rows[:, column + i], np.nan))
            table[f"apparent_bias_{axis}_deg_h"] = np.rad2deg(rows[:, 17 + i] / samples) * SECONDS_PER_HOUR
        table |= {"momentum_nms": rows[:, 20], "wheel_nms": rows[:, 21], "moment_am2": rows[:, 22]}
        return pd.DataFrame({**table, "three_quadrants": rows[:, 23] / samples})

    def _find_forward_axis(self, t: NDArray[np.floating]) -> NDArray[np.str_]:
        """Find the axis along the velocity at times t, a maneuver counting from its middle."""
        finished = [
            maneuver
            for maneuver in self.config.maneuvers
            if maneuver.start_s + maneuver.duration_s < self.cycles * self.cycle_s
        ]
        swaps = np.searchsorted([maneuver.start_s + 0.5 * maneuver.duration_s for maneuver in finished], t)
        return np.where((swaps + (self.config.forward == "-x")) % 2 == 0, "+x", "-x")


def _tabulate(values: Array, names: tuple[str, ...]) -> pd.DataFrame:
    """Tabulate values in radians and seconds, in the units of their columns' names."""
    table = pd.DataFrame(values, columns=list(names))
    for name in names:
        if name.endswith(("_deg", "_deg_s", "_deg_h")):
            table[name] = np.rad2deg(table[name]) * (SECONDS_PER_HOUR if name.endswith("_h") else 1.0)
    return table


def _build_plant(config: MissionConfig, span: float) -> Plant:
    body, orbit = config.spacecraft, config.orbit
    axes = build_wheel_pyramid(body.elevation)
    start = compute_julian_date(config.epoch)
    moments = np.arange(0.0, span + 2 * SUN_STEP, SUN_STEP)
    inclination_on_board = orbit.inclination + config.ephemeris.inclination
    return Plant(
        dt=config.controller.cycle_s,
        body=body,
        inverse=np.asarray(np.linalg.inv(body.inertia)),
        axes=axes,
        distribution=np.ascontiguousarray(np.linalg.pinv(axes)),
        gradient=3 * orbit.mean_motion**2,
        latitude_argument=orbit.latitude_argument,
        mean_motion=orbit.mean_motion,
        node=orbit.node,
        nodal_rate=orbit.nodal_rate,
        cos_i=float(np.cos(orbit.inclination)),
        sin_i=float(np.sin(orbit.inclination)),
        on_board=np.array([config.ephemeris.node, np.cos(inclination_on_board), np.sin(inclination_on_board)]),
        radius=orbit.radius,
        sidereal=compute_sidereal_angle(start),
        sun=np.ascontiguousarray(compute_sun_vector(start + moments / DAY)),
    )


def _build_flight_sensors(config: MissionConfig, tables: OnBoardTables) -> Sensors:
    gyro, cycle_s, sun_sensors = config.gyro, config.controller.cycle_s, config.sun_sensors
    earth = replace(config.earth_sensor, s_filter=tables.s_filter)
    return Sensors(
        inverse_G=np.asarray(np.linalg.inv(gyro.G)),
        gyro_sigma=gyro.arw / float(np.sqrt(cycle_s)),
        walk_sigma=np.broadcast_to(np.asarray(gyro.rrw, dtype=float), 3) * np.sqrt(cycle_s),
        magnetometer_sigma=config.magnetometer_sigma,
        earth=earth.constants,
        earth_gain=earth.gain(cycle_s),
        horizon_keep=float(np.exp(-cycle_s / config.horizon.time_constant_s)),
        horizon_sigma=config.horizon.sigma,
        horizon_season=config.horizon.season,
        season_phase=YEARLY * (compute_julian_date(config.epoch) - compute_julian_date(COLDEST)) * DAY,
        alignments=np.stack([sensor.alignment for sensor in sun_sensors]),
        heads=np.stack([sensor.head for sensor in sun_sensors]),
        a=np.stack([sensor.coefficients_alpha for sensor in sun_sensors]),
        b=np.stack([sensor.coefficients_beta for sensor in sun_sensors]),
        half_fov=np.array([sensor.half_fov for sensor in sun_sensors]),
        noise=np.array([sensor.noise for sensor in sun_sensors]),
    )


def _build_tables(config: MissionConfig, tables: OnBoardTables) -> Tables:
    law = config.controller
    stiffness = law.inertia * law.bandwidth**2
    return Tables(
        G=np.ascontiguousarray(tables.G, dtype=float),
        penetration_biases=np.asarray(tables.penetration_biases, dtype=float),
        alignments=np.ascontiguousarray(np.stack(build_trmm_alignments(*config.boresights)) @ tables.misalignments),
        a=np.ascontiguousarray(tables.coefficients_alpha),
        b=np.ascontiguousarray(tables.coefficients_beta),
        inertia=np.asarray(law.inertia, dtype=float),
        proportional=stiffness,
        derivative=2 * law.damping * law.inertia * law.bandwidth,
        integral=stiffness / law.integral_s,
        integral_limit=law.integral_limit,
        bias_gain=law.bias_gain,
        unloading=law.unloading,
    )


def _build_initial_state(config: MissionConfig, rng: np.random.Generator) -> State:
    """Build the state on the commanded frame and turning with it, the wheels at rest, the estimate right."""
    cycle_s, orbit = config.controller.cycle_s, config.orbit
    yaw = 0.0 if config.forward == "+x" else np.pi
    before, now = compute_commanded_attitude(orbit, np.array([-cycle_s, 0.0]), yaw)
    rate = compute_lvlh_rate(orbit, np.zeros(1))[0] * np.array([np.cos(yaw), np.cos(yaw), 1.0])
    bias = np.zeros(3) if config.tables.bias is None else config.tables.bias
    return State(
        q=convert_to_quaternion(now),
        omega=rate,
        wheels=np.zeros(4),
        true_bias=np.array(config.gyro.bias, dtype=float),
        body_turn=rate * cycle_s,
        frame=before,
        frame_turn=rate * cycle_s,
        estimate=np.zeros(3),
        probe=np.zeros(3),
        integral=np.zeros(3),
        bias=np.array(bias, dtype=float),
        s_filter=np.full(4, np.nan),
        quadrants=np.ones(4, dtype=np.bool_),
        horizon=config.horizon.sigma * rng.standard_normal(4) if config.horizon.sigma > 0 else np.zeros(4),
        past=np.zeros((max(1, math.floor(1.0 / cycle_s + 1e-9)), 3)),
        memory=np.array([0.0, NEVER, 0.0, 0.0]),
    )
