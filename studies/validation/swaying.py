"""Is motion taken for motion? Gyros at 50 to 200 Hz on bodies that really sway, seen by references at 1 or 10 Hz.

Each body sways about each axis by one or two sines of 0.05 to 5 deg/s at 0.05 to 2 Hz, for three minutes. Its gyro has white
noise of 0.0001 to 0.005 deg/√s, its references have 0.002 to 0.05 deg. Of the cases, the first have no effect, and any gap is
a false alarm; the others have a *vibration* of the gyro that no reference follows, a sine of 8 to 60 times the noise in all
samples, above the frequencies that the references resolve and below 0.45 of the sampling rate.

The truth is exact: a sample is the mean rate of its body, which turns at a constant rate within it.
"""

import json
from dataclasses import replace
from typing import Any, Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import model_validator
from scipy.spatial.transform import Rotation

from diagnosis.diagnose import diagnose
from gyrocal.recording import Recording
from simulator.effects import EFFECTS
from studies.montecarlo.statistics import binomial_interval
from studies.montecarlo.study import Streams, Study, StudyConfig
from studies.report.checks import Check, at_least, at_most
from studies.report.entry import Entry, Report
from studies.report.panels import Panel, sheet
from studies.report.tables import Table

Array = NDArray[np.float64]

SUMMARY = "Whether a body that really sways is told from a vibration of its gyro"
LONG_S = 180.0
SAMPLE_HZ, REFERENCE_HZ = (50, 100, 200), (1, 10)
SWAY_DEG_S, SWAY_HZ = (0.05, 5.0), (0.05, 2.0)
ARW_DEG, SIGMA_DEG = (1e-4, 5e-3), (2e-3, 5e-2)
SNR = (8.0, 60.0)
SLOWEST_HZ, FASTEST = 3.0, 0.45  # of a vibration, and its share of the sampling rate
OF_REFERENCES = 0.6  # of their rate: half of it is what they resolve
ALARMS, NAMED = 0.02, 0.95  # asked for
TONE = next((one.name for one in EFFECTS.values() if one.symptom == "spectral_line"), "none")


class SwayConfig(StudyConfig):
    """What is drawn.

    Attributes
    ----------
    cases : bodies without an effect, and those with a vibration after them
    vibrations : how many have one
    """

    cases: int = 140
    vibrations: int = 40

    @model_validator(mode="after")
    def _usable(self) -> Self:
        if self.overrides or self.dispersions:
            raise ValueError("bodies are drawn by the study itself; overrides and dispersions have no effect")
        if not 0 <= self.vibrations <= self.cases:
            raise ValueError(f"vibrations: {self.vibrations} are not among {self.cases} cases")
        return self


def case(config: SwayConfig, number: int, streams: Streams) -> dict[str, Any]:
    """One body, and what its diagnosis says."""
    made, row = _drawn(config, number, streams)
    found = diagnose(made)
    labels = [cause.label for cause in found.causes]
    label = f"{TONE}:{row['axis']}"
    return row | {
        "verdict": found.verdict,
        "said": " + ".join(labels),
        "p_value": found.p_value,
        "named": any(label in cause.group for cause in found.causes),
        "vibrations_named": sum(one.startswith(TONE) for one in labels),
        "causes": json.dumps([{"label": one.label, "size": one.size, "sigma": one.sigma} for one in found.causes]),
        "seconds": found.runtime_s,
    }


def recording(config: SwayConfig, number: int, streams: Streams) -> Recording:
    """The recording of a case."""
    return _drawn(config, number, streams)[0]


