"""Effects seen in the samples: their smallest visible sizes follow from the tests that the diagnosis makes of the samples.

Each effect knows how its size goes with the thresholds of those tests (`simulator.effects.Effect.smallest`), which are in
`diagnosis.detectors`. One that gives no size of its own changes the readings themselves, and shows in the attitude.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from diagnosis.detectors import clipping, number_format, outliers, reference_noise, sample_noise, spectral_lines
from diagnosis.model.recording_model import RecordingModel
from diagnosis.plan.result import Verdict, Visible
from diagnosis.plan.settings import SETTINGS
from diagnosis.plan.visibility import build_visibility_row
from diagnosis.settings import DEFAULT
from simulator.effects import Effect, SampleTests, setting
from simulator.scenario import Scenario, build_profiles


def count_quiet_samples(scenario: Scenario) -> tuple[int, ...]:
    """Gyro samples in each arc outside slews and transitions and clear of their edges."""
    out = []
    for profile in build_profiles(scenario):
        edges = [0.0, *(t for span in sorted(profile.moving_spans) for t in span), profile.stop_s - profile.start_s]
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            out.append(max(int((end - begin) / scenario.gyro.sample_s) - 2 * sample_noise.SETTINGS.half, 0))
    return tuple(out)


def build_sample_tests(scenario: Scenario) -> SampleTests:
    """The tests of the diagnosis, on the samples of a scenario."""
    quiet = count_quiet_samples(scenario)
    return SampleTests(
        power=SETTINGS.power,
        quiet=quiet,
        event_p=DEFAULT.sample_event,
        correlated=reference_noise.SETTINGS.correlated,
        line_p=DEFAULT.line,
        lowest_line_hz=spectral_lines.SETTINGS.fewest_cycles / (max([1, *quiet]) * scenario.gyro.sample_s),
        outlier_sigma=outliers.SETTINGS.limit,
        fewest_clipped=clipping.SETTINGS.fewest_clipped,
        coarse=number_format.SETTINGS.coarse,
        fewest_references=reference_noise.SETTINGS.fewest,
        reference_p=DEFAULT.sample_event,
        trimming=reference_noise.SETTINGS.trimming,
    )


def list_sample_sizes(scenario: Scenario, model: RecordingModel, effects: Sequence[Effect], snr: float) -> Iterator[Visible]:
    """Smallest visible sizes of those of some effects that show in the samples; snr is what the others need."""
    tests = build_sample_tests(scenario)
    for effect in effects:
        if not effect.in_samples or effect.missing(model.surroundings) is not None:
            continue
        found = effect.smallest(model.surroundings, tests)
        for one in found:
            verdict: Verdict = "visible" if np.isfinite(one.size) else "not identifiable"
            yield build_visibility_row(effect, verdict, one.size, one.text, "samples", one.axis)
        if not found and effect.implements("apply"):
            yield from _find_attitude_sizes(effect, model, snr)


def _find_attitude_sizes(effect: Effect, model: RecordingModel, snr: float) -> Iterator[Visible]:
    """The size from which on what it does to the noise-free readings has the signal-to-noise ratio that other effects need."""
    sizes = np.geomspace(*effect.prior, SETTINGS.sizes)
    rng = np.random.default_rng(0)
    for axis in effect.axes or (None,):
        parameters = effect.draw(rng, model.surroundings)[1]
        trials = [setting(effect.name, axis, size, parameters) for size in sizes]
        changes = [effect.apply(rng, model.raw, model.stream, trial) - model.raw for trial in trials]
        norms = np.linalg.norm(model.whiten_and_project(model.reading(np.stack(changes, axis=2))), axis=0)
        seen = np.flatnonzero(norms >= snr)
        if seen.size:
            text = "from about here on by the rates that are missing or wrong"
            yield build_visibility_row(effect, "visible", float(sizes[seen[0]]), text, "attitude", axis)
        else:
            yield build_visibility_row(effect, "implausible", np.inf, "nothing of it shows in the attitude", "attitude", axis)
