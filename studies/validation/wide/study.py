"""``gyrocal study wide``: is the diagnosis right about craft, gyros and effects that it was not made for?

    gyrocal study wide --set part=setting                 # the 150 fixed recordings for whoever sets thresholds
    gyrocal study wide --set part=scored --cases 2000     # what counts; a run that was stopped goes on

Any first cases have the shares of all (`studies.validation.wide.cases`). A row holds all that a score needs:

- ``kind`` (none, single, pair, unlisted), ``plan``, ``grade``; ``sample_s``, ``samples``, ``references``, ``spacing_s``
  (median), ``intervals``, ``sampled_s`` (all of them together), ``orbit``, ``temperature``, ``arw_deg_per_sqrt_s``,
  ``sigma_deg`` (mean)
- ``effects``: names and axes, joined by " + "; ``family``: of an unlisted effect, else ""
- ``snr``: the smallest evidence of the effects, ``separate_snr`` that of a pair with what the other explains taken out,
  ``novelty`` what no listed effect explains of an unlisted one; NaN where there is none
- ``attitude_snr``: of an unlisted effect, the evidence in the attitude alone
- ``truth``: JSON, a list of effects with ``effect, axis, size, unit, parameters, snr, separate_snr``
- ``verdict``, ``said`` (the causes as ``effects``), ``probability`` (of all causes together), ``unknown_probability``,
  ``p_value`` (of the gap)
- ``causes``: JSON, with ``effect, axis, size, unit, sigma, parameters, probability, group, group_probability`` of each
- ``p_values``, ``posterior``: JSON, as the diagnosis states them; ``answer``: JSON, its whole answer but for single windows
- ``exact``, ``in_group``, ``wrong_name``: as in `studies.validation.blind_check.score`
- ``outcome``: right, group, unknown, missed (no gap is seen), wrong name (one named at 0.9 or more that is not there, nor has
  the truth in its group), other; without effect right is that no gap is seen, and alarm otherwise; an unlisted effect has no
  right name
- ``size_sigmas``: JSON, (size − true size)/sigma of each cause that is there
- ``make_s``, ``diagnose_s``: processor time, s; these, and ``runtime_s`` in ``answer``, are all that differs from run to run
"""

import json
import time
from typing import Any

import numpy as np

from gyrocal.recording import Recording
from studies.montecarlo.files import plain
from studies.montecarlo.study import Streams, Study, StudyConfig
from studies.validation.blind_check.score import case_row, label
from studies.validation.wide.cases import Drawn, draw
from studies.validation.wide.diagnosing import diagnosed
from studies.validation.wide.split import PartName
from studies.validation.wide.world import Spec

CASES, ENTROPY = 150, 1962
CONFIDENT = 0.9
OUTCOMES = ("right", "group", "unknown", "missed", "wrong name", "alarm", "other")
SCORE_KINDS = {"single": "one", "pair": "two"}  # as the score of the blind check calls them


class WideConfig(StudyConfig):
    """Which part of the split: setting, for thresholds, or scored."""

    cases: int = CASES
    entropy: int = ENTROPY
    part: PartName = "setting"

    def spec(self) -> Spec:
        """What the drawing depends on."""
        return Spec(self.part, self.entropy)


def recording(config: WideConfig, number: int, streams: Streams) -> Recording:
    """The recording of one case."""
    return draw(config.spec(), number).recording()


def case(config: WideConfig, number: int, streams: Streams) -> dict[str, Any]:
    """Draw a case, diagnose its recording, and put both beside each other."""
    begun = time.process_time()
    drawn = draw(config.spec(), number)
    made = drawn.recording()
    drawn_at = time.process_time()
    found = diagnosed(made)
    row = described(drawn, number) | answered(drawn, number, found)
    return row | {"make_s": drawn_at - begun, "diagnose_s": time.process_time() - drawn_at}


def described(drawn: Drawn, number: int) -> dict[str, Any]:
    """What a case is."""
    plain_, world = drawn.world.plan.plain, drawn.world
    times = plain_.attitudes.t_s
    labels = [label(one.effect, one.axis) for one in drawn.settings]
    unlisted = drawn.kind == "unlisted"
    return {
        "kind": drawn.kind,
        "plan": world.kind,
        "grade": world.grade,
        "sample_s": plain_.gyro.sample_s,
        "samples": len(plain_.gyro.t_s),
        "references": len(times),
        "spacing_s": float(np.median(np.diff(times))),
        "intervals": len(plain_.intervals),
        "sampled_s": float(world.plan.motion.duration_s.sum()),
        "orbit": plain_.orbit is not None,
        "temperature": bool(plain_.tables),
        "arw_deg_per_sqrt_s": float(np.rad2deg(plain_.gyro.arw)),
        "sigma_deg": float(np.rad2deg(plain_.attitudes.sigma.mean())),
        "effects": " + ".join(labels),
        "family": drawn.settings[0].effect if unlisted else "",
        "snr": min(drawn.snr, default=float("nan")),
        "separate_snr": min(drawn.separate_snr, default=float("nan")),
        "attitude_snr": world.in_attitude(drawn.settings[0]) if unlisted else float("nan"),
        "novelty": drawn.novelty,
        "truth": json.dumps(plain(drawn.truth())),
    }


def answered(drawn: Drawn, number: int, found: dict[str, Any]) -> dict[str, Any]:
    """What the diagnosis says of it, and what becomes of that."""
    listed = drawn.kind in SCORE_KINDS
    answer = {
        "case": number,
        "kind": SCORE_KINDS.get(drawn.kind, drawn.kind),
        "effects": drawn.truth() if listed else [],
        "unlisted": None,
        "true_G": drawn.world.plan.G.tolist(),
    }
    scored = case_row(answer, {"diagnosis": found, "error": ""})
    kept = {
        key: scored[key] for key in ("verdict", "said", "probability", "unknown_probability", "exact", "in_group", "wrong_name")
    }
    return kept | {
        "p_value": found["gap"]["p_value"],
        "causes": json.dumps(found["causes"]),
        "p_values": json.dumps(found["p_values"]),
        "posterior": json.dumps(found["posterior"]),
        "answer": json.dumps(found),
        "outcome": outcome(drawn.kind, scored, found),
        "size_sigmas": json.dumps(scored["size_sigmas"]),
    }


def outcome(kind: str, scored: dict[str, Any], found: dict[str, Any]) -> str:
    """What becomes of a case, see the module."""
    if kind == "none":
        return "alarm" if scored["present"] else "right"
    if not scored["present"]:
        return "missed"
    if scored["verdict"] == "unknown":
        return "unknown"
    if scored["exact"]:
        return "right"
    if scored["in_group"] or (kind == "unlisted" and scored["verdict"] == "group"):
        return "group"
    confident = scored["wrong_name"] and any(cause["probability"] >= CONFIDENT for cause in found["causes"])
    return "wrong name" if confident else "other"


STUDY = Study("studies.validation.wide.study:STUDY", WideConfig, case, recording)
