"""What cases share is built once a process, and anew where a case has a scenario of its own; noise is the case's."""

import numpy as np

from studies.calibration.shared_truth import build_once
from studies.montecarlo.study import StudyConfig

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
