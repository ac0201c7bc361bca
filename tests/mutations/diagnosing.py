"""Faults of the diagnosis: thresholds, evidence, search, attribution, closure, detectors."""

from tests.mutations.fault import of

INFERENCE = "tests/diagnosis/inference/"
ATTRIBUTION = f"{INFERENCE}test_attribution.py"

THRESHOLDS = [
    *of(
        "diagnosis/settings.py",
        f"{ATTRIBUTION} tests/diagnosis/test_settings.py tests/diagnosis/test_judged.py",
        [
            (
                "an unlisted cause of 80 % is no unknown",
                "unknown: float = threshold(\n        0.5,",
                "unknown: float = threshold(\n        0.9,",
            ),
            (
                "a cause of one half is named",
                "named: float = threshold(\n        0.9,",
                "named: float = threshold(\n        0.5,",
            ),
            (
                "one recording in five alarms",
                "false_alarm_rate: float = threshold(\n        0.002,",
                "false_alarm_rate: float = threshold(\n        0.2,",
            ),
        ],
    ),
    *of(
        "diagnosis/explain.py",
        "tests/diagnosis/test_judged.py",
        [
            (
                "the attitude alarms a hundred times too seldom",
                "if p < settings.false_alarm_rate:",
                "if p < 0.01 * settings.false_alarm_rate:",
            )
        ],
    ),
    *of(
        "diagnosis/sensor_tables.py",
        "tests/diagnosis/test_sensor_tables.py::test_one_day_that_does_not_fit_is_no_note",
        [("a day that does not fit is a note", 'return "unknown", attribution', 'return "none", attribution')],
    ),
]

EVIDENCE = [
    *of(
        "diagnosis/inference/evidence.py",
        f"{INFERENCE}test_evidence.py {INFERENCE}test_shift.py",
        [
            ("Occam's factor is squared", "out = quadratic - 0.5 * np.log(gain)", "out = quadratic - np.log(gain)"),
            (
                "an amplitude that is positive has half its prior",
                "out = out + np.log(2.0) + log_ndtr(z)",
                "out = out + log_ndtr(z)",
            ),
            ("an average is a sum", "- np.log(table.shape[1]))", "- 0.0)"),
            (
                "half of a shift has the other sign",
                "correlation[:, -1] - 0.5 * own[:, -1]",
                "correlation[:, -1] + 0.5 * own[:, -1]",
            ),
        ],
    ),
    *of(
        "diagnosis/inference/products.py",
        f"{INFERENCE}test_search.py",
        [
            (
                "what is in has the determinant the other way",
                "- np.log(np.diag(factor)).sum())",
                "+ np.log(np.diag(factor)).sum())",
            ),
        ],
    ),
    *of(
        "diagnosis/inference/search.py",
        f"{INFERENCE}test_search.py",
        [
            (
                "further effects cost nothing",
                "prior += (len(members) - 1) * float(",
                "prior += 0 * (len(members) - 1) * float(",
            ),
            (
                "what the samples say does not count",
                "prior = sum(entry.log_prior + entry.log_odds for",
                "prior = sum(entry.log_prior for",
            ),
        ],
    ),
    *of(
        "diagnosis/inference/null.py",
        f"{INFERENCE}test_search.py",
        [
            ("the observation is not one of the draws", "(1 + int(np.sum(null >= observed)))", "int(np.sum(null >= observed))"),
            ("a scan has all false alarms for itself", "of_scan / scanned_share, 1.0)", "of_scan, 1.0)"),
            (
                "draws that end early count themselves",
                "usual = SETTINGS.enough / null.size",
                "usual = (SETTINGS.enough + 1) / (null.size + 1)",
            ),
        ],
    ),
    *of(
        "diagnosis/inference/amplitudes.py",
        f"{INFERENCE}test_amplitudes.py",
        [
            (
                "an unknown time does not widen the size",
                'spread += np.einsum("s,sij->ij", w, C) + (away * w[:, None]).T @ away',
                'spread += np.einsum("s,sij->ij", w, C)',
            )
        ],
    ),
    *of(
        "diagnosis/inference/criticism.py",
        f"{INFERENCE}test_criticism.py",
        [
            ("the number of checks is not allowed for", "check.p_value * len(checks)", "check.p_value * 1"),
            ("steady changes are taken for jumps", "score = -np.log(", "score = np.log("),
            ("lagged products have the mean zero", "found.e[:-lag][same] - mean", "found.e[:-lag][same]"),
        ],
    ),
    *of(
        "diagnosis/model/layout.py",
        "tests/diagnosis/model/test_layout.py",
        [("the rate at a reference is that before it", "at, np.minimum(at + count, stop[:, None])", "at - count, at")],
    ),
    *of(
        "diagnosis/model/recording.py",
        "tests/diagnosis/model/test_periods.py::test_a_body_may_turn_while_references_are_averaged",
        [
            (
                "errors of averaged references are along one attitude",
                "self.reference_error(errors).reshape(count, 3)",
                "-self.observation_attitude[:, :, axis]",
            )
        ],
    ),
    *of(
        "diagnosis/model/groups.py",
        "tests/diagnosis/model/test_unlisted.py::test_of_two_intervals_a_value_of_each_is_a_step_between_them",
        [("a step is a rival of itself", "!= 2:", "!= 0:")],
    ),
    *of(
        "diagnosis/model/motion.py",
        "tests/diagnosis/model/test_motion.py",
        [("any error of the attitude is noise of the gyro", "np.sqrt(max(excess, 1.0))", "1.0")],
    ),
]

