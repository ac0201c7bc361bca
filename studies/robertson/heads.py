"""The story of R at the level of the sensors: a misalignment of DSS-2 that was a head not at right angles.

TRMM's yaw updates were too large after launch. The alignment calibration, which knows orthogonal matrices only, gave DSS-2 the
matrix R (3); what it left was traced to alignment records by which the β heads of both sensors were not at right angles to the
α heads. Here months are simulated with those heads, and with the misalignment and biases of which an orthogonal fit, heads and
all, finds R (3) and R's penetration biases; R (3) itself is what such a fit found, not how DSS-2 sat. A diagnosis whose M0 has
none of them is asked what is wrong:

(a) how large the gap is under M0;
(b) what an orthogonal misalignment with penetration biases, the calibration of the first upload, leaves of it on days it was
    not fitted to, and how much less likely it makes the data than an explanation with the heads;
(c) what the diagnosis names, how often rightly, and what is left on held-out days.

Beside it, truths of the heads alone, whose DSS-2 looks misaligned to an orthogonal matrix; of the misalignment alone, which is
then to be named; of each other effect of the sensors; of two discrepancies that are on no list, an α head of DSS-2 whose
transfer function has another scale and an Earth sensor with more noise than stated; and of nominal sensors, where nothing may
be named.

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
ORTHOGONAL = list_solved_for(tuple(SENSOR_EFFECTS.values()))  # what the calibration of the first upload solved for
HEAD_NEWTON_STEPS = 3  # steps; the second leaves 1e-5 deg
STORY: Mapping[str, tuple[str, ...]] = {
    "R": TRUE_HEAD_EFFECTS,  # and what `solve_further_truth` finds
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
    """Effects of a truth; none if it is nominal or on no list."""
    stated = tuple(parse(text) for text in {**STORY, **OTHER_EFFECT_SETS}.get(truth, ()))
    return (*stated, *solve_further_truth(scenario)) if truth == "R" else stated


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
        held = {one.label: HeldAmplitudes(one.amplitudes, one.parameters) for one in fitted}
        again = relinearise_tables(fits, solved, held, DEFAULT)
        model = again if again is not None else model
    return {one.effect: one.amplitudes for one in fitted}


def compute_sensor_amplitudes(setting: Setting) -> Array:
    """The linear amplitudes of an effect on the sensors."""
    return SENSOR_EFFECTS[setting.effect].amplitudes(setting)


def _replace_amplitudes(like: Setting, amplitudes: Array) -> Setting:
    """The same effect with other amplitudes."""
    size, parameters = SENSOR_EFFECTS[like.effect].from_amplitudes(amplitudes)
    return replace(like, size=size, parameters=parameters)


def record_truth(config: StoryConfig, case: int, streams: Streams, truth: str = "R") -> Recording:
    """The recording of one case under a truth; noise is the same under all of them."""
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
        seen = explain_tables(record_truth(config, number, streams, truth), LISTED_SENSOR_EFFECTS, seed=number)
        rows.append(_build_truth_row(truth, list_true_settings(truth, base), seen))
    return rows


def _build_truth_row(truth: str, effects: Sequence[Setting], seen: ExplainedTables) -> dict[str, object]:
    true = {setting.label() for setting in effects}
    found = seen.inference
    attribution = found.attribution
    named = {one.label for one in found.fitted}
    without = Search(seen.scaled_model).find_explanation(ORTHOGONAL)
    assert without is not None
    orthogonal = compute_closure(seen.scaled_model, without.members)
    assert orthogonal is not None
    after = found.closed.after if found.closed is not None else orthogonal.before
    best = attribution.best if attribution is not None else None
    said, _ = decide_sensor_verdict(seen)
    row: dict[str, object] = {
        "truth": truth,
        "verdict": said,
        "named": " + ".join(sorted(named)),
        "right": named == true and said == ("unknown" if truth in UNLISTED_CHANGES else "named" if true else "none"),
        "wrong": len(named - true),
        "probability": min((slot.probability for slot in attribution.slots), default=np.nan) if attribution else np.nan,
        "p_value": found.p_value,
        "dof": seen.linear.dof,
        "before": orthogonal.before,
        "orthogonal": orthogonal.after,
        "after": after,
        "orthogonal_p": float(chi2.sf(orthogonal.after * seen.linear.dof, seen.linear.dof)),
        "after_p": float(chi2.sf(after * seen.linear.dof, seen.linear.dof)),
        "log_ratio": best.log_evidence - without.log_evidence if best is not None else np.nan,
    }
    for one in found.fitted:
        row |= _list_amplitudes(one.label, one)
    for one in fit(seen.scaled_model, without.members):
        row |= _list_amplitudes(f"orthogonal {one.label}", one)
    return row


def _list_amplitudes(label: str, one: FittedEffect) -> dict[str, object]:
    pairs = enumerate(zip(one.amplitudes, one.sigmas, strict=True))
    return {
        f"{label} {k} {name}": float(value) for k, pair in pairs for name, value in zip(("found", "sigma"), pair, strict=True)
    }


def report(config: StoryConfig, rows: pd.DataFrame) -> Report:
    """Checks, tables and figures."""
    tables = {
        "verdicts": Table("What is named", count_verdicts(rows)),
        "gaps": Table("Held-out mean square of the residuals in sigmas; 1 is the floor", average_gaps(rows)),
    }
    return Report(tables, checks=build_head_checks(rows))


def count_verdicts(rows: pd.DataFrame) -> pd.DataFrame:
    """Counts of verdicts by truth."""

    def line(own: pd.DataFrame) -> dict[str, object]:
        verdicts = {"group": "group", "unknown": "unknown", "no gap": "none"}
        with_heads = own["truth"].iloc[0] in ("R", "heads")
        return {
            "cases": len(own),
            "all named, and nothing else": int(own["right"].sum()),
            "a wrong name": int((own["wrong"] > 0).sum()),
            **{name: int((own["verdict"] == verdict).sum()) for name, verdict in verdicts.items()},
            "least probability": own["probability"].min(),
            "evidence against orthogonal, least ln B": own["log_ratio"].min() if with_heads else np.nan,
        }

    return summarise_groups(rows, ["truth"], line)


def average_gaps(rows: pd.DataFrame) -> pd.DataFrame:
    """Means over the cases of the gap on held-out days, and what a case scatters by."""

    def line(own: pd.DataFrame) -> dict[str, object]:
        return {
            **{label: own[name].mean() for name, label in LABELS.items()},
            "floor": 1.0,
            "one sigma of a case": float(np.sqrt(2 / own["dof"].mean())),
            "orthogonal: largest p": own["orthogonal_p"].max(),
            "named: least p": own["after_p"].min(),
        }

    return summarise_groups(rows, ["truth"], line)


def build_head_checks(rows: pd.DataFrame) -> tuple[Check, ...]:
    """Build the checks of the study beside its tables."""
    groups = {
        "R's heads, misalignment and biases": ["R"],
        "turned heads alone": ["heads"],
        "a true misalignment": ["misalignment"],
        "another effect of the sensors": list(OTHER_EFFECT_SETS),
        "an effect on no list": list(UNLISTED_CHANGES),
    }
    heads, nominal = (rows[rows["truth"] == truth] for truth in ("heads", "nominal"))
    shares = {name: float(rows.loc[rows["truth"].isin(truths), "right"].mean()) for name, truths in groups.items()}
    misled = [heads[f"orthogonal dss_misalignment {k} found"].mean() for k in range(3)]
    ours = rows[rows["truth"] == "R"]
    off = [
        ours[f"orthogonal {one.effect} {k} found"].mean() - value
        for one in map(parse, ALIGNMENT if len(ours) else ())
        for k, value in enumerate(compute_sensor_amplitudes(one))
    ]
    return (
        *(Check(f"share of right answers, {name}", share, meaning=CORRECT_ANSWER_NOTE) for name, share in shares.items()),
        Check("misalignment that an orthogonal calibration makes of heads alone", float(np.linalg.norm(misled)), unit="deg"),
        Check(
            "what it makes of R's truth, less R (3) and R's biases", np.abs(off).max(initial=0.0), bound_above(0.005), "deg", R3
        ),
        Check("false alarms with nominal sensors", float((nominal["verdict"] != "none").sum()), unit=f"of {len(nominal)}"),
        Check("diagnoses with a wrong name", float((rows["wrong"] > 0).sum()), bound_above(0), f"of {len(rows)}"),
    )


STUDY = Study("studies.robertson.heads:STUDY", StoryConfig, run_case, record_truth)
ENTRY = Entry(STUDY, "R's sun sensor heads: diagnosed from simulated months, against an orthogonal misalignment", report)
