"""A scenario ready to be flown many times and measured as a recording is; see `studies.compare.gap` for the reasoning."""

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

# Stages whose effects are functions of the motion; what comes later in the chain acts on samples with noise in them.
PREDICTABLE_STAGES = ("rate", "filter", "clock", "threshold", "reference")
RELATIVE_STEP = 1e-3  # of an amplitude without a sigma, for its response
LEAST_DERIVATIVE_STEP = 1e-12
MATCHING_TIME_S = 1e-3


@dataclass(frozen=True)
class Response:
    """What is added to raw rates (n, 3), rad/s, and to references, e (m, 3), rad."""

    rates: Array
    references: Array

    def subtract_from(self, recording: Recording) -> Recording:
        """A recording without it."""
        if not self.rates.any() and not self.references.any():
            return recording
        gyro, attitudes = recording.gyro, recording.attitudes
        return replace(
            recording,
            gyro=replace(gyro, rates=gyro.rates - self.rates),
            attitudes=replace(attitudes, quaternions=apply_rotation_errors(attitudes.quaternions, -self.references)),
        )

    def add_shares(self, others: Sequence["Response"], shares: Array) -> "Response":
        """With shares of others added."""
        rates, references = self.rates, self.references
        for other, share in zip(others, shares, strict=True):
            rates, references = rates + share * other.rates, references + share * other.references
        return Response(rates, references)


class FlightStatistics(NamedTuple):
    """What one flight gave."""

    before: float  # before, before_samples: m_0 of attitude and samples: nothing taken out
    before_samples: float
    error: float  # e_0, `before` less its expectation for the sizes that were flown, but for the floor of M0
    under: RecordingStatistics  # measured under the scenario


@dataclass(frozen=True)
class PreparedScenario:
    """A scenario with all that its flights have in common."""

    scenario: AdoptedScenario  # what is flown
    ruler: MeasurementSetup  # for flights of its plan
    fitted: bool  # whether its sizes were fitted to the very recording that is compared
    stated: Response  # response at the stated sizes
    slopes: tuple[Response, ...]  # response per unit of each amplitude of effects that are predicted
    places: NDArray[np.intp]  # (k,) of these amplitudes among all
    Q: Array  # (N, p) orthonormal basis of what the calibration takes up, whitened
    W: Array  # (N, k) whitened columns of the amplitudes, projected off Q

    @classmethod
    def build(
        cls, scenario: AdoptedScenario, recording: Recording, recorded: MeasurementSetup, name: str
    ) -> "PreparedScenario":
        """Make a scenario ready for a recording and its setup; the name is for an error.

        A replay is flown on the plan of the recording that is compared, whichever recording it was adopted from.
        An `InputError` if a plan of its own has other samples or references than the recording, or an effect cannot act.
        """
        plan, fitted, start = scenario.plan, False, GyroParameters.from_vector(recorded.start)
        if isinstance(plan, ReplayPlan):
            fitted = hash_recording(plan.recording) == hash_recording(recording)
            if not fitted:
                scenario = replace(scenario, plan=ReplayPlan(recording, plan.G, plan.bias))
        else:
            start = GyroParameters(np.array(plan.gyro.true_G), np.deg2rad(plan.gyro.true_bias_deg_s))
        plain = scenario.fly(effects=(), noise=False)
        _check_alike(name, recording, plain)
        # Stretches of quiet samples are those of the recording, so that the same samples of all are looked at.
        ruler = replace(MeasurementSetup.build(plain, start), quiet=recorded.quiet)
        places, base = _find_predicted_amplitudes(scenario), ruler.state(plain)
        Q = np.linalg.qr(base.H)[0]
        stated = _compute_response(scenario, plain, scenario.effects)
        slopes, W = [], np.empty((base.z.size, places.size))
        for column, place in enumerate(places):
            change, step = _differentiate_response(scenario, plain, stated, int(place))
            # By a step as small as its sigma: a unit of an amplitude may be many degrees.
            W[:, column] = (base.z - ruler.state(change.subtract_from(plain)).z) / step
            slopes.append(Response(change.rates / step, change.references / step))
        return cls(scenario, ruler, fitted, stated, tuple(slopes), places, Q, W - Q @ (Q.T @ W))

    @property
    def size_error(self) -> float:
        """tr(W C Wᵀ)/dof: what sizes that were fitted are expected to be off by, in the misfit of a new recording."""
        C = self.scenario.covariance
        if not self.fitted or C is None:
            return 0.0
        own = C[np.ix_(self.places, self.places)]
        return float(np.sum((self.W @ own) * self.W)) / self.ruler.degrees_of_freedom

    def fly(self, seed: int, case: int) -> FlightStatistics:
        """One flight, its sizes drawn from the posterior."""
        scenario, ruler = self.scenario, self.ruler
        drawn = scenario.draw_amplitudes(generator(seed, case, "posterior"))
        flown = scenario.fly(seed, case, scenario.replace_amplitudes(drawn))
        left = self.stated.subtract_from(flown)
        if self.fitted and self.places.size:
            z = ruler.state(left).z
            off = np.asarray(np.linalg.lstsq(self.W, z - self.Q @ (self.Q.T @ z), rcond=None)[0], dtype=float)
            left = self.stated.add_shares(self.slopes, off).subtract_from(flown)
        under = ruler.measure(left)
        before = under.mean_square if left is flown else ruler.misfit(flown)
        added = self.W @ drawn[self.places]
        error = before - float(added @ added) / ruler.degrees_of_freedom
        return FlightStatistics(before, ruler.compute_samples_mean_square(flown), error, under)


