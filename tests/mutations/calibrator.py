"""Faults of the calibrator: propagation, covariance, solution, gate."""

from tests.mutations.fault import of

CALIBRATION = "tests/gyrocal/calibration/"
PROPAGATED = f"{CALIBRATION}test_propagation.py::test_compiled_pass_equals_the_streaming_recursion"
HAND = f"{CALIBRATION}test_covariance.py::test_one_residual_by_hand"
NOISY = f"{CALIBRATION}test_covariance.py::test_noise_rides_with_the_attitude"
WHITENED = "test_whitening_is_that_of_the_cholesky_factor"
TOUCHING = f"{CALIBRATION}test_invariance.py::test_intervals_that_touch_may_stand_in_any_order"
RECOVERED = f"{CALIBRATION}test_davenport.py"

PROPAGATION = [
    *of(
        "gyrocal/calibration/propagation.py",
        f"{CALIBRATION}test_propagation.py",
        [
            ("ψ has the other sign", "(np.eye(3) - c[..., None, None] * K", "(np.eye(3) + c[..., None, None] * K"),
            ("the recursion turns the other way", "R = rotation_matrix(-omega * dt)", "R = rotation_matrix(omega * dt)"),
            (
                "the recursion does not carry Θ on",
                "self._psi) @ F + R @ self.Theta",
                "self._psi) @ F + self.Theta",
            ),
        ],
    ),
    *of(
        "gyrocal/calibration/propagation.py",
        f"{PROPAGATED} {CALIBRATION}test_propagation.py::test_every_length_fills_the_lanes_rightly",
        [
            ("one element of P has the other sign", "px, py, pz = px + my * z - mz * y,", "px, py, pz = px - my * z + mz * y,"),
            ("one element of E has the other sign", "1 - yy - zz, xy - cz, xz + cy", "1 - yy - zz, xy + cz, xz + cy"),
            ("an interval goes on from the one before", "if output == 0 or arc[output] != arc[output - 1]:", "if output == 0:"),
            ("linear and full ψ are exchanged", "if linear:  #", "if not linear:  #"),
            ("the series serves where it is inexact", "SERIES_LIMIT = 0.1", "SERIES_LIMIT = 2.0"),
            ("half of a tile's steps are left out", "TILE):  # packing pads", "2 * TILE):  # packing pads"),
            (
                "the second coefficient of d has the other sign",
                "D0, D1, D2, D3, D4 = 1 / 6, -1 / 120",
                "D0, D1, D2, D3, D4 = 1 / 6, 1 / 120",
            ),
        ],
    ),
    *of(
        "gyrocal/calibration/packing.py",
        f"{CALIBRATION}test_packing.py {CALIBRATION}test_propagation.py",
        [
            (
                "the end of a short piece is not empty",
                "for k in range(count[lane], len(out)):",
                "for k in range(count[lane] + 1, len(out)):",
            ),
            (
                "samples left out are taken for consecutive ones",
                "if sample[k] != sample[k - 1] + 1:",
                "if sample[k] < sample[k - 1]:",
            ),
            ("the largest turn of a step is the smallest", 'fcmp_ordered(">", size, most)', 'fcmp_ordered("<", size, most)'),
        ],
    ),
]

COVARIANCE = [
    *of(
        "gyrocal/calibration/covariance.py",
        f"{HAND} {NOISY} {CALIBRATION}test_covariance.py::test_chains_follow_shared_references {TOUCHING}",
        [
            (
                "the variance of a reference is quadrupled",
                "value = noise[row[a], i, j] if",
                "value = 4 * noise[row[a], i, j] if",
            ),
            (
                "the gyro's noise goes on to the later reference",
                "both += walk[b]",
                "both += walk[a]",
            ),
            (
                "groups end where an interval inside ends",
                "reached = max(reached, int(last_rows[interval]))",
                "reached = int(last_rows[interval])",
            ),
            (
                "first chain branch: the sign of a shared reference",
                "value -= noise[row[a], i, k] * R[b, j, k]",
                "value += noise[row[a], i, k] * R[b, j, k]",
            ),
            (
                "second chain branch: the sign of a shared reference",
                "value -= R[a, i, k] * noise[row[b], k, j]",
                "value += R[a, i, k] * noise[row[b], k, j]",
            ),
            (
                "second chain branch: the rotation is transposed",
                "value -= R[a, i, k] * noise[row[b], k, j]",
                "value -= R[a, k, i] * noise[row[b], k, j]",
            ),
        ],
    ),
    *of(
        "gyrocal/calibration/normal_equations.py",
        f"{RECOVERED}::test_compiled_residual_is_the_rotation_vector {CALIBRATION}test_covariance.py::{WHITENED}",
        [
            (
                "the compiled residual has one other sign",
                "x, y, z = delta[2, 1] - delta[1, 2],",
                "x, y, z = delta[1, 2] - delta[2, 1],",
            ),
            ("whitening multiplies by the diagonal", "out[i, c] /= L[i, i]", "out[i, c] *= L[i, i]"),
        ],
    ),
    *of(
        "gyrocal/calibration/normal_equations.py",
        f"{RECOVERED}::test_sensitivity_has_rows_of_G_by_axis_and_columns_by_gyro "
        f"{RECOVERED}::test_compiled_iterations_are_those_of_calibrate",
        [
            (
                "compiled iterations go the other way",
                "xs[n + 1, columns[i]] -= scale[i] * step",
                "xs[n + 1, columns[i]] += scale[i] * step",
            ),
            (
                "compiled covariance has one scale twice",
                "inverse[i, j] * scale[i] * scale[j]",
                "inverse[i, j] * scale[i] * scale[i]",
            ),
            ("rows and columns of G are exchanged", "q, axis = (k % 3, k // 3) if k < 9", "q, axis = (k // 3, k % 3) if k < 9"),
        ],
    ),
]

