"""What cases share is built once a process, and anew where a case has a scenario of its own; noise is the case's."""

import numpy as np

from simulator import scenario as scenarios
from studies.calibration.shared_truth import NoiseFreeSimulation, build_once, make_noise_generators
from studies.montecarlo.study import Streams, StudyConfig, observed

CONFIG = StudyConfig(overrides={"gyro.sample_s": 60.0})


def test_built_once_without_dispersions_and_for_each_case_with_them():
    built = []

    @build_once
    def truth(config, flown):
        built.append(flown)
        return flown.truth

    assert truth(CONFIG, 0) is truth(CONFIG, 1)
    assert len(built) == 1
    spread = {"gyro.true_G.0.1": {"kind": "uniform", "low": 1e-3, "high": 2e-3, "mode": "offset"}}
    dispersed = StudyConfig.model_validate(CONFIG.model_dump() | {"dispersions": spread}, strict=False)
    first, second = (truth(dispersed, case) for case in (0, 1))
    assert len(built) == 3
    assert first[1] != second[1]
    np.testing.assert_array_equal(np.delete(first, 1), np.delete(second, 1))


def test_noise_is_that_of_the_recording():
    streams = Streams(CONFIG.entropy, 3)
    flown = NoiseFreeSimulation.simulate(scenarios.override(scenarios.load("trmm"), CONFIG.overrides))
    seen = observed(CONFIG, 3, streams)
    rates, A = flown.realise(make_noise_generators(streams))
    np.testing.assert_array_equal(rates, seen.gyro.rates)
    np.testing.assert_array_equal(flown.realise()[0], flown.plain.gyro.rates)
    assert A.shape == (len(seen.attitudes.quaternions), 3, 3)