def _check_alike(name: str, recording: Recording, flown: Recording) -> None:
    """A flight must have the recording's samples and references, or the statistics would not be of the same things."""
    pairs = (
        ("gyro samples", recording.gyro.t_s, flown.gyro.t_s),
        ("reference attitudes", recording.attitudes.t_s, flown.attitudes.t_s),
    )
    for what, own, other in pairs:
        if own.shape != other.shape or np.abs(own - other).max() > MATCHING_TIME_S:
            raise InputError(
                f"{name}: flies another plan than the recording: {other.size} {what} from {other[0]:g} to {other[-1]:g} s, not "
                f"{own.size} from {own[0]:g} to {own[-1]:g} s; give a scenario of its plan, such as one of 'diagnose --adopt'"
            )
    names = [interval.name for interval in recording.intervals]
    if names != [interval.name for interval in flown.intervals]:
        raise InputError(f"{name}: has intervals of other names than the recording's {', '.join(names)}")


def _find_predicted_amplitudes(scenario: AdoptedScenario) -> NDArray[np.intp]:
    """Places, among all amplitudes, of those of the effects that are functions of the motion."""
    counts = [REGISTRY[effect.effect].amplitudes(effect).size for effect in scenario.effects]
    predicted = [REGISTRY[one.effect].stage in PREDICTABLE_STAGES for one in scenario.effects]
    return np.flatnonzero(np.repeat(np.array(predicted, dtype=bool), counts))


def _differentiate_response(
    scenario: AdoptedScenario, plain: Recording, stated: Response, place: int
) -> tuple[Response, float]:
    """Change of the response by a step of one amplitude, and the step."""
    moved = scenario.amplitudes.copy()
    sigma = 0.0 if scenario.covariance is None else float(np.sqrt(scenario.covariance[place, place]))
    step = sigma or max(RELATIVE_STEP * abs(float(moved[place])), LEAST_DERIVATIVE_STEP)
    moved[place] += step
    other = _compute_response(scenario, plain, scenario.replace_amplitudes(moved))
    return Response(other.rates - stated.rates, other.references - stated.references), step


def _compute_response(scenario: AdoptedScenario, plain: Recording, effects: Sequence[Setting]) -> Response:
    """Compute the change of a noise-free recording by the predicted ones of some effects."""
    predicted = [effect for effect in effects if REGISTRY[effect.effect].stage in PREDICTABLE_STAGES]
    shown = scenario.fly(effects=predicted, noise=False) if predicted else plain
    return Response(shown.gyro.rates - plain.gyro.rates, separation(plain.attitudes.quaternions, shown.attitudes.quaternions))
