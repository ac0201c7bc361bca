"""Plans with several gyros, several star trackers or raw sensor tables, with one effect of one of the instruments or none.

The plans are scenarios of the simulator. Several gyros read K ω + c; what an effect adds to their readings is divided into a
body rate, whose evidence is that of any recording, and the parity, which no body rate makes. The parity is white noise of the
stated ARW in each of its channels, and takes up a constant and three columns of the rate, as K and c do:

    readings = K ω + c + noise,    parity = Pᵀ readings,    Pᵀ K = 0,    Pᵀ P = 1

Raw sensor tables hold the effects whose sizes R and the sensors' data sheets make plausible; their evidence is not computed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.optimize import brentq

from gyrocal.errors import InputError
from gyrocal.recording import Recording, triad
from simulator import scenario as scenarios
from simulator.effects import ARRAY_EFFECTS, EFFECTS, TRACKER_EFFECTS, Effect, Setting, setting
from simulator.effects.base import Array, Surroundings, Value
from simulator.effects.common import log_uniform
from simulator.effects.sensor import parse
from simulator.scenario import Scenario
from simulator.sensors.raw_tables import simulate_sensor_tables
from simulator.simulate import (
    add_effects_and_noise,
    add_gyro_temperature,
    build_surroundings,
    compute_true_gyros,
    motion,
    observe,
)
from simulator.streams import generator
from simulator.truth.motion import Motion
from simulator.truth.rotation import separation
from studies.validation.world.evidence import Change, Evidence
from studies.validation.world.plans import Plan

INSTRUMENT_SNR = (8.0, 60.0)
MOST_EFFECT_DRAWS = 200  # draws of an effect
FAULTS = ("bias_step", "gyro_scale_step", "noise_excess", "gyro_dead")
OF_GYROS = {name: effect for name, effect in {**EFFECTS, **ARRAY_EFFECTS}.items() if name in FAULTS}
OF_SENSORS = (  # the last two: what an orthogonal alignment found in R (3), and R's penetration biases
    "dss_head:1=0.08,e1_deg=0.044,e2_deg=-0.008,e3_deg=0.067",
    "dss_head:2=0.28,e1_deg=0.206,e2_deg=0.061,e3_deg=0.182",
    "esa_s_filter=0.74",
    "esa_sun_intrusion=1",
    "esa_nadir=1",
    "dss_misalignment=0.22,m_x_deg=-0.156,m_y_deg=-0.114,m_z_deg=0.114",
    "esa_bias=0.197,bias_1_deg=-0.157,bias_2_deg=0.046,bias_3_deg=-0.094,bias_4_deg=-0.054",
)
SIZE_SPREAD = (0.7, 2.0)  # of sizes of the sensors' effects, as a factor


@dataclass(frozen=True)
class InstrumentChoice:
    """A plan: a scenario, what is changed in it, and the effects that one of its instruments may have."""

    scenario: str
    overrides: Mapping[str, Any]
    effects: Mapping[str, Effect] = field(default_factory=dict)


INSTRUMENT_PLANS = {
    "six_gyros": InstrumentChoice("trmm_six", {"reference.every_s": 1200.0}, OF_GYROS),
    "six_gyros_alone": InstrumentChoice("trmm_six", {"reference.at": "none"}, OF_GYROS),
    "four_gyros": InstrumentChoice("trmm_tetrahedron", {"reference.every_s": 1200.0}, OF_GYROS),
    "two_trackers": InstrumentChoice("agile_trackers", {"gyro.sample_s": 1.0}, TRACKER_EFFECTS),
    "two_dense_trackers": InstrumentChoice(
        "agile_trackers", {"gyro.sample_s": 1.0, "reference.every_s": 10.0}, TRACKER_EFFECTS
    ),
    "raw_sensors": InstrumentChoice("trmm_months", {}),
}


@dataclass(frozen=True)
class InstrumentPlan:
    """A plan without noise, and what makes evidence of its changes.

    Attributes
    ----------
    scenario, motion, plain : the plan, its truth and its noise-free recording
    around : the truth as effects see it
    evidence : of body rates and references; None without references
    K : (n, 3) what the gyros read of the body rate; None of a triad
    """

    scenario: Scenario
    motion: Motion
    plain: Recording
    around: Surroundings
    evidence: Evidence | None
    K: Array | None

    def recording(self, settings: list[Setting], seed: int, case: int, noise: bool = True) -> Recording:
        """Make the plan's recording with effects."""
        rngs = [generator(seed, case, f"{name}_noise") if noise else None for name in ("gyro", "reference")]
        return add_effects_and_noise(self.plain, self.motion, settings, rngs[0], rngs[1], seed, case, around=self.around)

    def strength(self, one: Setting, seed: int, case: int) -> float:
        """Compute √Δχ² of an effect: the norm of its whitened change that no calibration takes up."""
        shown = self.recording([one], seed, case, noise=False)
        raw = shown.gyro.rates - self.plain.gyro.rates
        moved = separation(self.plain.attitudes.quaternions, shown.attitudes.quaternions) if self.evidence else np.zeros((0, 3))
        body = raw if self.K is None else raw @ np.linalg.pinv(self.K).T
        seen = [self.evidence.attitude(Change(body, moved))] if self.evidence else []
        if self.K is not None:
            seen.append(self._parity(raw))
        return float(np.linalg.norm(np.concatenate(seen)))

    def _parity(self, raw: Array) -> Array:
        """Compute the whitened change (n · channels,) of the parity that a calibration does not take up."""
        assert self.K is not None
        P = np.linalg.svd(self.K)[0][:, 3:]
        columns = np.column_stack([self.motion.rates, np.ones(len(raw))])
        basis, _ = np.linalg.qr(columns)
        change = raw @ P / (self.plain.gyro.arw / np.sqrt(self.plain.gyro.sample_s))
        return np.asarray(change - basis @ (basis.T @ change)).ravel()


