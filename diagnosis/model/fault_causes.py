"""Causes of the answer for stretches that were taken out of the recording (`diagnosis.detectors.stream_faults`)."""

from __future__ import annotations

from collections.abc import Sequence

from diagnosis.answer import Finding
from diagnosis.detectors.sample_report import Symptom
from diagnosis.model.symptoms import SampleCause
from simulator.effects.base import Fault


def convert_faults(faults: Sequence[Fault]) -> tuple[SampleCause, ...]:
    """Convert faults into causes that samples or references show by themselves."""
    return tuple(_convert(fault) for fault in faults)


def _convert(fault: Fault) -> SampleCause:
    found = fault.detection
    symptom = Symptom(
        found.effect, found.axis, found.size, found.unit, found.sigma, dict(found.parameters), found.p_value, found.text
    )
    signal = "attitude" if fault.references.any() else "gyro stream"
    finding = Finding(signal, None, found.axis, None, found.effect, found.size, found.p_value, found.text)
    return SampleCause(symptom, found.effect, finding)
