"""The truth of which an orthogonal fit finds R (3): R's heads, and what must be there beside them.

R (3) is what a calibration found that takes the heads for square; how DSS-2 sat is another matter. What sat is solved for, so
that a fit of noise-free simulated tables, heads and all, gives R (3) and R's penetration biases.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from diagnosis.inference.amplitudes import FittedEffect, fit
from diagnosis.inference.search import Search
from diagnosis.model.sensors.arcs import build_arcs, fit_arcs
from diagnosis.model.sensors.columns import HeldAmplitudes
from diagnosis.model.sensors.orthogonal import list_solved_for
from diagnosis.model.sensors.tables import build_sensor_model, build_tables
from diagnosis.sensor_tables import relinearise_tables
from diagnosis.settings import DEFAULT
from simulator.effects import Setting
from simulator.effects.sensor import SENSOR_EFFECTS, parse
from simulator.scenario import Scenario
from simulator.sensors.raw_tables import simulate_sensor_tables
from simulator.simulate import observe
from studies.montecarlo.study import simulate_case_motion

Array = NDArray[np.float64]

TRUE_HEAD_EFFECTS = (
    "dss_head:1=0.08056,e1_deg=0.044,e2_deg=-0.008,e3_deg=0.067",
    "dss_head:2=0.28156,e1_deg=0.206,e2_deg=0.061,e3_deg=0.182",
)
ALIGNMENT = (
    "dss_misalignment=0.22475,m_x_deg=-0.15648,m_y_deg=-0.11411,m_z_deg=0.11402",
    "esa_bias=0.19681,bias_1_deg=-0.1574,bias_2_deg=0.04635,bias_3_deg=-0.09414,bias_4_deg=-0.05382",
)
ORTHOGONAL = list_solved_for(tuple(SENSOR_EFFECTS.values()))  # what the calibration of the first upload solved for
HEAD_NEWTON_STEPS = 3  # steps; the second leaves 1e-5 deg


@lru_cache(maxsize=2)
def solve_further_truth(scenario: Scenario) -> tuple[Setting, ...]:
    """Misalignment and biases of which, with R's heads, an orthogonal fit of a scenario finds R (3) and R's biases.

    The heads alone already look like a misalignment, so that R (3) put on top of them is found as something else. The fit is
    nearly linear in what is there: x ← x + (wanted − found), from x = wanted, on tables without noise.
    """
    wanted = [(parse(text), compute_sensor_amplitudes(parse(text))) for text in ALIGNMENT]
    put = [amplitudes for _, amplitudes in wanted]
    for _ in range(HEAD_NEWTON_STEPS):
        there = [_replace_amplitudes(one, x) for (one, _), x in zip(wanted, put, strict=True)]
        found = fit_orthogonal_calibration(scenario, [*map(parse, TRUE_HEAD_EFFECTS), *there])
        put = [x + goal - found[one.effect] for x, (one, goal) in zip(put, wanted, strict=True)]
    return tuple(_replace_amplitudes(one, x) for (one, _), x in zip(wanted, put, strict=True))


def fit_orthogonal_calibration(scenario: Scenario, effects: Sequence[Setting]) -> dict[str, Array]:
    """Fit orthogonal matrices and biases alone to noise-free tables; errors in deg, by effect."""
    motion = simulate_case_motion(scenario)
    plain = observe(scenario, motion, gyro_rng=None, reference_rng=None)
    arcs, _ = build_arcs(replace(plain, sensors=simulate_sensor_tables(scenario, motion, effects, noise=False)))
    fits, _, _ = fit_arcs(arcs)
    solved = tuple(SENSOR_EFFECTS[name] for name in ORTHOGONAL)
    model = build_sensor_model(build_tables(fits, solved), solved, DEFAULT)
    for _ in range(2):  # about what the first found
        best = Search(model).find_explanation(ORTHOGONAL)
        assert best is not None
        fitted = fit(model, best.members)
        again = relinearise_tables(fits, solved, collect_held_amplitudes(fitted), DEFAULT)
        model = again if again is not None else model
    return {one.effect: one.amplitudes for one in fitted}


def compute_sensor_amplitudes(setting: Setting) -> Array:
    """The linear amplitudes of an effect on the sensors."""
    effect = SENSOR_EFFECTS[setting.effect]
    return effect.amplitudes(setting)


def _replace_amplitudes(like: Setting, amplitudes: Array) -> Setting:
    """The same effect with other amplitudes."""
    size, parameters = SENSOR_EFFECTS[like.effect].from_amplitudes(amplitudes)
    return replace(like, size=size, parameters=parameters)


def collect_held_amplitudes(fitted: Sequence[FittedEffect]) -> dict[str, HeldAmplitudes]:
    """Amplitudes that a model is made about, by label."""
    return {one.label: HeldAmplitudes(one.amplitudes, one.parameters) for one in fitted}
