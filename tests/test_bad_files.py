"""Bad files end in an answer or in one line: no traceback, and no wrong calibration that its report does not doubt."""

import json
import re
import shutil
import tempfile
import warnings
from contextlib import chdir
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from simulator import scenario
from studies.cli.main import main
from tests.gyrocal.importing.mems import AEM

SIGMAS = 6.0
DOUBTS = ("do not trust the sigmas", "smaller than the stated noise", "Not determined by the data", "No degrees of freedom")
COARSE = ("--set", "gyro.sample_s=5.0")
CALIBRATE = ("calibrate", "REC", "--json", "result.json")
COMMANDS = {  # by the file that is bad
    "mine.toml": ("simulate", "mine.toml", "OUT", *COARSE),
    "good.json": ("predict", "REC", "--from", "1000", "--calibration", "good.json"),
    "truth.json": ("calibrate", "REC", "--truth", "truth.json"),
}
WHOLE = (
    *(b"", bytes(range(256)), "format = 1".encode("utf-16"), b'title = "a', b"a = " + b"[" * 5000, b"a = " + b"{a = " * 2000),
    *(b"a = " + b"1" * 5000, b"a = 1\na = 1\n", b"a = 1\n\x00\n", b'{"a": 1}', b'base = "mine.toml"', b"[" * 100_000),
)
TOML = (
    *('"a word"', '""', "[]", "{ a = 1 }", "true", "nan", "inf", "-1.0", "0.0", "1e308", "1e-308", "9" * 400, "1979-05-27"),
    *('"\\u001b[31mred"', "1.0\nunknown = 4", "[[1.0, 2.0], [3.0]]", "[0.0, 0.0, 0.0]", ""),
)
JSON = (
    *('"a"', '["a", "b", "c"]', "[[1, 0], [0]]", "[]", "{}", "null", "NaN", "Infinity", "1e999", "-1.0", "0.0", "true"),
    *("9" * 10_000, "[" * 5_000 + "]" * 5_000, ""),
)
COLUMNS = [("gyro", "t_s"), ("gyro", "rate_x_deg_s"), *(("attitude", name) for name in ("t_s", "q1", "q4", "sigma_x_deg"))]
NUMBERS = (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e-308, 0.0, -1.0, 1e12)
PLACES = (slice(0, 1), slice(40, 41), slice(-1, None), slice(None))
KINDS = (
    *(lambda one: one.astype(str), lambda one: one > 0, lambda one: [None] * len(one), lambda one: [[value] for value in one]),
    *(lambda one: pd.to_datetime(one.abs(), unit="s"), lambda one: one.astype("category")),
)
TABLES = {
    **{f"{count} rows": lambda table, count=count: table.iloc[:count] for count in range(4)},
    "reversed": lambda table: table.iloc[::-1],
    "doubled": lambda table: pd.concat([table, table]),
    "milliseconds": lambda table: table.assign(t_s=1e3 * table["t_s"]),
    "one column": lambda table: table.assign(**dict.fromkeys(table.columns[1:], table.iloc[:, 1])),
    "no columns": lambda table: table[[]],
    "radians": lambda table: table.rename(columns=lambda name: name.replace("_deg", "_rad")),
}
CSV = {
    "decimal commas": lambda text: text.replace(".", ","),
    "open quote": lambda text: text.replace("\n", '\n"', 5).replace('\n"', "\n", 4),
    "byte order mark": lambda text: "\ufeff" + text,
    "carriage returns": lambda text: text.replace("\n", "\r"),
    "empty": lambda text: "",
    "units": lambda text: text.replace("\n", "\ns" + ",deg" * text.partition("\n")[0].count(",") + "\n", 1),
    "a field more": lambda text: text.replace("\n", ",7\n").replace(",7\n", "\n", 1),
    "a long field": lambda text: text.replace("\n", "\n" + "9" * 200_000, 5),
    "escape": lambda text: text.replace("t_s", "\x1b[31mt_s", 1),
}
FILES = {
    "missing": Path.unlink,
    "a folder": lambda path: (path.unlink(), path.mkdir()),
    "a link to nothing": lambda path: (path.unlink(), path.symlink_to("nothing")),
    "CSV": lambda path: path.write_text("t_s,rate_x_deg_s\n0,0\n"),
}
HEADER = "REC/recording.toml"


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """A small recording, its truth, its calibration and a table of another program, in a folder."""
    folder = tmp_path_factory.mktemp("good")
    t_s = 0.1 * np.arange(200)
    noise = np.random.default_rng(1).normal(size=(2, 200, 3))
    rates = np.column_stack([30 * np.sin(t_s), 20 * np.cos(0.7 * t_s), 10 * np.sin(0.3 * t_s)])
    q, bodies = Rotation.identity(), []
    for rate, own in zip(rates, noise[1], strict=True):
        bodies.append((q * Rotation.from_rotvec(0.05 * own, degrees=True)).as_quat())
        q = q * Rotation.from_rotvec(0.1 * rate, degrees=True)
    numbers = np.column_stack([t_s, rates + 0.05 * noise[0], bodies])
    rows = [",".join(f"{value:.6f}" for value in row) for row in numbers]
    (folder / "a.csv").write_text("\n".join(["t,gx,gy,gz,q1,q2,q3,q4", *rows, ""]))
    write_message(folder, [row.split(",") for row in rows])
    (folder / "mine.toml").write_text(scenario.read_text("trmm"))
    with chdir(folder):
        options = (*COARSE, "--set", "reference.every_s=300.0", "--seed", "1", "--truth", "truth.json")
        for words in (("simulate", "trmm_series", "REC", *options), ("calibrate", "REC", "--json", "good.json")):
            assert CliRunner().invoke(main, words).exit_code == 0
    return folder


