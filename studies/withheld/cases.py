"""A case of ``gyrocal study withheld``: drawn by the entropy and its number, diagnosed, and tabulated as a row."""

import json
import time
from typing import Any

import numpy as np
from pydantic import Field

from diagnosis.diagnose import diagnose
from diagnosis.inference.conformal import compute_scores
from diagnosis.result import Diagnosis
from gyrocal.recording import Recording
from simulator.effects import EFFECTS
from studies.montecarlo.files import convert_to_plain
from studies.montecarlo.study import Streams, Study, StudyConfig
from studies.peak_memory import read_peak_memory_mb, reset_peak_memory
from studies.withheld.drawing import DrawnCase, draw_case
from studies.withheld.judgement import decide_outcome, judge_causes, list_size_errors, measure_true_share, score_truth


class WithheldConfig(StudyConfig):
    """Configuration: the cases to draw, and the table of another run that the report compares."""

    cases: int = 400
    entropy: int = 20261128
    compare: str = Field(default="", exclude=True)  # path of its table.parquet; no part of the study's identity


def make_recording(config: WithheldConfig, number: int, streams: Streams) -> Recording:
    """Simulate the recording of a case."""
    drawn = draw_case(config.entropy, number)
    return drawn.world.record(drawn.settings)


def run_case(config: WithheldConfig, number: int, streams: Streams) -> dict[str, Any]:
    """Draw a case, diagnose its recording, and return the row of both."""
    begun_s = time.process_time()
    drawn = draw_case(config.entropy, number)
    recording = drawn.world.record(drawn.settings)
    made_s = time.process_time()
    reset_peak_memory()
    answer = diagnose(recording, library=drawn.allowed_names)
    cost = {"make_s": made_s - begun_s, "diagnose_s": time.process_time() - made_s, "peak_mb": read_peak_memory_mb()}
    return describe_case(drawn) | describe_answer(drawn, answer) | cost


def describe_case(drawn: DrawnCase) -> dict[str, Any]:
    """Describe the simulated effects, plan and gyro: columns of a row."""
    plain, truth = drawn.world.plan.plain, []
    for effect in drawn.effects:
        setting = effect.setting
        described = {"effect": setting.effect, "axis": setting.axis, "size": setting.size}
        ratios = {"snr_attitude": effect.attitude, "snr_samples": effect.samples, "snr": effect.snr}
        listed = setting.effect in (EFFECTS if drawn.allowed_names is None else drawn.allowed_names)
        truth.append(described | {"parameters": dict(setting.parameters), "listed": listed} | ratios)
    return {
        "kind": drawn.kind,
        "plan": drawn.world.plan.kind,
        "grade": drawn.world.plan.grade,
        "samples": len(plain.gyro.t_s),
        "references": len(plain.attitudes.t_s),
        "effects": " + ".join(setting.label() for setting in drawn.settings),
        "snr": min((effect.snr for effect in drawn.effects), default=np.nan),
        "snr_attitude": min((effect.attitude for effect in drawn.effects), default=np.nan),
        "snr_samples": min((effect.samples for effect in drawn.effects), default=np.nan),
        "truth": json.dumps(convert_to_plain(truth)),
    }


def describe_answer(drawn: DrawnCase, diagnosis: Diagnosis) -> dict[str, Any]:
    """Describe the answer and judge it: columns of a row."""
    answer = diagnosis.to_json()
    verdict, causes = answer["verdict"], answer["causes"]
    present = bool(answer["gap"]["present"])
    judged = judge_causes(drawn, causes)
    closure = answer.get("closure") or {}
    low, high = closure.get("interval_90") or (np.nan, np.nan)
    hits = {hit for cause in judged for hit in cause["hits"]}
    return {
        "verdict": verdict,
        "said": " + ".join(cause["cause"] for cause in judged),
        "outcome": decide_outcome(drawn.kind, present, len(drawn.effects), judged, verdict),
        "found": sum(drawn.effects[hit].setting.effect in EFFECTS for hit in hits),
        "statements": json.dumps(convert_to_plain(judged)),
        "truth_score": score_truth(drawn, compute_scores(diagnosis.posterior)),
        "unknown_probability": answer["unknown_probability"],
        "p_value": answer["gap"]["p_value"],
        "size_sigmas": json.dumps(list_size_errors(drawn, causes)),
        "closed": closure.get("closed", np.nan),
        "closed_low": low,
        "closed_high": high,
        "true_closed": measure_true_share(drawn, diagnosis.details) if closure and drawn.effects else np.nan,
    }


STUDY = Study("studies.withheld.cases:STUDY", WithheldConfig, run_case, make_recording)
