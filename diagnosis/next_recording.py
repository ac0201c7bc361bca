"""Predict the next recording of a unit from the earlier ones, and compare.

The recordings of one unit are one recording with more intervals (`diagnosis.model.unit`). The earlier recordings are diagnosed
together. They give a joint normal distribution of the next recording's reference attitudes. It uses the motion from the next
recording's own samples, and only the times and sigmas of its references:

    e = ζ_s − (prediction by M0) − X_s m,    cov e = C + X_s Γ X_sᵀ,    Γ = (X_tᵀX_t + 1/s²)⁻¹,  m = Γ X_tᵀ y_t

C and the whitened training rows t are those of `diagnosis.model.folds`. They contain the noise of gyro and references and the
uncertainty of G and b after the earlier recordings. X has the columns of the identified effects. Unknowns that no earlier
recording determines, such as the start attitudes of the next recording's intervals, are projected out. If nothing has changed,
eᵀ(cov e)⁻¹e is χ² and its p-value is uniform, for each interval and axis alone and for the recording.

Parameters in which an effect is not linear, such as a time constant, are fixed at their best values. So is the scale of its
prior.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg
import scipy.special
from numpy.typing import NDArray

from diagnosis.answer import Verdict
from diagnosis.detectors.samples import examine
from diagnosis.diagnose import list_nameable_effects
from diagnosis.explain import infer_causes
from diagnosis.inference.amplitudes import FittedEffect
from diagnosis.inference.criticism import Check, check_explanation
from diagnosis.model import processes
from diagnosis.model.dead_zone import bound_p_of_passes, list_dead_zone_groups
from diagnosis.model.folds import ConditionedRows, condition_rows
from diagnosis.model.gate import check_residuals
from diagnosis.model.groups import list_process_places
from diagnosis.model.layout import tabulate_observations
from diagnosis.model.linear import LinearModel, SelectedCandidate
from diagnosis.model.linearise import linearise_recording
from diagnosis.model.localization import compute_chi2
from diagnosis.model.periods import make_columns
from diagnosis.model.prepare import PreparedRecording, Progress, check_usable, find_unclipped_pieces, prepare
from diagnosis.model.recording_model import RecordingModel
from diagnosis.model.unit import Unit, build_own_biases, build_unit_model, join_recordings
from diagnosis.settings import DEFAULT, DiagnosisSettings
from gyrocal.errors import InputError
from gyrocal.recording import Recording, triad
from gyrocal.recording.trackers import keep_rows
from simulator.effects import REGISTRY

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

AXES = "xyz"
PARITY_NOTE = "Only the rates of the body are compared; what the parity of the gyros shows is in gyrocal diagnose"


@dataclass(frozen=True)
class NextRecordingSettings:
    """Constants of `diagnosis.next_recording`."""

    known: float = 10.0  # prior over posterior sigma of a shared number, from which on it is predicted and not projected out
    format: int = 1  # of the file of a prediction


SETTINGS = NextRecordingSettings()


@dataclass(frozen=True)
class Band:
    """Residuals of one interval about one axis.

    Attributes
    ----------
    interval, axis : which
    residual_deg, band_deg : root mean square of the residuals, and its expectation if nothing has changed
    effect_deg : root mean square of the expected part of the identified effects
    chi2, dof, p_value : of them alone
    """

    interval: str
    axis: str
    residual_deg: float
    band_deg: float
    effect_deg: float
    chi2: float
    dof: int
    p_value: float


@dataclass(frozen=True)
class Comparison:
    """A recording beside its prediction.

    Attributes
    ----------
    chi2, dof, p_value : of all residuals of the recording together
    bands : by interval and axis
    """

    chi2: float
    dof: int
    p_value: float
    bands: tuple[Band, ...]


@dataclass(frozen=True)
class RecordingPrediction:
    """Prediction of the next recording of a unit, compared with its references.

    Attributes
    ----------
    recordings, following : names
    verdict : of the earlier recordings
    causes : labels of the effects in the prediction
    left_out : labels of identified effects that are not in it, such as those of single samples
    predicted : with these effects
    baseline : with G and b alone
    notes : on what is not compared
    """

    recordings: tuple[str, ...]
    following: str
    verdict: Verdict
    causes: tuple[str, ...]
    left_out: tuple[str, ...]
    predicted: Comparison
    baseline: Comparison
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """The document that docs/compare.md describes."""
        return {
            "format": SETTINGS.format,
            "recordings": list(self.recordings),
            "next": self.following,
            "verdict": self.verdict,
            "causes": list(self.causes),
            "left_out": list(self.left_out),
            "chi2": self.predicted.chi2,
            "dof": self.predicted.dof,
            "p_value": self.predicted.p_value,
            "baseline_p_value": self.baseline.p_value,
            "bands": [vars(band) for band in self.predicted.bands],
            "notes": list(self.notes),
        }


def predict_next_recording(
    recordings: Mapping[str, Recording],
    *,
    own_bias: bool = False,
    library: Sequence[str] | None = None,
    settings: DiagnosisSettings = DEFAULT,
    seed: int = 0,
    tell: Progress = lambda text, share: None,
) -> RecordingPrediction:
    """Predict the last of some recordings of one unit from all others, and compare.

    Parameters
    ----------
    recordings : by name, in the order in which they were made
    own_bias : whether each recording has a bias of its own, as after a restart of the gyros
    library : names of the effects that may be named; all by default
    settings : thresholds and priors
    seed : of the null distribution
    tell : called with a text and the share done

    Raises
    ------
    InputError
        There are fewer than two, they cannot be joined, or one cannot be used.
    """
    if len(recordings) < 2:
        raise InputError("give two recordings of one unit or more: the last is predicted from those before it")
    notes = (PARITY_NOTE,) if any(one.is_array for one in recordings.values()) else ()
    recordings = {name: triad(one) for name, one in recordings.items()}
    unit, last = join_recordings(recordings), list(recordings)[-1]
    try:
        check_usable(recordings[last], settings)  # before minutes are spent on those that predict it
    except InputError as error:
        raise InputError(f"{last}: {error}") from None
    before = _drop_last_recording(unit, last)
    prepared = prepare(before.recording, settings, tell)
    effects = list_nameable_effects(library, of_trackers=unit.recording.attitudes.sensor is not None)
    tell("candidates", 0.1)
    groups = list_dead_zone_groups(prepared, effects)
    linear = build_unit_model(prepared.model, before.owner, effects, groups, settings, own_bias=own_bias)

    def check(found: LinearModel, members: tuple[SelectedCandidate, ...]) -> tuple[Check, ...]:
        return check_explanation(found, members, tabulate_observations(prepared.model), seed)

    explained = infer_causes(linear, check, settings, seed, tell, bound_p_of_passes(prepared.dead))
    tell("the next recording", 0.95)
    model = _linearise_all(prepared, unit, settings)
    named = explained.attribution.verdict if explained.attribution is not None else "none"
    made = [(one, _build_effect_columns(model, one)) for one in explained.fitted]
    kept = [(one, columns) for one, columns in made if columns is not None]
    own = [(one.size if one.process else one.prior_sigma, columns) for one, columns in kept]
    return RecordingPrediction(
        recordings=tuple(recordings)[:-1],
        following=last,
        verdict=named,
        causes=tuple(one.label for one, _ in kept),
        left_out=tuple(one.label for one, columns in made if columns is None),
        predicted=compare_with_prediction(model, unit.owner, last, own, own_bias),
        baseline=compare_with_prediction(model, unit.owner, last, [], own_bias),
        notes=notes,
    )


def compare_with_prediction(
    model: RecordingModel, owner: Sequence[str], last: str, effects: Sequence[tuple[float, Array]], own_bias: bool = False
) -> Comparison:
    """One recording of a unit beside its prediction from the others.

    Parameters
    ----------
    model : all recordings side by side, linearised
    owner : which recording each interval comes from
    last : name of the one that is predicted
    effects : of each, the scale of its prior and its whitened columns (N, k)
    own_bias : whether each recording has a bias of its own
    """
    names = np.array(owner)[[block.interval for block in model.blocks]]
    out = np.repeat(names[model.observation_block] == last, 3)
    W = np.hstack([np.empty((model.size, 0)), *(scale * columns for scale, columns in effects)])
    found = condition_rows(model, W, out, build_own_biases(model, names) if own_bias else None)
    gain = np.asarray(np.linalg.solve(np.eye(W.shape[1]) + found.train_X.T @ found.train_X, found.train_X.T))
    expected = found.error_X @ (gain @ found.train_y)
    spread = np.eye(W.shape[1]) - gain @ found.train_X
    return _score_prediction(model, found, out, expected, found.error_X @ spread @ found.error_X.T)


def _score_prediction(model: RecordingModel, found: ConditionedRows, out: Mask, expected: Array, more: Array) -> Comparison:
    """χ² of the errors of a prediction, whose expectation (s,) and covariance (s, s) the effects add to."""
    known = found.known > SETTINGS.known
    D = found.shared[:, known]
    C = found.noise + (D / (1 + found.known[known] ** 2)) @ D.T + more
    L = np.asarray(np.linalg.cholesky(C))
    white = scipy.linalg.solve_triangular(
        L, np.column_stack([found.error_y - expected, expected, found.shared[:, ~known]]), lower=True
    )
    # Columns of one size, or the rank would be that of the largest ones.
    unknown = white[:, 2:] / np.maximum(np.linalg.norm(white[:, 2:], axis=0), 1e-300)
    Q = scipy.linalg.orth(unknown, rcond=1e-9)
    left = white[:, :2] - Q @ (Q.T @ white[:, :2])
    value, dof = float(left[:, 0] @ left[:, 0]), len(L) - Q.shape[1]
    observed = np.flatnonzero(out[::3])
    turn = scipy.linalg.block_diag(*(-model.observation_attitude[observed].transpose(0, 2, 1)))
    M = turn @ L
    residual, effect = (M @ left).T
    S = M @ M.T - (M @ Q) @ (M @ Q).T
    bands = []
    for number in np.unique(model.observation_block[observed]):
        name = model.recording.intervals[model.blocks[number].interval].name
        for axis in range(3):
            rows = 3 * np.flatnonzero(model.observation_block[observed] == number) + axis
            own, own_dof = compute_chi2(residual[rows], S[np.ix_(rows, rows)])
            if own_dof:
                bands.append(
                    Band(
                        interval=name,
                        axis=AXES[axis],
                        residual_deg=_compute_rms_deg(residual[rows] ** 2),
                        band_deg=_compute_rms_deg(np.diag(S)[rows]),
                        effect_deg=_compute_rms_deg(effect[rows] ** 2),
                        chi2=own,
                        dof=own_dof,
                        p_value=float(scipy.special.chdtrc(own_dof, own)),
                    )
                )
    return Comparison(value, dof, float(scipy.special.chdtrc(dof, value)), tuple(bands))


def _compute_rms_deg(squares: Array) -> float:
    return float(np.rad2deg(np.sqrt(np.mean(squares))))


# ---- the recordings before -----------------------------------------------------------------------------------------------


def _drop_last_recording(unit: Unit, last: str) -> Unit:
    """The unit without its last recording."""
    whole = unit.recording
    count = sum(name != last for name in unit.owner)
    begin = whole.intervals[count].start_s
    # Between the last interval before and the first of the next one; samples there belong to neither.
    end = 0.5 * (whole.intervals[count - 1].stop_s + begin)
    samples, references = whole.gyro.t_s < end, whole.attitudes.t_s < end
    gyro = replace(whole.gyro, t_s=whole.gyro.t_s[samples], rates=whole.gyro.rates[samples])
    kept = keep_rows(whole.attitudes, references)
    return Unit(replace(whole, gyro=gyro, attitudes=kept, intervals=whole.intervals[:count]), unit.owner[:count])


# ---- the next one --------------------------------------------------------------------------------------------------------


def _linearise_all(prepared: PreparedRecording, unit: Unit, settings: DiagnosisSettings) -> RecordingModel:
    """All recordings linearised about the calibration of those before, their noise as it was found there."""
    report = examine(unit.recording, settings=settings)
    attitudes = unit.recording.attitudes
    sigma, names = attitudes.sigma.copy(), [one.name for one in attitudes.sensors]
    for name, noise in ((None, prepared.reference_noise), *prepared.tracker_noise):
        if noise is not None and noise.departs:
            sigma[... if name is None else attitudes.sensor == names.index(name)] *= noise.factors
    model = linearise_recording(
        unit.recording, prepared.model.G, prepared.model.bias, report.rates, report.smooth, report.density,
        find_unclipped_pieces(unit.recording, report), sigma,
    )  # fmt: skip
    check_residuals(model, report.rates)
    return model


def _build_effect_columns(model: RecordingModel, one: FittedEffect) -> Array | None:
    """(N, k) whitened columns of a named effect over all recordings; None of one that has none of its own."""
    effect = REGISTRY[one.effect]
    if one.process and effect.of_trackers:
        return None
    if one.process:
        covariance, places = list_process_places(model, effect)
        return processes.build_all_columns(
            places[AXES.index(str(one.axis))], covariance(one.parameters), processes.SETTINGS.whole / one.size**2
        )
    if not effect.has_columns:
        return None
    return make_columns(model, effect, one.axis, one.parameters)
