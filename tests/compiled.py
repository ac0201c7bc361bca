"""Compile what most tests need, once: ``python -m tests.compiled``.

Two test processes that start together would each compile the same functions, which takes either of them a minute. This is one
process, beside the one that checks the types.
"""

import numpy as np

from diagnosis.diagnose import diagnose
from gyrocal import calibrate
from simulator import scenario
from simulator.mission_mode.config import MissionConfig
from simulator.mission_mode.flight import simulate_mission
from simulator.simulate import simulate
from tests.diagnosis.recordings import recorded
from tests.gyrocal.estimation.filter_cases import run_onboard_case


def main() -> None:
    """Fly, calibrate, filter and diagnose a little of each."""
    simulate_mission(MissionConfig(), seconds=60.0)
    plain = simulate(scenario.load("trmm"), seed=1)
    calibrate(plain)
    calibrate(plain, psi="linear", iterations=1)
    run_onboard_case(np.random.default_rng(1))
    diagnose(recorded(1, "bias_step:z=0.3,time_s=22000"))


if __name__ == "__main__":
    main()
