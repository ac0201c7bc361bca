"""Where linear ψ stops being good enough: slew rate × step size, noise-free.

The relative error of linear ψ is of the order |ω|Δt/2 (N 11), so after one iteration what it leaves of a correction ΔG grows
with the slew rate and the step. Further iterations remove it, at another pass each: both are reported. The slews of the TRMM
scenario are flown at each rate, their intervals made as long as that needs; samples are mean rates over the step.
"""

from math import ceil

import numpy as np
import pandas as pd

from gyrocal import InputError, calibrate
from simulator.scenario import Scenario, override
from simulator.simulate import motion, observe

RATES_DEG_S = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0)
STEPS_S = (0.5, 1.0, 2.0, 4.0, 8.0)
GOOD_ENOUGH = 1e-5  # in G: a tenth of what the TRMM references allow to be known
RAMP = 0.1
MARGIN_S = 60.0


def with_slew_rate(scenario: Scenario, rate_deg_s: float) -> Scenario:
    """The scenario with every slew coasting at the rate; constant-rate stretches between slews keep their length."""
    changes: dict[str, float] = {}
    for k, interval in enumerate(scenario.interval):
        if not interval.slew:
            continue
        clock, previous_stop = MARGIN_S, None
        for j, slew in enumerate(interval.slew):
            if previous_stop is not None:
                clock += slew.start_s - previous_stop
            duration = abs(slew.angle_deg) / (rate_deg_s * (1 - RAMP))
            path = f"interval.{k}.slew.{j}"
            changes |= {f"{path}.start_s": clock, f"{path}.duration_s": duration, f"{path}.ramp_fraction": RAMP}
            clock += duration
            previous_stop = slew.start_s + slew.duration_s
        changes[f"interval.{k}.stop_s"] = interval.start_s + 8.0 * ceil((clock + MARGIN_S) / 8.0)
    return override(scenario, changes)


def run(scenario: Scenario, rates_deg_s: tuple[float, ...] = RATES_DEG_S, steps_s: tuple[float, ...] = STEPS_S) -> pd.DataFrame:
    """A row per slew rate and step.

    Returns
    -------
    slew_rate_deg_s, step_s, the angle turned in a step, the largest difference in G and in b (deg/s) between linear and full ψ
    after one iteration, each one's error in G then and when converged, and the iterations to convergence.
    """
    truth = np.array(scenario.gyro.true_G)
    rows = []
    for rate in rates_deg_s:
        for step in steps_s:
            flown = override(with_slew_rate(scenario, rate), {"gyro.sample_s": step})
            path = motion(flown, substeps=ceil(step / 0.5))
            recording = observe(flown, path, gyro_rng=None, reference_rng=None)
            row: dict[str, float] = {"slew_rate_deg_s": rate, "step_s": step, "angle_per_step_deg": rate * step}
            first = {psi: calibrate(recording, psi=psi, iterations=1) for psi in ("full", "linear")}
            row["G_difference"] = float(np.abs(first["linear"].G - first["full"].G).max())
            row["bias_difference_deg_s"] = float(np.rad2deg(np.abs(first["linear"].bias - first["full"].bias).max()))
            for psi in ("full", "linear"):
                try:
                    final = calibrate(recording, psi=psi, max_iterations=30)
                except InputError:
                    final = None  # diverged until the residual could not be linearised any more
                row[f"{psi}_first_error_G"] = float(np.abs(first[psi].G - truth).max())
                row[f"{psi}_error_G"] = float(np.abs(final.G - truth).max()) if final else np.nan
                row[f"{psi}_iterations"] = len(final.corrections) if final and final.converged else np.nan
            rows.append(row)
    return pd.DataFrame(rows)