@lru_cache(maxsize=len(INSTRUMENT_PLANS))
def build_instrument_plan(name: str) -> InstrumentPlan:
    """Build a plan by its name."""
    chosen = INSTRUMENT_PLANS[name]
    scenario = scenarios.override(scenarios.load(chosen.scenario), dict(chosen.overrides))
    truth = motion(scenario)
    plain = add_gyro_temperature(observe(scenario, truth, gyro_rng=None, reference_rng=None))
    around, K, evidence = build_surroundings(plain, truth), None, None
    if plain.is_array:
        K, _ = compute_true_gyros(scenario)
    if plain.attitudes.t_s.size and scenario.sensors is None:
        evidence = Evidence(_build_body_plan(scenario, truth, plain))
    return InstrumentPlan(scenario, truth, plain, around, evidence, K)


def _build_body_plan(scenario: Scenario, truth: Motion, plain: Recording) -> Plan:
    """Make the plan of the body rates, with each tracker's own references and the frame of its noise."""
    at = replace(truth, reference_t_s=plain.attitudes.t_s, quaternions=plain.attitudes.quaternions)
    trackers = build_surroundings(plain, truth).references.trackers
    if plain.is_array:
        return Plan(at, triad(plain, *compute_true_gyros(scenario)), np.eye(3), np.zeros(3))
    G, b = np.array(scenario.gyro.true_G), np.deg2rad(scenario.gyro.true_bias_deg_s)
    return Plan(at, plain, G, b, None if trackers is None else trackers.to_axes)


@dataclass(frozen=True)
class DrawnInstrument:
    """A case: its plan, its effect if it has one, its evidence (NaN where it is not computed), and the recording."""

    plan: str
    setting: Setting | None
    snr: float
    recording: Recording


def draw_instrument(entropy: int, case: int) -> DrawnInstrument:
    """Draw a case; plans take turns, and every fourth round of them has no effect.

    Raises
    ------
    InputError
        No draw reaches the evidence with a plausible size.
    """
    turn, place = divmod(case, len(INSTRUMENT_PLANS))
    name = list(INSTRUMENT_PLANS)[place]
    bench, rng = build_instrument_plan(name), generator(entropy, case, "world:instruments")
    quiet = turn % 4 == 3
    if bench.scenario.sensors is not None:
        one = None if quiet else _draw_sensor_setting(turn, rng)
        plain = bench.recording([], entropy, case)
        tables = simulate_sensor_tables(bench.scenario, bench.motion, [one] if one else [], entropy, case)
        return DrawnInstrument(name, one, np.nan, replace(plain, sensors=tables))
    drawn = None if quiet else _draw_instrument_setting(bench, INSTRUMENT_PLANS[name].effects, turn, rng, entropy, case)
    settings = [drawn[0]] if drawn else []
    made = bench.recording(settings, entropy, case)
    return DrawnInstrument(name, drawn[0] if drawn else None, drawn[1] if drawn else np.nan, made)


