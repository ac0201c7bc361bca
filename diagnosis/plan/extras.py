"""Extra maneuvers: intervals after the scenario's end, and how much each would improve the visible sizes.

The SNR that the statistic needs hardly depends on the plan, so the smallest visible size goes as 1/‖x‖, and for a random
effect, whose mean square counts twice, as (tr K²)^(−1/4).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from diagnosis.arrays import AXES
from diagnosis.model.recording_model import RecordingModel
from diagnosis.model.steps import step_times
from diagnosis.plan.columns import Signature, build_signatures, find_median_index, linearise_noise_free
from diagnosis.plan.result import SETTINGS, Extra, Pair, Visible, order_pair
from diagnosis.plan.separability import list_pairs
from simulator.effects import EFFECTS
from simulator.scenario import Scenario, override

DAY = 86400.0


def append_intervals(scenario: Scenario, sections: Sequence[Mapping[str, Any]]) -> Scenario:
    """Append intervals to a scenario; their start_s and stop_s count from its end.

    An `InputError` if these are no valid intervals.
    """
    end = scenario.interval[-1].stop_s
    intervals = [interval.model_dump(mode="json", exclude_none=True) for interval in scenario.interval]
    for section in sections:
        moved = dict(section)
        for name in ("start_s", "stop_s"):
            if isinstance(moved.get(name), int | float):
                moved[name] = float(moved[name]) + end
        intervals.append(moved)
    return override(scenario, {"interval": intervals})


def list_maneuvers(scenario: Scenario) -> dict[str, list[dict[str, Any]]]:
    """List the built-in extra maneuvers, an orbit after the scenario's end; times count from its end."""
    orbit = float(scenario.orbit.build_circular_orbit().period)
    orbit = round(orbit / scenario.gyro.sample_s) * scenario.gyro.sample_s
    start = SETTINGS.gap_orbits * orbit

    def build_maneuver(activity: str, mode: str, length: float, **more: Any) -> list[dict[str, Any]]:
        name = _find_unused_name("extra", {interval.name for interval in scenario.interval})
        return [{"name": name, "activity": activity, "start_s": start, "stop_s": start + length, "mode": mode, **more}]

    maneuvers = {
        "+x forward, one orbit (-1 RPO about y)": build_maneuver("+x forward", "+x", orbit),
        "-x forward, one orbit (+1 RPO about y)": build_maneuver("-x forward", "-x", orbit),
        "+y forward, one orbit": build_maneuver("+y forward", "+y", orbit),
        "pitch turn, one orbit (-2 RPO about y)": build_maneuver(
            "pitch turn", "+x", orbit, slew=[_build_slew("y", -360, 60, orbit - 120)]
        ),
        "inertial hold, one orbit": build_maneuver(
            "inertial hold", "+x", orbit, hold={"start_s": 6.0, "stop_s": orbit - 6.0, "transition_s": 31.0}
        ),
        "yaw +180 deg": build_maneuver("yaw slew", "+x", 1000.0, slew=[_build_slew("z", 180, 60, 800)]),
        "yaw -180 deg": build_maneuver("yaw slew", "-x", 1000.0, slew=[_build_slew("z", -180, 60, 800)]),
    }
    for name, axis in (("roll", "x"), ("pitch", "y")):
        there_and_back = [_build_slew(axis, 60, 60, 280), _build_slew(axis, -60, 640, 280)]
        maneuvers[f"{name} +60 deg and back"] = build_maneuver(f"{name} slews", "+x", 1000.0, slew=there_and_back)
    shift_s, repeat = 30 * DAY - scenario.interval[0].start_s, []
    names = {interval.name for interval in scenario.interval}
    for interval in scenario.interval:
        section = interval.model_dump(mode="json", exclude_none=True)
        section |= {"start_s": section["start_s"] + shift_s, "stop_s": section["stop_s"] + shift_s}
        section["name"] = _find_unused_name(f"{section['name']}b", names)
        names.add(section["name"])
        repeat.append(section)
    maneuvers["the whole plan again, a month later"] = repeat
    return maneuvers


def _build_slew(axis: str, angle: float, start: float, duration: float) -> dict[str, Any]:
    along = [float(axis == name) for name in AXES]
    return {
        "axis": along,
        "angle_deg": float(angle),
        "start_s": float(start),
        "duration_s": float(duration),
        "ramp_fraction": 0.1,
    }


def _find_unused_name(name: str, used: set[str]) -> str:
    while name in used:
        name += "b"
    return name


def evaluate_extra(
    name: str,
    scenario: Scenario,
    extended: Scenario,
    model: RecordingModel,
    signatures: Sequence[Signature],
    visible: Sequence[Visible],
    pairs: Sequence[Pair],
) -> Extra:
    """Evaluate the extended scenario: sizes, pairs distinguished, and effects gained over those found without it."""
    model_with_extra = linearise_noise_free(extended)
    names = [name for name in EFFECTS if name in {signature.effect for signature in signatures}]
    # The same steps as without it: the extra intervals come after all of them.
    after = {signature.label: signature for signature in build_signatures(model_with_extra, names, step_times(model))}
    before = {size.label: size for size in visible}
    ratio: dict[str, float] = {}
    bare = replace(model.surroundings, stream=replace(model.stream, housekeeping={}))
    for signature in signatures:
        # Effects of temperature do not compare: the simulated temperature of a longer span differs.
        if EFFECTS[signature.effect].missing(bare) is None and signature.share.max() > SETTINGS.gone:
            quotients = signature.norms / np.maximum(after[signature.label].norms, 1e-300)
            ratio[signature.label] = float(quotients[find_median_index(quotients, signature.weights)])
    gained = [
        signature.label
        for signature in signatures
        if not signature.process
        and before[signature.label].verdict != "visible"
        and after[signature.label].extremes[1] * EFFECTS[signature.effect].prior[1] >= SETTINGS.snr
        and after[signature.label].share.max() > SETTINGS.gone
    ]
    visible_with_extra = [
        replace(size, size=size.size * ratio.get(size.label, 1.0), best=size.best * ratio.get(size.label, 1.0))
        for size in visible
    ]
    pairs_after = {order_pair(pair.effect, pair.other) for pair in list_pairs(list(after.values()), visible_with_extra)}
    pairs_before = {order_pair(pair.effect, pair.other) for pair in pairs}
    by_effect: dict[str, list[float]] = {}
    for label, value in ratio.items():
        if before[label].verdict == "visible":
            by_effect.setdefault(before[label].effect, []).append(value)
    hours = sum(interval.stop_s - interval.start_s for interval in extended.interval[len(scenario.interval) :]) / 3600
    median = float(np.median([np.median(values) for values in by_effect.values()])) if by_effect else 1.0
    shown = {label: value for label, value in ratio.items() if before[label].verdict == "visible" or label in gained}
    return Extra(name, hours, median, shown, tuple(sorted(pairs_before - pairs_after)), len(pairs_before), tuple(gained))
