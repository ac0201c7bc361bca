"""Faults of the simulator: motion, gyro, references, random streams, effects."""

from tests.mutations.fault import of

TRUTH = "tests/simulator/truth/"
SENSORS = "tests/simulator/sensors/"
EFFECTS = "tests/simulator/effects/"

MOTION = [
    *of(
        "simulator/truth/rotation.py",
        f"{TRUTH}test_rotation.py {SENSORS}test_reference.py",
        [
            ("a turn goes the other way", "- sine * cross(axis, vectors)", "+ sine * cross(axis, vectors)"),
            (
                "quaternions are those of the transposed matrices",
                "Rotation.from_matrix(np.swapaxes(A, -1, -2)).as_quat",
                "Rotation.from_matrix(A).as_quat",
            ),
            (
                "reference errors are about inertial axes",
                "(Rotation.from_quat(quaternions) * Rotation.from_rotvec(-errors))",
                "(Rotation.from_rotvec(-errors) * Rotation.from_quat(quaternions))",
            ),
            ("reference errors have the other sign", "Rotation.from_rotvec(-errors)", "Rotation.from_rotvec(errors)"),
        ],
    ),
    *of(
        "simulator/truth/maneuvers.py",
        f"{TRUTH}test_maneuvers.py",
        [
            (
                "ramps do not raise the peak rate",
                "peak = self.angle / (self.duration * (1 - f))",
                "peak = self.angle / self.duration",
            ),
            ("a pulse has not the unit area", "return 30 * x**2", "return 20 * x**2"),
            (
                "the offset of a hold has the other sign",
                "+ hold.entry_pulse(tau)[:, None] * hold.offset",
                "- hold.entry_pulse(tau)[:, None] * hold.offset",
            ),
            (
                "the sway's rate has the other sign",
                "omega = turned(AXES[axis], angles[:, axis], omega) + rates",
                "omega = turned(AXES[axis], angles[:, axis], omega) - rates",
            ),
            ("+y forward is -y forward", '"+y": -np.pi / 2', '"+y": np.pi / 2'),
        ],
    ),
    *of(
        "simulator/truth/integration.py",
        f"{TRUTH}test_integration.py",
        [("the integration is of lower order", "c1 = -cross(a1, a2)", "c1 = cross(a1, a2)")],
    ),
    *of(
        "simulator/truth/orbit.py",
        f"{TRUTH}test_orbit.py",
        [
            (
                "the node goes the other way",
                "return float(-1.5 * self.mean_motion * J2",
                "return float(1.5 * self.mean_motion * J2",
            )
        ],
    ),
]

INSTRUMENTS = [
    *of(
        "simulator/sensors/gyro.py",
        f"{SENSORS}test_gyro.py",
        [
            ("the bias has the other sign", "np.asarray((omega - bias) @", "np.asarray((omega + bias) @"),
            ("G is transposed", "np.linalg.inv(G).T)", "np.linalg.inv(G))"),
        ],
    ),
    *of(
        "simulator/draws.py",
        f"{SENSORS}test_gyro.py tests/simulator/test_draws.py",
        [("noise does not average over a sample", "sigma = size / np.sqrt(before)", "sigma = size / before")],
    ),
    *of(
        "simulator/sensors/reference.py",
        f"{SENSORS}test_reference.py",
        [
            (
                "all axes have the sigma of x",
                "rng.standard_normal((len(quaternions), 3)) * sigma)",
                "rng.standard_normal((len(quaternions), 3)) * sigma[0])",
            ),
            (
                "references are taken in slews",
                "inner = inner[(inner <= start) | (inner >= stop)]",
                "inner = inner[(inner <= start) | (inner >= start)]",
            ),
        ],
    ),
    *of(
        "simulator/sensors/sun.py",
        f"{SENSORS}test_suite.py",
        [
            (
                "the sensor sees past the edge of its view",
                "if abs(tan_alpha) > edge or abs(tan_beta) > edge:",
                "if abs(tan_alpha) > edge and abs(tan_beta) > edge:",
            )
        ],
    ),
    *of(
        "simulator/simulate.py",
        "tests/simulator/test_simulate.py",
        [
            (
                "the true bias is in deg/s",
                "true_bias = np.deg2rad(scenario.gyro.true_bias_deg_s) if",
                "true_bias = np.array(scenario.gyro.true_bias_deg_s) if",
            )
        ],
    ),
    *of(
        "simulator/streams.py",
        "tests/simulator/test_streams.py",
        [
            ("streams of a case are alike", "[*words, case, *name.encode()]", "[*words, case]"),
            ("cases are alike", "[*words, case, *name.encode()]", "[*words, *name.encode()]"),
        ],
    ),
]

ERRORS = [
    *of(
        "simulator/effects/common.py",
        f"{EFFECTS}test_effects.py {EFFECTS}test_noise_colours.py",
        [
            (
                "a step comes a sample late",
                "(stream.t_s + 0.5 * stream.duration_s - time_s)",
                "(stream.t_s - 0.5 * stream.duration_s - time_s)",
            ),
            ("a Markov process is a random walk", "value = decay[k] * value + drive[k]", "value = value + drive[k]"),
        ],
    ),
    *of(
        "simulator/effects/gyro/rate_deadzone.py",
        f"{EFFECTS}test_effects_random.py::test_dead_zone_silences_the_reading_but_not_the_noise",
        [
            (
                "the dead zone is outside of itself",
                "out[np.abs(samples[:, axis]) < setting.size * DEG, axis]",
                "out[np.abs(samples[:, axis]) > setting.size * DEG, axis]",
            )
        ],
    ),
    *of(
        "simulator/effects/gyro/time_offset.py",
        f"{EFFECTS}test_effects.py::test_time_offset_by_one_sample_shift_the_samples {EFFECTS}test_effects.py",
        [("late tags are early", "np.full(len(stream.t_s), setting.size)", "np.full(len(stream.t_s), -setting.size)")],
    ),
    *of(
        "simulator/effects/gyro/scale_asymmetry.py",
        f"{EFFECTS}test_effects.py",
        [
            (
                "an asymmetry is a scale factor",
                "PPM * np.abs(stream.rates[:, index(axis)])",
                "PPM * stream.rates[:, index(axis)]",
            )
        ],
    ),
    *of(
        "simulator/effects/gyro/rate_truncation.py",
        f"{EFFECTS}test_effects_random.py::test_truncation_cuts_toward_zero",
        [("readings are rounded instead of cut", "setting.size * DEG, np.trunc)", "setting.size * DEG, np.round)")],
    ),
    *of(
        "simulator/effects/common.py",
        f"{EFFECTS}test_effects_random.py::test_noise_excess_scales_the_very_same_noise",
        [("an excess is squared", "factor[chosen(axis)] = size", "factor[chosen(axis)] = size**2")],
    ),
    *of(
        "simulator/effects/reference/reference_mode_offset.py",
        f"{EFFECTS}test_effects.py::test_reference_effects_in_closed_form {EFFECTS}test_flight_mode.py",
        [
            (
                "the offset is in the other modes",
                "np.where(_acts(references, parameters), DEG, 0.0)",
                "np.where(_acts(references, parameters), 0.0, DEG)",
            )
        ],
    ),
]

FAULTS = [*MOTION, *INSTRUMENTS, *ERRORS]