def _draw_sensor_setting(turn: int, rng: np.random.Generator) -> Setting:
    one = parse(OF_SENSORS[(turn - turn // 4) % len(OF_SENSORS)])
    factor = log_uniform(rng, *SIZE_SPREAD)
    scaled = {key: value * factor if key.endswith("_deg") else value for key, value in one.parameters.items()}  # type: ignore[operator]
    return replace(one, size=one.size * factor, parameters=scaled)


def _draw_instrument_setting(
    bench: InstrumentPlan, effects: Mapping[str, Effect], turn: int, rng: np.random.Generator, entropy: int, case: int
) -> tuple[Setting, float]:
    """Draw an effect of one gyro or tracker with a size at which it shows as strongly as is wanted."""
    effect = list(effects.values())[(turn - turn // 4) % len(effects)]
    names = bench.plain.gyro.names if bench.plain.is_array else tuple(one.name for one in bench.plain.attitudes.sensors)
    if effect.name == "tracker_misalignment":
        names = names[1:]  # the first one defines the body's axes
    for _ in range(MOST_EFFECT_DRAWS):
        name, target = str(rng.choice(names)), log_uniform(rng, *INSTRUMENT_SNR)
        if effect.implements("noise_factor"):
            return setting(effect.name, name, _solve_noise_factor(bench, name, target)), target
        one = effect.completed(setting(effect.name, name, *_draw_small_setting(effect, bench, name, rng)))
        snr = bench.strength(one, entropy, case)
        if effect.name == "gyro_dead":
            if snr >= INSTRUMENT_SNR[0]:
                return one, snr
            continue
        factor = target / snr if snr > 0 else np.inf
        if abs(one.size) * factor <= effect.prior[1]:
            size, held = effect.from_amplitudes(factor * effect.amplitudes(one))
            made = replace(one, size=size, parameters={**one.parameters, **held})
            return made, bench.strength(made, entropy, case)
    raise InputError(
        f"case {case}: {effect.name} reaches no evidence of {INSTRUMENT_SNR[0]:g} to {INSTRUMENT_SNR[1]:g} "
        "with a plausible size"
    )


def _draw_small_setting(
    effect: Effect, bench: InstrumentPlan, name: str, rng: np.random.Generator
) -> tuple[float, dict[str, Value]]:
    """Draw a small size, and the other numbers; a dead gyro holds zero or what it read last."""
    _, parameters = effect.draw(rng, bench.around)
    for one in effect.parameters:
        if one.choices and "*" not in one.choices:
            parameters[one.name] = str(rng.choice(one.choices))
        elif one.name in {direction.name for direction in getattr(effect, "directions", ())}:
            parameters[one.name] = float(rng.normal())
    if effect.name != "gyro_dead":
        sign = 1.0 if effect.bounds[0] >= 0 else float(rng.choice([-1.0, 1.0]))
        return sign * effect.prior[0], parameters
    own = bench.plain.gyro.rates[:, bench.plain.gyro.names.index(name)]
    last = own[max(int(np.searchsorted(bench.motion.t_s, float(parameters["time_s"]))) - 1, 0)]
    return (float(np.rad2deg(last)) if rng.random() < 0.5 else 0.0), parameters


def _solve_noise_factor(bench: InstrumentPlan, name: str, target: float) -> float:
    """Find the factor f of white noise whose √(n (f² − 1 − ln f²)), twice the log likelihood ratio of n numbers, is given."""
    attitudes = bench.plain.attitudes
    count = len(bench.plain.gyro.t_s)
    if not bench.plain.is_array:
        count = 3 * int(np.sum(attitudes.sensor == [one.name for one in attitudes.sensors].index(name)))
    share = target**2 / count
    return float(np.sqrt(brentq(lambda v: v - 1 - np.log(v) - share, 1.0, 10.0 + 2 * share)))
