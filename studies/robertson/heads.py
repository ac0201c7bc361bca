"""R's sun sensors: a head that is not at right angles was mistaken for a misalignment of DSS-2.

TRMM's yaw updates were too large after launch. The alignment calibration, which uses orthogonal matrices only, gave DSS-2 the
matrix R (3). The remaining error was traced to alignment records: the β heads of both sensors were not at right angles to the
α heads. R (3) is the result of an orthogonal fit, not the true mounting. The simulated months therefore have R's heads, and the
misalignment and biases for which an orthogonal fit gives R (3) and R's penetration biases. A diagnosis whose M0 has none of
these effects is computed, with three results:

(a) the misfit under M0;
(b) the misfit that an orthogonal misalignment with penetration biases, the calibration of the first upload, leaves on days it
    was not fitted to, and its evidence against an explanation with the heads;
(c) the causes that the diagnosis names, how often they are right, and the misfit left on held-out days.

Further truths: the heads alone, for which an orthogonal matrix gives DSS-2 a misalignment; the misalignment alone, which must
then be named; each other effect of the sensors; two effects outside the library, an α head of DSS-2 whose transfer function has
another scale and an Earth sensor with more noise than stated; and nominal sensors, for which nothing may be named.

The floor is 1 to half a percent: the sun sensors' sigma of 0.0056 deg is a round figure for 0.005 deg of noise and a count's
quantisation, of 0.00554 deg together.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pandas as pd
from scipy.stats import chi2

from diagnosis.inference.amplitudes import FittedEffect, fit
from diagnosis.inference.closure import compute_closure
from diagnosis.inference.search import Search
from diagnosis.model.sensors.arcs import build_arcs, fit_arcs
from diagnosis.model.sensors.columns import HeldAmplitudes
from diagnosis.model.sensors.tables import build_sensor_model, build_tables
from diagnosis.sensor_tables import ExplainedTables, decide_sensor_verdict, explain_tables, list_solved_for, relinearise_tables
from diagnosis.settings import DEFAULT
from gyrocal.arrays import Array
from gyrocal.recording import Recording
from simulator.effects import Setting
from simulator.effects.sensor import SENSOR_EFFECTS, parse
from simulator.scenario import Scenario
from simulator.sensors.raw_tables import simulate_sensor_tables
from simulator.sensors.suite import SensorSuite
from simulator.simulate import observe
from studies.montecarlo.study import Row, Streams, Study, StudyConfig, dispersed, load_base_scenario, simulate_case_motion
from studies.report.checks import Check, bound_above
from studies.report.entry import Entry, Report
from studies.report.tables import Table, summarise_groups

TRUE_HEAD_EFFECTS = (
    "dss_head:1=0.08056,e1_deg=0.044,e2_deg=-0.008,e3_deg=0.067",
    "dss_head:2=0.28156,e1_deg=0.206,e2_deg=0.061,e3_deg=0.182",
)
ALIGNMENT = (
    "dss_misalignment=0.22475,m_x_deg=-0.15648,m_y_deg=-0.11411,m_z_deg=0.11402",
    "esa_bias=0.19681,bias_1_deg=-0.1574,bias_2_deg=0.04635,bias_3_deg=-0.09414,bias_4_deg=-0.05382",
)
ORTHOGONAL = list_solved_for(tuple(SENSOR_EFFECTS.values()))  # parameters of the first upload's calibration
HEAD_NEWTON_STEPS = 3  # steps; the second leaves 1e-5 deg
STORY: Mapping[str, tuple[str, ...]] = {
    "R": TRUE_HEAD_EFFECTS,  # and the results of `solve_further_truth`
    "heads": TRUE_HEAD_EFFECTS,
    "misalignment": ALIGNMENT[:1],
    "nominal": (),
}
OTHER_EFFECT_SETS: Mapping[str, tuple[str, ...]] = {
    "biases": ALIGNMENT[1:],
    "S filter": ("esa_s_filter=0.74",),
    "Sun intrusion": ("esa_sun_intrusion=1",),
    "geocentric nadir": ("esa_nadir=1",),
}
SCALE, NOISE = 3e-3, 1.5  # of the α head's counts, and of the Earth sensor's noise; on no list
LISTED_SENSOR_EFFECTS = tuple(SENSOR_EFFECTS.values())
CORRECT_ANSWER_NOTE = "Right is to name every effect that is there and no other, and to call what is on no list unknown."
R3 = "R's truth is the misalignment and biases of which, beside the heads, an orthogonal calibration finds R (3)."
LABELS = {"before": "nominal sensors", "orthogonal": "orthogonal misalignment and biases", "after": "what is named"}


class StoryConfig(StudyConfig):
    """Configuration of the study."""

    cases: int = 20
    scenario: str | Scenario = "trmm_months"


def _scale_alpha_counts(suite: SensorSuite) -> SensorSuite:
    """Scale the transfer function of the α head of DSS-2."""
    first, second = suite.sun_sensors
    coefficients = second.coefficients_alpha * np.array([1 + SCALE, 1 + SCALE, *np.ones(7)])
    return replace(suite, sun_sensors=(first, replace(second, coefficients_alpha=coefficients)))


def _scale_earth_noise(suite: SensorSuite) -> SensorSuite:
    assert suite.earth is not None
    return replace(suite, earth=replace(suite.earth, sigma=NOISE * suite.earth.sigma))


UNLISTED_CHANGES: Mapping[str, Callable[[SensorSuite], SensorSuite]] = {
    "transfer function": _scale_alpha_counts,
    "noise": _scale_earth_noise,
}
TRUTHS = (*STORY, *OTHER_EFFECT_SETS, *UNLISTED_CHANGES)


def list_true_settings(truth: str, scenario: Scenario) -> tuple[Setting, ...]:
    """List the listed effects of a truth; none if it is nominal or outside the library."""
    stated = tuple(parse(text) for text in {**STORY, **OTHER_EFFECT_SETS}.get(truth, ()))
    return (*stated, *solve_further_truth(scenario)) if truth == "R" else stated


@lru_cache(maxsize=2)
def solve_further_truth(scenario: Scenario) -> tuple[Setting, ...]:
    """Solve for the misalignment and biases that an orthogonal fit, with R's heads present, estimates as R's values.

    The heads alone already look like a misalignment, so that a fit does not give R (3) if R (3) is added to them. The fit is
    nearly linear in the true amplitudes x: x ← x + (wanted − fitted), from x = wanted, on tables without noise.
    """
    settings = [parse(text) for text in ALIGNMENT]
    wanted = true_amplitudes = [compute_sensor_amplitudes(setting) for setting in settings]
    for _ in range(HEAD_NEWTON_STEPS):
        effects = map(_replace_amplitudes, settings, true_amplitudes)
        fitted = fit_orthogonal_calibration(scenario, [*map(parse, TRUE_HEAD_EFFECTS), *effects])
        estimates = [fitted[setting.effect] for setting in settings]
        true_amplitudes = [x + goal - estimate for x, goal, estimate in zip(true_amplitudes, wanted, estimates, strict=True)]
    return tuple(map(_replace_amplitudes, settings, true_amplitudes))


def fit_orthogonal_calibration(scenario: Scenario, effects: Sequence[Setting]) -> dict[str, Array]:
    """Fit orthogonal matrices and biases alone to noise-free tables; errors in deg, by effect."""
    motion = simulate_case_motion(scenario)
    plain = observe(scenario, motion, gyro_rng=None, reference_rng=None)
    arcs, _ = build_arcs(replace(plain, sensors=simulate_sensor_tables(scenario, motion, effects, noise=False)))
    fits, _, _ = fit_arcs(arcs)
    solved = tuple(SENSOR_EFFECTS[name] for name in ORTHOGONAL)
    model = build_sensor_model(build_tables(fits, solved), solved, DEFAULT)
    for _ in range(2):  # the second time linearised about the first fit
        best = Search(model).find_explanation(ORTHOGONAL)
        assert best is not None
        fitted = fit(model, best.members)
        held = {effect.label: HeldAmplitudes(effect.amplitudes, effect.parameters) for effect in fitted}
        relinearised = relinearise_tables(fits, solved, held, DEFAULT)
        model = relinearised if relinearised is not None else model
    return {effect.effect: effect.amplitudes for effect in fitted}


def compute_sensor_amplitudes(setting: Setting) -> Array:
    """Compute the linear amplitudes of an effect on the sensors."""
    return SENSOR_EFFECTS[setting.effect].amplitudes(setting)


def _replace_amplitudes(like: Setting, amplitudes: Array) -> Setting:
    """Return the same effect with other amplitudes."""
    size, parameters = SENSOR_EFFECTS[like.effect].from_amplitudes(amplitudes)
    return replace(like, size=size, parameters=parameters)


def record_truth(config: StoryConfig, case: int, streams: Streams, truth: str = "R") -> Recording:
    """Simulate the recording of one case under a truth; noise is the same under all of them."""
    scenario = dispersed(config, case)
    motion = simulate_case_motion(scenario)
    gyro_rng, reference_rng = streams.generator("gyro_noise"), streams.generator("reference_noise")
    effects, change = list_true_settings(truth, load_base_scenario(config)), UNLISTED_CHANGES.get(truth)
    tables = simulate_sensor_tables(scenario, motion, effects, streams.entropy, streams.case, change=change)
    return replace(observe(scenario, motion, gyro_rng=gyro_rng, reference_rng=reference_rng), sensors=tables)


def run_case(config: StoryConfig, number: int, streams: Streams) -> Sequence[Row]:
    """Simulate the sensor tables under each truth and diagnose them; one row per truth."""
    base = load_base_scenario(config)
    rows = []
    for truth in TRUTHS:
        explained = explain_tables(record_truth(config, number, streams, truth), LISTED_SENSOR_EFFECTS, seed=number)
        rows.append(_build_truth_row(truth, list_true_settings(truth, base), explained))
    return rows


def _build_truth_row(truth: str, effects: Sequence[Setting], explained: ExplainedTables) -> dict[str, object]:
    """Build the row of a diagnosis under a truth: verdict, misfits, evidence, and fitted amplitudes with sigmas."""
    true = {setting.label() for setting in effects}
    inference = explained.inference
    attribution = inference.attribution
    named = {effect.label for effect in inference.fitted}
    orthogonal_explanation = Search(explained.scaled_model).find_explanation(ORTHOGONAL)
    assert orthogonal_explanation is not None
    orthogonal_closure = compute_closure(explained.scaled_model, orthogonal_explanation.members)
    assert orthogonal_closure is not None
    after = inference.closed.after if inference.closed is not None else orthogonal_closure.before
    best = attribution.best if attribution is not None else None
    verdict, _ = decide_sensor_verdict(explained)
    row: dict[str, object] = {
        "truth": truth,
        "verdict": verdict,
        "named": " + ".join(sorted(named)),
        "right": named == true and verdict == ("unknown" if truth in UNLISTED_CHANGES else "named" if true else "none"),
        "wrong": len(named - true),
        "probability": min((slot.probability for slot in attribution.slots), default=np.nan) if attribution else np.nan,
        "p_value": inference.p_value,
        "dof": explained.linear.dof,
        "before": orthogonal_closure.before,
        "orthogonal": orthogonal_closure.after,
        "after": after,
        "orthogonal_p": float(chi2.sf(orthogonal_closure.after * explained.linear.dof, explained.linear.dof)),
        "after_p": float(chi2.sf(after * explained.linear.dof, explained.linear.dof)),
        "log_ratio": best.log_evidence - orthogonal_explanation.log_evidence if best is not None else np.nan,
    }
    for effect in inference.fitted:
        row |= _list_amplitudes(effect.label, effect)
    for effect in fit(explained.scaled_model, orthogonal_explanation.members):
        row |= _list_amplitudes(f"orthogonal {effect.label}", effect)
    return row


def _list_amplitudes(label: str, effect: FittedEffect) -> dict[str, object]:
    row: dict[str, object] = {}
    for k, (amplitude, sigma) in enumerate(zip(effect.amplitudes, effect.sigmas, strict=True)):
        row |= {f"{label} {k} found": float(amplitude), f"{label} {k} sigma": float(sigma)}
    return row


def report(config: StoryConfig, rows: pd.DataFrame) -> Report:
    """Build checks and tables."""
    tables = {
        "verdicts": Table("What is named", count_verdicts(rows)),
        "gaps": Table("Held-out mean square of the residuals in sigmas; 1 is the floor", average_gaps(rows)),
    }
    return Report(tables, checks=build_head_checks(rows))


def count_verdicts(rows: pd.DataFrame) -> pd.DataFrame:
    """Count the verdicts by truth."""

    def line(cases: pd.DataFrame) -> dict[str, object]:
        verdicts = {"group": "group", "unknown": "unknown", "no gap": "none"}
        with_heads = cases["truth"].iloc[0] in ("R", "heads")
        return {
            "cases": len(cases),
            "all named, and nothing else": int(cases["right"].sum()),
            "a wrong name": int((cases["wrong"] > 0).sum()),
            **{name: int((cases["verdict"] == verdict).sum()) for name, verdict in verdicts.items()},
            "least probability": cases["probability"].min(),
            "evidence against orthogonal, least ln B": cases["log_ratio"].min() if with_heads else np.nan,
        }

    return summarise_groups(rows, ["truth"], line)


def average_gaps(rows: pd.DataFrame) -> pd.DataFrame:
    """Average the misfit on held-out days over the cases, with the scatter of a case."""

    def line(cases: pd.DataFrame) -> dict[str, object]:
        return {
            **{label: cases[name].mean() for name, label in LABELS.items()},
            "floor": 1.0,
            "one sigma of a case": float(np.sqrt(2 / cases["dof"].mean())),
            "orthogonal: largest p": cases["orthogonal_p"].max(),
            "named: least p": cases["after_p"].min(),
        }

    return summarise_groups(rows, ["truth"], line)


def build_head_checks(rows: pd.DataFrame) -> tuple[Check, ...]:
    """Build the checks of the study."""
    groups = {
        "R's heads, misalignment and biases": ["R"],
        "turned heads alone": ["heads"],
        "a true misalignment": ["misalignment"],
        "another effect of the sensors": list(OTHER_EFFECT_SETS),
        "an effect on no list": list(UNLISTED_CHANGES),
    }
    heads, nominal = (rows[rows["truth"] == truth] for truth in ("heads", "nominal"))
    shares = {name: float(rows.loc[rows["truth"].isin(truths), "right"].mean()) for name, truths in groups.items()}
    apparent_deg = float(np.linalg.norm([heads[f"orthogonal dss_misalignment {k} found"].mean() for k in range(3)]))
    r_cases = rows[rows["truth"] == "R"]
    differences = [
        r_cases[f"orthogonal {setting.effect} {k} found"].mean() - value
        for setting in map(parse, ALIGNMENT if len(r_cases) else ())
        for k, value in enumerate(compute_sensor_amplitudes(setting))
    ]
    difference_deg = np.abs(differences).max(initial=0.0)
    return (
        *(Check(f"share of right answers, {name}", share, meaning=CORRECT_ANSWER_NOTE) for name, share in shares.items()),
        Check("misalignment that an orthogonal calibration makes of heads alone", apparent_deg, unit="deg"),
        Check("what it makes of R's truth, less R (3) and R's biases", difference_deg, bound_above(0.005), "deg", R3),
        Check("false alarms with nominal sensors", float((nominal["verdict"] != "none").sum()), unit=f"of {len(nominal)}"),
        Check("diagnoses with a wrong name", float((rows["wrong"] > 0).sum()), bound_above(0), f"of {len(rows)}"),
    )


STUDY = Study("studies.robertson.heads:STUDY", StoryConfig, run_case, record_truth)
ENTRY = Entry(STUDY, "R's sun sensor heads: diagnosed from simulated months, against an orthogonal misalignment", report)
