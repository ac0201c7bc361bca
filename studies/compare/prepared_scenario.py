"""A scenario prepared for many simulations that are measured like a recording; see `studies.compare.gap` for the method."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyrocal import GyroParameters
from gyrocal.arrays import Array
from gyrocal.errors import InputError
from gyrocal.recording import Recording
from simulator.adopted_scenario import AdoptedScenario, ReplayPlan, hash_recording
from simulator.effects import REGISTRY, Setting
from simulator.streams import generator
from simulator.truth.rotation import apply_rotation_errors, separation
from studies.compare.measure import MeasurementSetup, RecordingStatistics

# Stages whose effects are functions of the motion; effects of later stages act on samples with noise.
PREDICTABLE_STAGES = ("rate", "filter", "clock", "threshold", "reference")
RELATIVE_STEP = 1e-3  # of an amplitude without a sigma, for its response
LEAST_DERIVATIVE_STEP = 1e-12
MATCHING_TIME_S = 1e-3


@dataclass(frozen=True)
class Response:
    """Additions of effects to raw rates (n, 3), rad/s, and to references, rotation errors (m, 3), rad."""

    rates: Array
    references: Array

    def subtract_from(self, recording: Recording) -> Recording:
        """Return a recording without this response."""
        if not self.rates.any() and not self.references.any():
            return recording
        gyro, attitudes = recording.gyro, recording.attitudes
        return replace(
            recording,
            gyro=replace(gyro, rates=gyro.rates - self.rates),
            attitudes=replace(attitudes, quaternions=apply_rotation_errors(attitudes.quaternions, -self.references)),
        )

    def add_scaled(self, responses: Sequence["Response"], factors: Array) -> "Response":
        """Return the sum of this response and others, each times its factor."""
        rates, references = self.rates, self.references
        for response, factor in zip(responses, factors, strict=True):
            rates, references = rates + factor * response.rates, references + factor * response.references
        return Response(rates, references)


class FlightStatistics(NamedTuple):
    """Statistics of one simulated flight."""

    before: float  # before, before_samples: m_0 of attitude and samples, without subtraction of a response
    before_samples: float
    error: float  # e_0 plus the floor of M0: `before` minus the part that the drawn amplitudes are expected to add
    under: RecordingStatistics  # measured under the scenario


@dataclass(frozen=True)
class PreparedScenario:
    """A scenario with everything that its flights have in common."""

    scenario: AdoptedScenario  # to be simulated
    setup: MeasurementSetup  # for flights of its plan
    fitted: bool  # whether its sizes were fitted to the compared recording itself
    stated: Response  # response at the stated sizes
    slopes: tuple[Response, ...]  # response per unit of each amplitude of the predictable effects
    amplitude_indices: NDArray[np.intp]  # (k,) of these amplitudes among all
    Q: Array  # (N, p) orthonormal basis of the calibration's whitened sensitivities
    W: Array  # (N, k) whitened columns of the amplitudes, projected off Q

    @classmethod
    def build(
        cls, scenario: AdoptedScenario, recording: Recording, recorded: MeasurementSetup, name: str
    ) -> "PreparedScenario":
        """Make a scenario ready for a recording and its setup; the name is for an error.

        A replay uses the plan of the compared recording, whichever recording it was adopted from. Raises `InputError` if a
        scenario's own plan has other samples or references than the recording, or if an effect cannot act.
        """
        plan, fitted, start = scenario.plan, False, GyroParameters.from_vector(recorded.start)
        if isinstance(plan, ReplayPlan):
            fitted = hash_recording(plan.recording) == hash_recording(recording)
            if not fitted:
                scenario = replace(scenario, plan=ReplayPlan(recording, plan.G, plan.bias))
        else:
            start = GyroParameters(np.array(plan.gyro.true_G), np.deg2rad(plan.gyro.true_bias_deg_s))
        plain = scenario.fly(effects=(), noise=False)
        _check_same_plan(name, recording, plain)
        # Quiet stretches are those of the recording, so that the same samples of all flights are used.
        setup = replace(MeasurementSetup.build(plain, start), quiet=recorded.quiet)
        indices, base = _find_predictable_amplitudes(scenario), setup.state(plain)
        Q = np.linalg.qr(base.H)[0]
        stated = _compute_response(scenario, plain, scenario.effects)
        slopes, W = [], np.empty((base.z.size, indices.size))
        for column, index in enumerate(indices):
            change, step = _differentiate_response(scenario, plain, stated, int(index))
            # Differences over a step of one sigma: a unit of an amplitude may be many degrees.
            W[:, column] = (base.z - setup.state(change.subtract_from(plain)).z) / step
            slopes.append(Response(change.rates / step, change.references / step))
        return cls(scenario, setup, fitted, stated, tuple(slopes), indices, Q, W - Q @ (Q.T @ W))

    @property
    def size_error(self) -> float:
        """tr(W C Wᵀ)/dof: expected misfit of a new recording from the errors of sizes fitted to the compared one."""
        C = self.scenario.covariance
        if not self.fitted or C is None:
            return 0.0
        C_predictable = C[np.ix_(self.amplitude_indices, self.amplitude_indices)]
        return float(np.sum((self.W @ C_predictable) * self.W)) / self.setup.degrees_of_freedom

    def fly(self, seed: int, case: int) -> FlightStatistics:
        """Simulate one flight with sizes drawn from the posterior, and measure it."""
        scenario, setup = self.scenario, self.setup
        amplitudes = scenario.draw_amplitudes(generator(seed, case, "posterior"))
        flown = scenario.fly(seed, case, scenario.replace_amplitudes(amplitudes))
        corrected = self.stated.subtract_from(flown)
        if self.fitted and self.amplitude_indices.size:
            z = setup.state(corrected).z
            amplitude_errors = np.asarray(np.linalg.lstsq(self.W, z - self.Q @ (self.Q.T @ z), rcond=None)[0], dtype=float)
            corrected = self.stated.add_scaled(self.slopes, amplitude_errors).subtract_from(flown)
        under = setup.measure(corrected)
        before = under.mean_square if corrected is flown else setup.misfit(flown)
        drawn_response = self.W @ amplitudes[self.amplitude_indices]
        error = before - float(drawn_response @ drawn_response) / setup.degrees_of_freedom
        return FlightStatistics(before, setup.compute_samples_mean_square(flown), error, under)


def _check_same_plan(name: str, recording: Recording, flown: Recording) -> None:
    """Raise `InputError` unless a flight has the recording's samples, references and intervals."""
    pairs = (
        ("gyro samples", recording.gyro.t_s, flown.gyro.t_s),
        ("reference attitudes", recording.attitudes.t_s, flown.attitudes.t_s),
    )
    for quantity, expected, actual in pairs:
        if expected.shape != actual.shape or np.abs(expected - actual).max() > MATCHING_TIME_S:
            raise InputError(
                f"{name}: flies another plan than the recording: {actual.size} {quantity} from {actual[0]:g} to "
                f"{actual[-1]:g} s, not {expected.size} from {expected[0]:g} to {expected[-1]:g} s; give a scenario of its "
                "plan, such as one of 'diagnose --adopt'"
            )
    names = [interval.name for interval in recording.intervals]
    if names != [interval.name for interval in flown.intervals]:
        raise InputError(f"{name}: has intervals of other names than the recording's {', '.join(names)}")