def _drawn(config: SwayConfig, number: int, streams: Streams) -> tuple[Recording, dict[str, Any]]:
    rng = streams.generator("body")
    hz, reference_hz = SAMPLE_HZ[number % 3], REFERENCE_HZ[number // 3 % 2]
    t_s = np.arange(int(LONG_S * hz)) / hz
    rates = np.zeros((t_s.size, 3))
    for axis in range(3):
        for _ in range(rng.integers(1, 3)):
            turn = 2 * np.pi * _between(rng, SWAY_HZ) * t_s + rng.uniform(0, 2 * np.pi)
            rates[:, axis] += np.deg2rad(_between(rng, SWAY_DEG_S)) * np.sin(turn)
    arw, sigma = np.deg2rad(_between(rng, ARW_DEG)), np.deg2rad(_between(rng, SIGMA_DEG))
    made = observed(rates, hz // reference_hz, 1 / hz, arw, sigma, streams.generator("noise"))
    row = {"kind": "none", "sample_hz": hz, "reference_hz": reference_hz, "arw_deg": np.rad2deg(arw)}
    row |= {"axis": "", "vibration_hz": float("nan"), "snr": float("nan"), "size_deg_s": float("nan")}
    if number < config.cases - config.vibrations:
        return made, row
    rng = streams.generator("tone")
    snr, axis = _between(rng, SNR), int(rng.integers(3))
    at = float(rng.uniform(max(SLOWEST_HZ, OF_REFERENCES * reference_hz), FASTEST * hz))
    # The sum of squares of a sine over all samples is half their number.
    size = snr * arw * np.sqrt(hz) * np.sqrt(2 / t_s.size)
    read = made.gyro.rates.copy()
    read[:, axis] += size * np.sin(2 * np.pi * at * t_s + rng.uniform(0, 2 * np.pi))
    row |= {"kind": "shaken", "axis": "xyz"[axis], "vibration_hz": at, "snr": snr, "size_deg_s": np.rad2deg(size)}
    return replace(made, gyro=replace(made.gyro, rates=read)), row


def _between(rng: np.random.Generator, limits: tuple[float, float]) -> float:
    return float(np.exp(rng.uniform(*np.log(limits))))


def observed(
    rates: Array, each: int, sample_s: float, arw: float, sigma: float, rng: np.random.Generator, **options: Any
) -> Recording:
    """A recording of a body with rates (n, 3) rad/s, by a gyro without error, with a reference after every `each` samples."""
    gaps = len(rates) // each
    turns = Rotation.identity(gaps)
    for k in range(each):
        turns = turns * Rotation.from_rotvec(rates[k::each][:gaps] * sample_s)
    attitudes = [Rotation.identity()]
    for turn in turns:
        attitudes.append(attitudes[-1] * turn)
    noisy = Rotation.concatenate(attitudes) * Rotation.from_rotvec(sigma * rng.standard_normal((gaps + 1, 3)))
    read = rates + arw / np.sqrt(sample_s) * rng.standard_normal(rates.shape)
    tags, times = sample_s * np.arange(len(rates)), each * sample_s * np.arange(gaps + 1)
    return Recording.from_arrays(tags, read, times, noisy.as_quat(), sigma=sigma, arw=arw, **options)


STUDY = Study("studies.validation.swaying:STUDY", SwayConfig, case, recording)


def report(config: SwayConfig, rows: pd.DataFrame) -> Report:
    """Alarms of bodies without an effect, vibrations that are named, by rates of samples and references."""
    none, shaken = rows[rows["kind"] == "none"], rows[rows["kind"] == "shaken"]
    alarms = none["verdict"] != "none"
    meaning = "Of the cases of the kind; intervals are in the table."
    checks = (
        Check(f"no effect: alarms, {int(alarms.sum())} of {len(none)}", _share(alarms), at_most(ALARMS), "", meaning),
        Check("no effect: vibrations named", float(none["vibrations_named"].sum()), at_most(0.0)),
        Check(
            f"vibrations named about their axis, {int(shaken['named'].sum())} of {len(shaken)}",
            _share(shaken["named"]), at_least(NAMED), "", meaning,
        ),
        Check("largest processor time of a diagnosis", float(rows["seconds"].max()), None, "s"),
    )  # fmt: skip
    lines = []
    for (kind, hz, reference_hz), own in rows.groupby(["kind", "sample_hz", "reference_hz"], sort=True):
        good = own["verdict"] == "none" if kind == "none" else own["named"]
        low, high = binomial_interval(int(good.sum()), len(own))
        lines.append(
            {"kind": kind, "sample_hz": hz, "reference_hz": reference_hz, "cases": len(own), "right": int(good.sum())}
            | {"low": low, "high": high}
        )
    wrong = rows[((rows["kind"] == "none") & (rows["verdict"] != "none")) | ((rows["kind"] == "shaken") & ~rows["named"])]
    shown = ["case", "kind", "sample_hz", "reference_hz", "axis", "vibration_hz", "snr", "verdict", "said", "p_value"]
    tables = {
        "rates": Table("Right answers by rate of samples and references", pd.DataFrame(lines), "With 95 % binomial intervals."),
        "wrong": Table("What is not as it should be, case by case", wrong[shown]),
    }
    return Report(tables, {"p_values": _figure(none)}, checks)


def _share(of: "pd.Series[Any]") -> float:
    return float(of.mean()) if len(of) else float("nan")


def _figure(none: pd.DataFrame) -> Any:
    def draw_on(axes: Any) -> None:
        values = np.sort(none["p_value"].to_numpy(float))
        axes.plot(values, (np.arange(values.size) + 0.5) / max(values.size, 1))
        axes.plot([0, 1], [0, 1], color="0.4", linestyle=":")

    return sheet(Panel(draw_on, "no effect", "p-value of the gap", "share of the bodies"), size=(5, 4))


ENTRY = Entry(STUDY, SUMMARY, report)