ANSWER = [
    *of(
        "diagnosis/inference/attribution.py",
        ATTRIBUTION,
        [
            (
                "what the checks reject is named",
                '    if unknown > settings.unknown:\n        return Attribution("unknown", attribution.best',
                '    if unknown > 1.0:\n        return Attribution("unknown", attribution.best',
            ),
            ("p-values under something unlisted have no area", "x**2 / (math.expm1(x) - x)", "x**2 / math.expm1(x)"),
            (
                "a remainder makes what the samples show",
                "odds * math.exp(-max(entry.log_odds, 0.0))",
                "odds",
            ),
            ("what the checks see is beside nothing", "factor * beside / (1 - beside)", "beside / (1 - beside)"),
            (
                "one sure cause makes all sure",
                "if all(slot.probability >= settings.named",
                "if any(slot.probability >= settings.named",
            ),
        ],
    ),
    *of(
        "diagnosis/inference/conformal.py",
        f"{INFERENCE}test_conformal.py",
        [("the coverage is that asked for on average only", "binom.ppf(SETTINGS.confidence,", "binom.ppf(0.5,")],
    ),
    *of(
        "diagnosis/inference/closure.py",
        f"{INFERENCE}test_closure.py {INFERENCE}test_shift.py",
        [
            ("predictions are added", "fold.left_y - predicted", "fold.left_y + predicted"),
            ("the floor counts as a gap", "closed = 1.0 - (after - 1.0) / gap", "closed = 1.0 - after / gap"),
            ("the interval is a tenth as wide", "spread = 1.645 *", "spread = 0.1645 *"),
        ],
    ),
    *of(
        "diagnosis/model/sensors/tables.py",
        "tests/diagnosis/model/test_sensors.py tests/diagnosis/test_sensor_tables.py",
        [
            (
                "the linear part of what was found is taken off twice",
                "stacked[:, -1] + stacked[:, :-1] @ amplitudes",
                "stacked[:, -1] - stacked[:, :-1] @ amplitudes",
            )
        ],
    ),
]

SAMPLES = [
    *of(
        "diagnosis/model/dead_zone.py",
        "tests/diagnosis/model/test_dead_zone.py",
        [
            (
                "the rate that is missing in all runs has the other sign",
                "part >= 0, *(SETTINGS.difference",
                "-1.0 * (part >= 0), *(SETTINGS.difference",
            ),
            (
                "the rate that is missing in one run has the other sign",
                "SETTINGS.difference * (part == number)",
                "-SETTINGS.difference * (part == number)",
            ),
            (
                "only one gyro could have a dead zone",
                "effect.weight * len(prepared.dead) / len(AXES)",
                "effect.weight * len(prepared.dead)",
            ),
        ],
    ),
    *of(
        "diagnosis/detectors/dead_zone_rests.py",
        "tests/diagnosis/test_parts.py::test_dead_zone_reads_zero_and_m0_does_not",
        [
            (
                "readings of zero speak against a dead zone",
                "_compute_log_density(means, own) - float(read)",
                "float(read) - _compute_log_density(means, own)",
            )
        ],
    ),
    *of(
        "diagnosis/detectors/clipping.py",
        "tests/diagnosis/detectors/test_samples.py",
        [("a hundred clipped samples are none", "fewest_clipped: int = 5 ", "fewest_clipped: int = 500_000 ")],
    ),
    *of(
        "diagnosis/model/gate.py",
        "tests/diagnosis/model/test_gate.py",
        [
            (
                "residuals that calibrate refuses pass",
                "    raise refusal(error, repaired, name",
                "    refusal(error, repaired, name",
            )
        ],
    ),
    *of(
        "diagnosis/model/step_index.py",
        "tests/diagnosis/model/test_step_index.py",
        [
            (
                "what is in progress at the end of an interval is of the next one",
                "first[interval], stop[interval] - 1",
                "0, middle_s.size - 1",
            )
        ],
    ),
    *of(
        "diagnosis/model/dead_zone.py",
        "tests/diagnosis/model/test_dead_zone.py",
        [
            ("what is missing acts along the input axis of M0", "for _ in range(SETTINGS.calibrated)", "for _ in range(0)"),
        ],
    ),
    *of(
        "diagnosis/detectors/number_format.py",
        "tests/diagnosis/detectors/test_number_format.py",
        [("a body that rests between two turns passes through zero", "loud: float = 1.6", "loud: float = 1e6")],
    ),
    *of(
        "diagnosis/model/prepare.py",
        "tests/diagnosis/model/test_prepare.py",
        [("samples speak against themselves", "gain + (odds if other", "gain - (odds if other")],
    ),
    *of(
        "diagnosis/inference/amplitudes.py",
        "tests/diagnosis/inference/test_amplitudes.py",
        [("a size changes by twice of what its amplitude does", "(more - less) / (2 * steps[k])", "(more - less) / steps[k]")],
    ),
    *of(
        "diagnosis/detectors/reference_noise.py",
        "tests/diagnosis/detectors/test_reference_noise.py",
        [("all axes are noisier where one is by far", "or others < common", "or others > 1e9 * common")],
    ),
    *of(
        "diagnosis/detectors/clipping.py",
        "tests/diagnosis/detectors/test_samples.py::test_the_level_of_a_clipped_rate_is_known_to_a_step_of_its_lattice",
        [("readings cut toward zero are the level", "step if cut else 0.5 * step * rounded", "0.5 * step * rounded")],
    ),
]

FAULTS = [*THRESHOLDS, *EVIDENCE, *ANSWER, *SAMPLES]
