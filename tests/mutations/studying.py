"""Faults of the studies: pages, what a resumed study keeps, seeds, statistics, formats."""

from tests.mutations.fault import of

MONTECARLO = "tests/studies/montecarlo/"

PAGES = of(
    "studies/report/pages.py",
    "tests/studies/report/test_pages.py",
    [
        ("texts of pages are HTML", "autoescape=True", "autoescape=False"),
        ("numbers are aligned as text", "all(NUMBER.match(text) for text in column)", "False"),
        ("figures of files are empty", "drawn if isinstance(drawn, bytes) else", "b'' if isinstance(drawn, bytes) else"),
    ],
)

RESUMED = [
    *of(
        "studies/montecarlo/store.py",
        f"{MONTECARLO}test_engine.py::test_a_damaged_part_is_set_aside_and_computed_again",
        [
            (
                "a part of other cases is taken",
                "if held != list(cases)[: len(held)]:",
                "if not held:",
            )
        ],
    ),
    *of(
        "studies/montecarlo/store.py",
        f"{MONTECARLO}test_engine.py::test_another_configuration_is_refused_in_one_line {MONTECARLO}test_engine.py",
        [
            (
                "a part of another study is taken",
                'if about["config_sha256"] != self.config_sha256:',
                'if not about["config_sha256"]:',
            )
        ],
    ),
    *of(
        "studies/montecarlo/store.py",
        f"{MONTECARLO}test_provenance.py",
        [("a study that grows keeps a part of fewer cases", "if len(held) == len(cases) else None", "if held else None")],
    ),
    *of(
        "studies/montecarlo/session.py",
        f"{MONTECARLO}test_provenance.py",
        [
            (
                "rows of edited sources are mixed",
                'edited = before["source_sha256"] != self.made_with["source_sha256"]',
                'edited = self.made_with["source_sha256"] != self.made_with["source_sha256"]',
            ),
            (
                "rows of another machine are mixed",
                'changes(before["machine"] or {}, self.made_with["machine"]) if more else ""',
                'changes(before["machine"] or {}, before["machine"]) if more else ""',
            ),
        ],
    ),
    *of(
        "studies/montecarlo/engine.py",
        f"{MONTECARLO}test_engine.py",
        [
            (
                "a rerun keeps the recording of case 0",
                "recording = study.recording(config, case, Streams(config.entropy, case))",
                "recording = study.recording(config, case, Streams(config.entropy, 0))",
            )
        ],
    ),
]

SEEDS = [
    *of(
        "studies/montecarlo/cases.py",
        f"{MONTECARLO}test_engine.py::test_the_table_holds_every_case_in_order {MONTECARLO}test_engine.py",
        [
            (
                "all cases draw what case 0 does",
                "made = study.case(config, case, Streams(config.entropy, case))",
                "made = study.case(config, case, Streams(config.entropy, 0))",
            )
        ],
    ),
    *of(
        "studies/montecarlo/study.py",
        f"{MONTECARLO}test_engine.py::test_neighbouring_entropies_share_no_case",
        [
            (
                "neighbouring entropies share their cases",
                "return generator(self.entropy, self.case, name)",
                "return generator(self.entropy + self.case, 0, name)",
            )
        ],
    ),
    *of(
        "studies/montecarlo/study.py",
        f"{MONTECARLO}test_study.py::test_the_hash_is_of_what_the_rows_depend_on",
        [
            (
                "the order of the dispersions is not in the hash",
                'list(document["dispersions"].items())',
                'sorted(document["dispersions"].items())',
            )
        ],
    ),
    *of(
        "studies/montecarlo/dispersions.py",
        f"{MONTECARLO}test_dispersions.py",
        [
            ("all paths draw alike", 'f"dispersions/{path}"', '"dispersions"'),
            ("Sobol's blocks overlap", "engine.fast_forward(block * SOBOL_BLOCK)", "engine.fast_forward(block)"),
            ("a factor is an offset", "else value * draw", "else value + draw"),
        ],
    ),
]

NUMBERS = [
    *of(
        "studies/montecarlo/statistics.py",
        f"{MONTECARLO}test_statistics.py",
        [
            (
                "NEES has one bound for two",
                "tail = (1 - confidence) / 2\n    lower, upper",
                "tail = 1 - confidence\n    lower, upper",
            ),
            ("all levels count one sigma", "inside = np.abs(errors) <= k * sigmas", "inside = np.abs(errors) <= sigmas"),
            ("an interval is not Wilson's", 'method="wilson"', 'method="exact"'),
        ],
    ),
    *of(
        "studies/montecarlo/until.py",
        f"{MONTECARLO}test_until.py",
        [("a half-width is a width", "return t * sigma / math.sqrt(n)", "return 2 * t * sigma / math.sqrt(n)")],
    ),
    *of(
        "studies/montecarlo/files.py",
        f"{MONTECARLO}test_files.py",
        [("tables have three digits", "table: pd.DataFrame, digits: int = 9)", "table: pd.DataFrame, digits: int = 3)")],
    ),
    *of(
        "studies/cli/options.py",
        "tests/studies/cli/test_scripts.py::test_what_is_not_known_fails",
        [
            (
                "what is not known does not fail",
                'met = not (value >= limit if sign == "<" else value <= limit)',
                'met = value < limit if sign == "<" else value > limit',
            )
        ],
    ),
    *of(
        "studies/report/printable.py",
        "tests/studies/cli/test_one_line.py",
        [("control characters reach the terminal", 'CONTROL = re.compile("[\\x00-\\x1f', 'CONTROL = re.compile("[\\x00-\\x1a')],
    ),
]

FAULTS = [*PAGES, *RESUMED, *SEEDS, *NUMBERS]
