"""``gyrocal study world``: is the diagnosis right about craft, gyros, references and effects of all kinds?

    gyrocal study world                                   # 150 recordings of what the diagnosis was developed with
    gyrocal study world --set source=exam/001 --cases 50  # of the families and plans of an exam

Any first cases have the shares of all (`studies.validation.world.cases`); ``instruments`` are cases of several gyros, star
trackers and raw sensor tables (`studies.validation.world.instruments`). A row holds all that a score needs:

- ``kind`` (none, single, pair, unlisted, mixed), ``plan``, ``grade``; ``sample_s``, ``samples``, ``references``,
  ``intervals``, ``orbit``, ``temperature``, ``arw_deg_per_sqrt_s``, ``sigma_deg`` (mean)
- ``effects``: names and axes, joined by " + "; ``family``: that outside the library, else ""
- ``snr``: the smallest evidence of the effects, ``separate_snr`` that of a pair with what the other explains taken out,
  ``novelty`` what no listed effect explains of one outside the library, ``attitude_snr`` its evidence in the attitude alone;
  NaN where there is none
- ``truth``: JSON, a list of effects with ``effect, axis, size, unit, parameters, snr, separate_snr, listed``
- ``verdict``, ``said`` (the causes as ``effects``), ``stated`` and ``stated_right`` (their number), ``probability`` (of all
  together), ``unknown_probability``, ``p_value``, ``closed`` with its 90 % interval, ``outcome``
  (`studies.validation.world.answers`)
- ``true_closed``: of a mixed recording with a gap budget, the share that its causes close in truth; else NaN
- ``causes``, ``posterior``: JSON, as the diagnosis states them
- ``size_sigmas``: JSON, (size − true size)/sigma of each cause that is there; ``calibration_sigmas``: the same of G and b
- ``make_s``, ``diagnose_s``: processor time, s; ``peak_mb`` of the diagnosis: these are all that differs from run to run
"""

import json
import time
from collections.abc import Collection
from typing import Any

import numpy as np

from diagnosis.budget import SETTINGS as BUDGET
from diagnosis.budget import predict_held_out
from diagnosis.model.prepare import prepare
from diagnosis.settings import DEFAULT
from gyrocal.recording import Recording
from simulator.effects import REGISTRY
from studies.montecarlo.files import convert_to_plain
from studies.montecarlo.study import Streams, Study, StudyConfig
from studies.validation.world.answers import (
    compute_calibration_errors,
    compute_size_errors,
    label_effect,
    merge_axes,
    score_answer,
)
from studies.validation.world.cases import DrawnCase, draw_world_case
from studies.validation.world.instruments import DrawnInstrument, draw_instrument
from studies.validation.world.timed_diagnosis import diagnose_timed
from studies.validation.world.world import Spec

CASES, ENTROPY = 150, 1962
INSTRUMENTS = "instruments"


class WorldConfig(StudyConfig):
    """What is drawn.

    Attributes
    ----------
    source : of the cases, see `studies.validation.world.sources`, or instruments
    keep_answer : whether a row has the whole answer, as JSON
    """

    cases: int = CASES
    entropy: int = ENTROPY
    source: str = "known"
    keep_answer: bool = False

    def part(self, number: int) -> tuple[str, int, int]:
        """Source, entropy and number of a case within them."""
        return self.source, self.entropy, number


def make_case_recording(config: WorldConfig, number: int, streams: Streams) -> Recording:
    """Make the recording of one case."""
    source, entropy, case = config.part(number)
    return (
        draw_instrument(entropy, case).recording
        if source == INSTRUMENTS
        else draw_world_case(Spec(source, entropy), case).recording()
    )


