"""The propagated data: the TRMM scenario's six intervals, with noise, at its own sampling and finer."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gyrocal import Arcs, GyroParameters, Recording
from gyrocal.arrays import Array
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.propagation import Propagation, propagate, propagate_packed
from gyrocal.calibration.sampling import prepare_measurements
from simulator import scenario as scenarios
from simulator.scenario import Scenario
from simulator.simulate import compute_noise_free_rates, motion, observe
from simulator.streams import generator
from simulator.truth.motion import Motion

ENTROPY = 1998


@dataclass(frozen=True)
class Flight:
    """The scenario with everything that its cases share; reference attitudes at the intervals' ends only."""

    scenario: Scenario
    motion: Motion

    @classmethod
    def load_trmm(cls) -> "Flight":
        """Load the built-in TRMM scenario."""
        scenario = scenarios.load("trmm")
        return cls(scenario, motion(scenario))

    @cached_property
    def rates(self) -> Array:
        """(n, 3) noise-free raw rates, rad/s."""
        return compute_noise_free_rates(self.scenario, self.motion)

    @cached_property
    def recording(self) -> Recording:
        """Case 0, with noise."""
        gyro, reference = (generator(ENTROPY, 0, name) for name in ("gyro_noise", "reference_noise"))
        return observe(self.scenario, self.motion, gyro_rng=gyro, reference_rng=reference)

    @cached_property
    def initial(self) -> GyroParameters:
        """Parameters that a calibration starts from."""
        return GyroParameters(self.recording.gyro.apriori_G, self.recording.gyro.apriori_bias)

    @cached_property
    def problem(self) -> Problem:
        """Case 0, prepared."""
        return Problem.build(self.recording, prepare_measurements(self.recording))

    def build_arcs(self, finer: int = 1) -> Arcs:
        """Build the steps of case 0, each cut into equal ones: the same motion from `finer` times as many samples."""
        arcs = self.problem.measurements.arcs
        return Arcs(
            rates=np.repeat(arcs.raw, finer, axis=0),
            dt=np.repeat(arcs.dt / finer, finer),
            sample=np.arange(len(arcs.dt) * finer),
            first=arcs.first * finer,
            last=arcs.last * finer,
            arc=arcs.arc,
        )


def run_packed(arcs: Arcs, parameters: GyroParameters) -> Propagation:
    """Run the project's kernel on packed increments, which are kept after the first use."""
    options = (arcs.ends, arcs.last, arcs.arc, parameters.G, parameters.bias, False, False)
    return Propagation(*propagate_packed(arcs.increments, *options))


def run_unpacked(arcs: Arcs, parameters: GyroParameters) -> Propagation:
    """Run the first pass over a recording's own rows: the kernel, and the packing of increments."""
    return propagate(arcs.replace_rates(arcs.rates), parameters.G, parameters.bias)


def compute_disagreement(result: Propagation, expected: Propagation) -> float:
    """Compute the largest difference in R, and in the sums of any regressor, relative to the largest of its kind."""
    sums = np.abs(result.S - expected.S).max(axis=(0, 2, 3)) / np.abs(expected.S).max(axis=(0, 2, 3))
    return float(max(np.abs(result.R - expected.R).max(), sums.max()))
