"""Effects of the library that cases draw, and the distributions of their parameters."""

from collections.abc import Callable

import numpy as np

from simulator.effects import Surroundings
from simulator.effects.base import Value
from simulator.effects.common import measure_reference_arc
from studies.withheld.plans import log_uniform

Draw = Callable[[np.random.Generator, Surroundings], Value]


def draw_phase(rng: np.random.Generator, around: Surroundings) -> Value:
    """Draw a phase, deg."""
    return float(rng.uniform(-180.0, 180.0))


def draw_time(rng: np.random.Generator, around: Surroundings) -> Value:
    """Draw the time of a step, s: inside an interval, or in three of ten cases the middle of a gap."""
    stream = around.stream
    begin, end = np.array([stream.t_s[[part.start, part.stop - 1]] for part in stream.intervals]).T
    if rng.random() < 0.7 or len(begin) == 1:
        chosen = int(rng.choice(len(begin), p=(end - begin) / (end - begin).sum()))
        return float(begin[chosen] + rng.uniform(0.15, 0.85) * (end - begin)[chosen])
    gap = int(rng.integers(len(begin) - 1))
    return float(0.5 * (end[gap] + begin[gap + 1]))


def draw_over_arc(spacings: float, arcs: float) -> Draw:
    """Build a draw of a time from some spacings of the references to a share of the longest interval, s."""

    def draw(rng: np.random.Generator, around: Surroundings) -> Value:
        spacing, arc = measure_reference_arc(around)
        return log_uniform(rng, spacings * spacing, max(arcs * arc, 1.1 * spacings * spacing))

    return draw


def choose(*words: str) -> Draw:
    """Build a draw of one of some words."""
    return lambda rng, around: str(rng.choice(words))


def between(low: float, high: float) -> Draw:
    """Build a draw of a number uniform in its logarithm."""
    return lambda rng, around: log_uniform(rng, low, high)


PERIOD, TIME_CONSTANT = draw_over_arc(3.0, 1.5), draw_over_arc(2.0, 1 / 3)
TOWARD = choose("x", "y", "z")
LISTED: dict[str, dict[str, Draw]] = {  # effects that are drawn, of those that a diagnosis may name, and their parameters
    "bias_drift": {},
    "bias_step": {"time_s": draw_time},
    "bias_orbital": {"phase_deg": draw_phase},
    "bias_periodic": {"period_s": PERIOD, "phase_deg": draw_phase},
    "bias_temperature": {},
    "bias_random_walk": {"gaps": choose("hold", "reset")},
    "bias_markov": {"time_constant_s": TIME_CONSTANT},
    "noise_flicker": {},
    "noise_excess": {},
    "noise_angle_white": {},
    "scale_asymmetry": {},
    "scale_quadratic": {},
    "g_matrix_step": {"time_s": draw_time, "toward": TOWARD},
    "g_matrix_temperature": {"toward": TOWARD},
    "time_offset": {},
    "clock_drift": {},
    "clock_slip": {"time_s": draw_time},
    "rate_lag": {},
    "rate_quantization": {},
    "rate_truncation": {},
    "rate_saturation": {},
    "spikes": {"fraction": between(2e-4, 3e-3)},
    "stale_samples": {"fraction": between(2e-3, 5e-2)},
    "reference_jump": {**dict.fromkeys(("e_x_deg", "e_y_deg", "e_z_deg"), draw_phase), "begin_s": draw_time},
    "reference_mode_offset": {"holds": choose("off", "on")},
    "reference_orbital": {"phase_deg": draw_phase},
    "reference_horizon": {"phase_deg": draw_phase},
    "reference_periodic": {"period_s": PERIOD, "phase_deg": draw_phase},
    "reference_correlated": {"time_constant_s": TIME_CONSTANT},
    "reference_noise_excess": {},
}
SIZES = {  # ranges that are narrower than the priors
    "noise_excess": (1.02, 10.0),
    "reference_noise_excess": (1.02, 10.0),
    "stale_samples": (1.0, 20.0),
}