def _find_predictable_amplitudes(scenario: AdoptedScenario) -> NDArray[np.intp]:
    """Find the indices, among all amplitudes, of effects that are functions of the motion."""
    counts = [REGISTRY[effect.effect].amplitudes(effect).size for effect in scenario.effects]
    is_predictable = [REGISTRY[effect.effect].stage in PREDICTABLE_STAGES for effect in scenario.effects]
    return np.flatnonzero(np.repeat(np.array(is_predictable, dtype=bool), counts))


def _differentiate_response(
    scenario: AdoptedScenario, plain: Recording, stated: Response, index: int
) -> tuple[Response, float]:
    """Compute the change of the response by a step of one amplitude, and the step."""
    amplitudes = scenario.amplitudes.copy()
    sigma = 0.0 if scenario.covariance is None else float(np.sqrt(scenario.covariance[index, index]))
    step = sigma or max(RELATIVE_STEP * abs(float(amplitudes[index])), LEAST_DERIVATIVE_STEP)
    amplitudes[index] += step
    changed = _compute_response(scenario, plain, scenario.replace_amplitudes(amplitudes))
    return Response(changed.rates - stated.rates, changed.references - stated.references), step


def _compute_response(scenario: AdoptedScenario, plain: Recording, effects: Sequence[Setting]) -> Response:
    """Compute the response of the predictable effects among some effects."""
    predicted = [effect for effect in effects if REGISTRY[effect.effect].stage in PREDICTABLE_STAGES]
    affected = scenario.fly(effects=predicted, noise=False) if predicted else plain
    rotations = separation(plain.attitudes.quaternions, affected.attitudes.quaternions)
    return Response(affected.gyro.rates - plain.gyro.rates, rotations)
