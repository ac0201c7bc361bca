"""What a diagnosis states of one drawn recording: sizes, closure, the set of explanations, the calibration, the false alarms.

Plans, effects and sizes are drawn as those of the blind check, on TRMM's orbit with a grade's noise, and every case has a plan
of its own. An effect that reaches no signal-to-noise ratio of the range on a plan is drawn again.
"""

import json
from functools import lru_cache

import numpy as np
import scipy.stats

from diagnosis.answer import Closure
from diagnosis.diagnose import diagnose
from diagnosis.inference import conformal
from diagnosis.inference.closure import of_response
from diagnosis.model.candidates import linear_model
from diagnosis.model.prepare import prepare
from diagnosis.result import Diagnosis
from diagnosis.settings import DEFAULT
from gyrocal import InputError
from gyrocal.recording import Recording
from simulator import scenario as scenarios
from simulator.streams import MAX_CASE
from studies.montecarlo.statistics import LEVELS
from studies.validation.blind_check.cases import Drawn, Spec, draw
from studies.validation.blind_check.score import case_row
from studies.validation.blind_check.steps import DIAGNOSIS_SEED
from studies.validation.promises.cases import Row, interval
from studies.validation.promises.plans import GRADES
from studies.validation.wide.score import posterior_of, truth_of

PLAN = "drawn"
TRIES = 40
MIX = (2, 5, 0, 1)  # of eight: without an effect, with one, and with an unlisted one
SNR = (8.0, 40.0)
SAMPLE_S = {"resonator": 0.5, "fibre optic": 1.0, "tactical": 2.0, "MEMS": 2.0}
EVERY_S = 120.0
LEVEL_90 = 0.9
WHOLE = 1.0  # closure that the right cause has on average
KIND = {"none": "none", "one": "single", "unlisted": "unlisted"}  # as the wide check calls them


def grade_of(turn: int) -> str:
    """Grade of a diagnosis by its number."""
    return list(GRADES)[turn % len(GRADES)]


@lru_cache(maxsize=8)
def _spec(entropy: int, grade: str) -> Spec:
    arw, sigma = GRADES[grade]
    values = {"gyro.sample_s": SAMPLE_S[grade], "reference.every_s": EVERY_S, "gyro.arw_deg_per_sqrt_s": arw}
    values |= {f"reference.sigma_deg.{k}": sigma for k in range(3)}
    base = scenarios.override(scenarios.load("trmm_series"), values)
    return Spec(entropy=entropy, cases=MAX_CASE, base=base, mix=MIX, snr=SNR, unlisted_snr=SNR)


def drawn(entropy: int, turn: int) -> Drawn:
    """The recording of a diagnosis.

    Raises
    ------
    InputError
        No draw reaches the strength asked for.
    """
    spec = _spec(entropy, grade_of(turn))
    for tries in range(TRIES):
        try:
            return draw(spec, turn * TRIES + tries)
        except InputError:
            continue
    raise InputError(f"diagnosis {turn}: none of {TRIES} draws reaches an SNR of {SNR[0]:g} with a plausible size")


def rows(entropy: int, turn: int) -> list[Row]:
    """What one diagnosis states, with whether it is so."""
    one = drawn(entropy, turn)
    recording = one.recording()
    found = diagnose(recording, seed=DIAGNOSIS_SEED)
    made = [*_sizes(one, found), *_set(one, found), *_calibration(one, found)]
    kind = one.answer["kind"]
    if kind == "none":
        made.append(interval("diagnose: no false alarm", 1 - found.false_alarm_rate, not found.present))
    if kind == "one" and found.closure is not None and _right(one, found):
        low, high = found.closure.interval_90
        made.append(interval("diagnose: closure, right cause", LEVEL_90, low <= WHOLE <= high))
    if kind == "one":
        reached = _reached(one, recording)
        if reached is not None:
            low, high = reached.interval_90
            made.append(interval("diagnose: closure, cause known", LEVEL_90, low <= WHOLE <= high))
    return [{"plan": PLAN, "grade": grade_of(turn), **row} for row in made]


def _reached(one: Drawn, recording: Recording) -> Closure | None:
    """The closure of what was put in; None of an effect in the samples alone, which has no response of the attitude."""
    if one.answer["effects"][0]["snr"] is None:
        return None
    model, response = prepare(recording).model, one.world.response(one.settings)
    if response.size != model.size:
        return None
    return of_response(linear_model(model, (), rivals=False), model.whitened(response))


def _scored(one: Drawn, found: Diagnosis) -> dict[str, object]:
    return case_row(one.answer, {"diagnosis": found.to_json(), "error": ""})


def _right(one: Drawn, found: Diagnosis) -> bool:
    row = _scored(one, found)
    return bool(row["exact"])


def _sizes(one: Drawn, found: Diagnosis) -> list[Row]:
    """Sizes of causes that are there, at one and at two sigma."""
    errors = np.array(_scored(one, found)["size_sigmas"], dtype=float)
    levels = [LEVELS["68"], LEVELS["95"]]
    return [
        interval("diagnose: size of a cause", level, abs(d) <= scipy.stats.norm.ppf(0.5 + level / 2))
        for d in errors
        for level in levels
    ]


def _set(one: Drawn, found: Diagnosis) -> list[Row]:
    effects = " + ".join(
        effect["effect"] if effect["axis"] is None else f"{effect['effect']}:{effect['axis']}"
        for effect in one.answer["effects"]
    )
    row = {"kind": KIND[one.answer["kind"]], "effects": effects, "posterior": json.dumps(found.to_json()["posterior"])}
    said = conformal.conformal_set(posterior_of(row), DEFAULT.conformal)
    return [interval("diagnose: conformal set", LEVEL_90, conformal.name_of(truth_of(row)) in said)]


def _calibration(one: Drawn, found: Diagnosis) -> list[Row]:
    """One of the twelve parameters, a different one from case to case, where the answer is right; the sigmas correlate."""
    right = found.verdict == "none" if one.answer["kind"] == "none" else one.answer["kind"] == "one" and _right(one, found)
    if not right:
        return []
    error = np.concatenate([(found.G - one.world.G).ravel(), found.bias - one.world.bias])
    sigma = np.concatenate([found.sigma_G.ravel(), found.sigma_bias])
    k = int(one.answer["case"]) % error.size
    return [
        interval(
            "diagnose: G and b with the cause in", level, abs(error[k]) <= scipy.stats.norm.ppf(0.5 + level / 2) * sigma[k]
        )
        for level in (LEVELS["68"], LEVELS["95"])
    ]