def write_message(folder, rows):
    """The same log as a message beside a table."""
    dates = [f"2020-08-16T12:02:{float(row[0]):09.6f}" for row in rows]
    gyro = [f"{date},{','.join(row[1:4])}" for date, row in zip(dates, rows, strict=True)]
    (folder / "g.csv").write_text("\n".join(["time,gx,gy,gz", *gyro, ""]))
    (folder / "a.aem").write_text(
        AEM.format(rows="\n".join(" ".join([date, *row[4:]]) for date, row in zip(dates, rows, strict=True)))
    )


def ends_well(good, arguments, damage=lambda folder: None, said=""):
    """Run a command on a copy to which something was done; its output if it was answered, False if it was refused."""
    with tempfile.TemporaryDirectory() as name, chdir(name), warnings.catch_warnings():
        warnings.simplefilter("default")
        shutil.copytree(good, name, dirs_exist_ok=True)
        damage(Path(name))
        result = CliRunner().invoke(main, arguments)
        assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
        if result.exit_code:
            assert result.exit_code == 2
            assert re.fullmatch(rf"gyrocal[^:\n]*: [^\n\x1b]*{said}[^\n\x1b]*\n", result.stderr), result.stderr
            return False
        if arguments == CALIBRATE and not any(doubt in result.stdout for doubt in DOUBTS):
            found, truth = (json.loads(Path(file).read_text()) for file in ("result.json", "truth.json"))
            error = np.array([*np.ravel(found["G"]), *found["bias_deg_s"]]) - [*np.ravel(truth["G"]), *truth["bias_deg_s"]]
            assert (np.abs(error) <= SIGMAS * np.array([row["sigma"] for row in found["estimates"]])).all()
        return result.stdout or True


def edit(name, change):
    """Change a table of the recording."""

    def damage(folder):
        path = folder / "REC" / f"{name}.parquet"
        change(pd.read_parquet(path)).to_parquet(path, index=False)

    return damage


def put(name, column, place, number):
    def change(table):
        table.iloc[place, table.columns.get_loc(column)] = number
        return table

    return edit(name, change)


def write_csv(name, change):
    def damage(folder):
        path = folder / "REC" / f"{name}.parquet"
        path.with_suffix(".csv").write_text(change(pd.read_parquet(path).to_csv(index=False)), newline="")
        path.unlink()

    return damage


def replace_value(file, share, value, separator):
    """Replace the value behind a ``=`` or ``:`` in one line of a file."""

    def damage(folder):
        lines = (folder / file).read_text().splitlines()
        places = [number for number, line in enumerate(lines) if separator in line]
        place = places[int(share * len(places))]
        key, _, old = lines[place].partition(separator)
        lines[place] = f"{key}{separator} {value}{',' if old.endswith(',') else ''}" if value else ""
        (folder / file).write_text("\n".join(lines))

    return damage


def values(file):
    separator, words = ("=", TOML) if file.endswith(".toml") else (":", JSON)
    return st.builds(lambda share, word: replace_value(file, share, word, separator), SHARES, st.sampled_from(words))


def contents(file):
    return st.sampled_from(WHOLE).map(lambda data: lambda folder: (folder / file).write_bytes(data))


SHARES = st.floats(0, 1, exclude_max=True)
NUMBERS_PUT = st.builds(lambda column, *given: put(*column, *given), *map(st.sampled_from, (COLUMNS, PLACES, NUMBERS)))
KINDS_PUT = st.builds(
    lambda column, kind: edit(column[0], lambda table: table.assign(**{column[1]: kind(table[column[1]])})),
    *map(st.sampled_from, (COLUMNS, KINDS)),
)