SOLUTION = [
    *of(
        "gyrocal/calibration/davenport.py",
        f"{RECOVERED}::test_without_data_the_prior_gives_back_what_it_knows",
        [("the prior pulls the other way", "self.u = self.W @ (", "self.u = -self.W @ (")],
    ),
    *of(
        "gyrocal/calibration/davenport.py",
        f"{RECOVERED}::test_recursive_calibrator_equals_the_compiled_batch",
        [
            ("the recursive correction has the other sign", "x[self._columns] -= correction", "x[self._columns] += correction"),
            ("the recursive C is turned the other way", "R @ self._C @ R.T + self._arw", "R.T @ self._C @ R + self._arw"),
        ],
    ),
    *of(
        "gyrocal/calibration/davenport.py",
        f"{RECOVERED}::test_both_tolerances_must_be_met",
        [
            ("iterations go the other way", "        x = x - step\n", "        x = x + step\n"),
            ("biases need not converge", "<= tolerance_G and np.abs(step[9:])", "<= tolerance_G or np.abs(step[9:])"),
        ],
    ),
    *of(
        "gyrocal/calibration/davenport.py",
        f"{RECOVERED}::test_chi2_with_a_prior_has_the_degrees_of_freedom_it_claims",
        [
            (
                "solving costs no degrees of freedom",
                "(p if apriori_covariance is None else 0)",
                "(0 if apriori_covariance is None else 0)",
            ),
            (
                "chi2 leaves out the prior's term",
                "chi2=state.chi2 + _prior_chi2(x - x0, columns, apriori_covariance)",
                "chi2=state.chi2",
            ),
        ],
    ),
    *of(
        "gyrocal/calibration/gate.py",
        f"{CALIBRATION}test_gate.py",
        [
            (
                "any residual is linearised",
                "LARGEST_RESIDUAL = float(np.deg2rad(30.0))",
                "LARGEST_RESIDUAL = float(np.deg2rad(180.0))",
            ),
            (
                "what is not finite passes",
                "np.where(np.isfinite(angle), angle, np.inf)",
                "np.where(np.isfinite(angle), angle, 0.0)",
            ),
        ],
    ),
    *of(
        "gyrocal/calibration/problem.py",
        "tests/studies/montecarlo/test_diverged.py",
        [
            (
                "iterations that diverged are good",
                "if not (largest <= gate.LARGEST_RESIDUAL).all():",
                "if (largest > 1e9).any():",
            )
        ],
    ),
    *of(
        "gyrocal/calibration/sampling.py",
        f"{CALIBRATION}test_sampling.py {RECOVERED}::test_skipping_and_averaging_steps",
        [
            (
                "skipping leaves the noise as it is",
                'float(factor) if resampling == "skip" else 1.0',
                '1.0 if resampling == "skip" else 1.0',
            ),
            (
                "elapsed times are from reference to reference",
                "                times[1:] - times[0],\n",
                "                np.diff(times),\n",
            ),
            ("long gaps are held without a word", "limit = gyro.sample_s + max(0.5 *", "limit = gyro.sample_s + max(50 *"),
            ("a step holds the next sample", 'side="right") - 1, 0, len(edges) - 2)', 'side="right"), 0, len(edges) - 2)'),
        ],
    ),
    *of(
        "gyrocal/calibration/observability.py",
        f"{CALIBRATION}test_gate.py",
        [("what the data do not say counts as found", "free = (values < 1.0)", "free = (values < 1e-3)")],
    ),
    *of(
        "gyrocal/calibration/gyro_space.py",
        f"{CALIBRATION}test_oracle.py::test_gyro_space_is_the_reading_of_each_gyro {CALIBRATION}test_oracle.py",
        [
            (
                "a gyro's bias has the other sign",
                "np.concatenate([y.ravel(), -K @ parameters.bias])",
                "np.concatenate([y.ravel(), K @ parameters.bias])",
            )
        ],
    ),
    *of(
        "gyrocal/calibration/parameters.py",
        f"{CALIBRATION}test_parameters.py",
        [("the table has misalignments of the other gyro", "misalignment[:, k] for k, j", "misalignment[k] for k, j")],
    ),
    *of(
        "gyrocal/compiled.py",
        "tests/gyrocal/test_compiled.py",
        [
            (
                "compiled code of other layers may be stale",
                "below = LAYERS[: LAYERS.index(package) + 1] if",
                "below = (package,) if",
            )
        ],
    ),
]

FAULTS = [*PROPAGATION, *COVARIANCE, *SOLUTION]