def run_case(config: WorldConfig, number: int, streams: Streams) -> dict[str, Any]:
    """Draw a case, diagnose its recording, and put both beside each other."""
    source, entropy, place = config.part(number)
    begun = time.process_time()
    drawn = draw_instrument(entropy, place) if source == INSTRUMENTS else draw_world_case(Spec(source, entropy), place)
    made = drawn.recording if isinstance(drawn, DrawnInstrument) else drawn.recording()
    about, truth = describe_case(drawn, made)
    make_s = time.process_time() - begun
    found = diagnose_timed(made)
    row = {
        "source": source,
        **about,
        "truth": json.dumps(convert_to_plain(truth)),
        **describe_answer(about["kind"], truth, found.answer),
    }
    errors: list[float] = []
    if isinstance(drawn, DrawnCase):
        errors = compute_calibration_errors(
            found.answer, drawn.world.plan.G.tolist(), np.rad2deg(drawn.world.plan.bias).tolist()
        )
    row["calibration_sigmas"] = json.dumps(errors)
    steps = {step["step"] for step in found.answer["budget"] if step["size"] is not None}
    stated = [name for cause in found.answer["causes"] if steps & set(cause["group"]) for name in cause["group"]]
    row["true_closed"] = float("nan")
    if isinstance(drawn, DrawnCase) and drawn.kind == "mixed" and stated:
        row["true_closed"] = measure_true_share(drawn, stated)
    if config.keep_answer:
        row["answer"] = json.dumps(convert_to_plain({key: value for key, value in found.answer.items() if key != "where"}))
    return row | {"make_s": make_s, "diagnose_s": found.cpu_s, "peak_mb": found.peak_mb}


def describe_case(drawn: DrawnCase | DrawnInstrument, made: Recording) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Describe a case by columns, and its truth."""
    if isinstance(drawn, DrawnInstrument):
        one, kind = drawn.setting, "single" if drawn.setting else "none"
        truth = [] if one is None else [_describe_instrument_truth(drawn)]
        about = {"kind": kind, "plan": drawn.plan, "grade": "", "snr": drawn.snr, "separate_snr": drawn.snr, "family": ""}
        about |= {"attitude_snr": float("nan"), "novelty": float("nan")}
    else:
        truth, world, outside = drawn.truth(), drawn.world, drawn.kind in ("unlisted", "mixed")
        about = {
            "kind": drawn.kind,
            "plan": world.kind,
            "grade": world.grade,
            "snr": min(drawn.snr, default=float("nan")),
            "separate_snr": min(drawn.separate_snr, default=float("nan")),
            "family": drawn.settings[-1].effect if outside else "",
            "attitude_snr": world.compute_attitude_evidence(drawn.settings[-1]) if outside else float("nan"),
            "novelty": drawn.novelty,
        }
    about |= {
        "effects": " + ".join(label_effect(one["effect"], one["axis"]) for one in truth),
        "sample_s": made.gyro.sample_s,
        "samples": len(made.gyro.t_s),
        "references": len(made.attitudes.t_s),
        "intervals": len(made.intervals),
        "orbit": made.orbit is not None,
        "temperature": bool(made.tables),
        "arw_deg_per_sqrt_s": float(np.rad2deg(made.gyro.arw)),
        "sigma_deg": float(np.rad2deg(made.attitudes.sigma.mean())) if len(made.attitudes.t_s) else float("nan"),
    }
    return about, truth


def _describe_instrument_truth(drawn: DrawnInstrument) -> dict[str, Any]:
    one = drawn.setting
    assert one is not None
    told = {"effect": one.effect, "axis": one.axis, "size": one.size, "unit": REGISTRY[one.effect].unit}
    return told | {"parameters": dict(one.parameters), "snr": drawn.snr, "separate_snr": drawn.snr, "listed": True}


def describe_answer(kind: str, truth: list[dict[str, Any]], found: dict[str, Any]) -> dict[str, Any]:
    """Describe an answer by columns, and what becomes of it."""
    return score_answer(kind, truth, found) | {
        "causes": json.dumps(convert_to_plain(found["causes"])),
        "posterior": json.dumps(convert_to_plain(found["posterior"])),
        "size_sigmas": json.dumps(compute_size_errors(merge_axes(found["causes"]), truth)),
    }


def measure_true_share(drawn: DrawnCase, stated: Collection[str]) -> float:
    """Measure the share that goes when the stated effects are taken out of the world, with all noise as it was.

    Parameters
    ----------
    drawn : the case
    stated : labels of the causes that an answer states; those that are not there close nothing
    """
    kept = [one for one in drawn.settings if not {label_effect(one.effect, one.axis), one.effect} & set(stated)]
    whole, left = (_measure_misfit(drawn.world.recording(settings)) for settings in (drawn.settings, kept))
    return (whole - left) / (whole - BUDGET.floor)


def _measure_misfit(recording: Recording) -> float:
    """Measure the whitened mean square of held-out errors under M0."""
    model = prepare(recording, DEFAULT, lambda text, share: None).model
    return float(predict_held_out(model, model, ()).misfit[0])


STUDY = Study("studies.validation.world.study:STUDY", WorldConfig, run_case, make_case_recording)