NAMES = st.sampled_from(("gyro", "attitude"))
TABLES_PUT = st.builds(lambda name, change: edit(name, change), NAMES, st.sampled_from(list(TABLES.values())))
CSV_PUT = st.builds(lambda name, change: write_csv(name, change), NAMES, st.sampled_from(list(CSV.values())))
FILES_PUT = st.builds(
    lambda name, change: lambda folder: change(folder / f"REC/{name}.parquet"), NAMES, st.sampled_from(list(FILES.values()))
)


@settings(max_examples=60)
@given(st.one_of(NUMBERS_PUT, KINDS_PUT, TABLES_PUT, CSV_PUT, FILES_PUT, values(HEADER), contents(HEADER)))
def test_a_bad_recording(good, damage):
    ends_well(good, CALIBRATE, damage)


@pytest.mark.parametrize(("file", "command"), COMMANDS.items())
@settings(max_examples=15)
@given(st.data())
def test_a_bad_scenario_calibration_or_truth(good, file, command, data):
    ends_well(good, command, data.draw(st.one_of(values(file), contents(file))))


IMPORT = {"--time": "t:s", "--gyro": "gx,gy,gz:deg/s", "--quat": "q1,q2,q3,q4:body-to-inertial:scalar-last"}
LOST = ("", "inf", "nan", "-nan(ind)", "9" * 400)  # cells that are no numbers: what is read of them is said or refused
CELLS = (*LOST, "a", "1e300", "0", "-1", "1,2", '"', "\x00")
READERS = {  # the command, and the files of it with their separators
    "csv": (("csv", "a.csv"), {"a.csv": ","}),
    "aem": (("aem", "g.csv", "a.aem"), {"g.csv": ",", "a.aem": " "}),
}
OPTIONS = {"csv": IMPORT, "aem": {"--time": "time:iso", "--gyro": IMPORT["--gyro"]}}
DAMAGES = st.one_of(
    st.tuples(st.just("cell"), st.sampled_from(CELLS), st.integers(0, 7), st.booleans()),
    st.tuples(st.sampled_from(["cut", "line twice", "lines exchanged"])),
    st.tuples(st.just("bytes"), st.binary(min_size=1, max_size=4)),
)


def spoil(folder, file, separator, damage, share):
    """Change a file in one place, or one column of it in every row."""
    data = (folder / file).read_bytes()
    lines = data.decode().splitlines()
    first = next(k for k, line in enumerate(lines) if len(line.split(separator)) > 3 and k > 0)
    rows = [k for k in range(first, len(lines)) if len(lines[k].split(separator)) > 3]
    at = rows[int(share * len(rows))]
    match damage:
        case "cell", text, column, everywhere:
            for k in rows if everywhere else [at]:
                cells = lines[k].split(separator)
                cells[column % len(cells)] = text
                lines[k] = separator.join(cells)
        case ["line twice"]:
            lines.insert(at, lines[at])
        case ["lines exchanged"]:
            lines[at], lines[rows[-1]] = lines[rows[-1]], lines[at]
        case ["cut"]:
            data = data[: int(share * len(data))]
        case "bytes", more:
            data = data[: int(share * len(data))] + more + data[int(share * len(data)) :]
    (folder / file).write_bytes(data if damage[0] in ("cut", "bytes") else "\n".join([*lines, ""]).encode())


def list_sentences(text):
    """What an import says, without its numbers."""
    return {re.sub(r"[-+\d.e]+", "#", line) for line in re.sub(r" *│\n│ +│ ", " ", text).splitlines()}


def list_words(reader):
    return ("import", *READERS[reader][0], "OUT", *[f"{key}={text}" for key, text in OPTIONS[reader].items()])


@cache
def answer_clean(good, reader):
    """The answer to the files of a reader as they are."""
    return ends_well(good, list_words(reader))


@settings(max_examples=20)
@given(st.sampled_from(list(READERS)), st.integers(0, 1), DAMAGES, SHARES)
def test_a_bad_import(good, reader, file, damage, share):
    clean, files = list_words(reader), READERS[reader][1]
    file = list(files)[file % len(files)]
    answer = ends_well(good, clean, lambda folder: spoil(folder, file, files[file], damage, share))
    if answer and damage[0] == "cell" and damage[1] in LOST:
        assert list_sentences(answer) - list_sentences(answer_clean(good, reader))


def substitute(path, old, new):
    path.write_text(re.sub(old, new, path.read_text()))


def test_what_is_good_is_answered_and_a_silent_error_is_seen(good):
    for words in (CALIBRATE, *COMMANDS.values(), *map(list_words, READERS)):
        assert ends_well(good, words)
    with pytest.raises(AssertionError):
        ends_well(good, CALIBRATE, lambda folder: substitute(folder / "truth.json", r"1\.000443", "1.01"))
