"""Common parts of the studies: kinds of settings, and the noise-free simulation of a scenario that cases build on."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Annotated, Any, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator

from gyrocal import CalibrationResult, GyroParameters, InputError, attitude
from gyrocal.arrays import Array
from gyrocal.recording import Recording
from simulator.scenario import Scenario
from simulator.simulate import compute_noise_free_rates, observe, realise
from simulator.truth.motion import Motion
from studies.montecarlo.study import Streams, StudyConfig, dispersed, load_base_scenario, simulate_case_motion


def _check_different(value: tuple[float, ...]) -> tuple[float, ...]:
    if not value or min(value) <= 0 or len(set(value)) < len(value):
        raise ValueError("must be one or more different numbers above zero")
    return value


def _check_rising(value: tuple[float, ...]) -> tuple[float, ...]:
    if not value or value[0] <= 0 or any(b <= a for a, b in pairwise(value)):
        raise ValueError("must be one or more rising numbers above zero")
    return value


Different = Annotated[tuple[float, ...], AfterValidator(_check_different)]
Rising = Annotated[tuple[float, ...], AfterValidator(_check_rising)]


Noise = tuple[np.random.Generator, np.random.Generator]
Config = TypeVar("Config", bound=StudyConfig)
Built = TypeVar("Built")


def get_true_parameters(scenario: Scenario) -> GyroParameters:
    """Return G and b of a scenario's gyro."""
    return GyroParameters(np.array(scenario.gyro.true_G), np.deg2rad(scenario.gyro.true_bias_deg_s))


def require_converged(result: CalibrationResult) -> CalibrationResult:
    """Return a calibration that converged; otherwise raise `InputError`, which makes the case a failed one."""
    if not result.converged:
        raise InputError(f"diverged: the calibration still moves after {len(result.corrections)} iterations")
    return result


def compute_rms(values: ArrayLike) -> float:
    """Compute the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


@lru_cache(maxsize=16)
def get_workspace(name: object, shape: tuple[int, ...]) -> Array:
    """Return this process' array of that name and shape, uninitialised when it is new; the next case overwrites it.

    A case's arrays are a megabyte or two. Depending on the heap's layout they are returned to the system after each case, and
    allocating them again costs a page fault for every 4 KiB: more than the case's own work.
    """
    return np.empty(shape)


def make_noise_generators(streams: Streams) -> Noise:
    """Make the generators of a case's gyro noise and reference noise, each at its start."""
    return streams.generator("gyro_noise"), streams.generator("reference_noise")


@dataclass(frozen=True)
class NoiseFreeSimulation:
    """A scenario simulated without noise."""

    scenario: Scenario  # scenario, motion: as simulated
    motion: Motion
    plain: Recording  # its recording without noise
    rates: Array  # (n, 3) noise-free raw rates, rad/s
    truth: Array  # truth, initial: (12,) true and a-priori parameters; G dimensionless, b rad/s
    initial: Array

    @classmethod
    def simulate(cls, scenario: Scenario) -> Self:
        """Simulate a scenario."""
        motion = simulate_case_motion(scenario)
        plain = observe(scenario, motion, gyro_rng=None, reference_rng=None)
        rates = compute_noise_free_rates(scenario, motion)
        initial = GyroParameters(plain.gyro.apriori_G, plain.gyro.apriori_bias)
        return cls(scenario, motion, plain, rates, get_true_parameters(scenario).vector, initial.vector)

    def realise(self, noise: Noise | None = None, out: Array | None = None) -> tuple[Array, Array]:
        """Compute raw rates (n, 3) and reference attitudes (m, 3, 3), with noise if there are generators."""
        rates, quaternions = realise(self.scenario, self.motion, self.rates, *(noise or (None, None)), out=out)
        return rates, attitude.matrix_from_quaternion(quaternions)


def build_once(build: Callable[[Config, NoiseFreeSimulation], Built]) -> Callable[[Config, int], Built]:
    """Call `build` once a process for a configuration and its simulated scenario.

    With dispersions every case has a scenario of its own, and it is built anew for each. The key is JSON, since in a worker the
    same configuration may arrive as another object.
    """

    @lru_cache(maxsize=2)
    def build_cached(kind: type[Any], text: str) -> Built:
        config = kind.model_validate_json(text)
        return build(config, NoiseFreeSimulation.simulate(load_base_scenario(config)))

    def build_for_case(config: Config, case: int) -> Built:
        if config.dispersions:
            return build(config, NoiseFreeSimulation.simulate(dispersed(config, case)))
        return build_cached(type(config), config.model_dump_json())

    return build_for_case
