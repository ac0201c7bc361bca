"""Bad tables of a recording: values, rows, columns and files."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from tests.corpus.cases import JUDGED, REFUSED, Bad

TABLES = {"gyro": ("t_s", "rate_x_deg_s"), "attitude": ("t_s", "q1", "q4", "sigma_x_deg")}
NUMBERS = (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e-308, 0.0, -1.0, 1e12)
Change = Callable[[pd.DataFrame], pd.DataFrame]


def values() -> Iterator[Bad]:
    """One value, or a column of them, is another."""
    for table, columns in TABLES.items():
        for column in columns:
            for number in NUMBERS:
                for where, rows in {
                    "first": slice(0, 1),
                    "middle": slice(40, 41),
                    "last": slice(-1, None),
                    "all": slice(None),
                }.items():
                    change = _setting(column, rows, number)
                    yield _bad(table, f"{column} {number:g}, {where}", change, JUDGED)
            for kind, made in KINDS.items():
                yield _bad(table, f"{column} of {kind}", _column(column, made), JUDGED)


KINDS: dict[str, Callable[[pd.Series], object]] = {
    "text": lambda column: column.astype(str),
    "booleans": lambda column: column > 0,
    "integers": lambda column: column.round().astype("int64"),
    "single precision": lambda column: column.astype("float32"),
    "objects": lambda column: [None] * len(column),
    "dates": lambda column: pd.to_datetime(column.abs(), unit="s"),
    "lists": lambda column: [[value] for value in column],
    "categories": lambda column: column.astype("category"),
}


def rows() -> Iterator[Bad]:
    """Rows are missing, doubled, or in another order."""
    changes: dict[str, Change] = {
        "none": lambda frame: frame.iloc[:0],
        "one": lambda frame: frame.iloc[:1],
        "two": lambda frame: frame.iloc[:2],
        "three": lambda frame: frame.iloc[:3],
        "reversed": lambda frame: frame.iloc[::-1],
        "shuffled": lambda frame: frame.sample(frac=1, random_state=0),
        "doubled": lambda frame: pd.concat([frame, frame]),
        "every other": lambda frame: frame.iloc[::2],
        "first half": lambda frame: frame.iloc[: len(frame) // 2],
        "one twice": lambda frame: frame.iloc[[*range(5), 4, *range(5, len(frame))]],
        "an hour later": lambda frame: frame.assign(t_s=frame["t_s"] + 3600),
        "unix time": lambda frame: frame.assign(t_s=frame["t_s"] + 1.7e9),
        "milliseconds": lambda frame: frame.assign(t_s=frame["t_s"] * 1e3),
        "all columns the same": lambda frame: frame.assign(**dict.fromkeys(frame.columns[1:], frame.iloc[:, 1])),
        "column twice": lambda frame: pd.concat([frame, frame["t_s"]], axis=1),
        "no columns": lambda frame: frame[[]],
        "columns numbered": lambda frame: frame.set_axis(range(frame.shape[1]), axis=1),
    }
    for table in TABLES:
        for kind, change in changes.items():
            yield _bad(table, f"rows: {kind}", change, JUDGED)
        for column in TABLES[table]:
            yield _bad(table, f"without {column}", lambda frame, column=column: frame.drop(columns=column), REFUSED)
            renamed = column.replace("_deg", "_rad") if "deg" in column else column.upper()
            yield _bad(
                table, f"{column} as {renamed}", lambda frame, a=column, b=renamed: frame.rename(columns={a: b}), REFUSED
            )


def text_files() -> Iterator[Bad]:
    """CSV as programs, or people, write it."""
    edits: dict[str, tuple[Callable[[str], str], str]] = {
        "decimal commas": (lambda text: text.replace(".", ","), REFUSED),
        "semicolons": (lambda text: text.replace(",", ";"), REFUSED),
        "semicolons and decimal commas": (lambda text: text.replace(",", ";").replace(".", ","), REFUSED),
        "tabs": (lambda text: text.replace(",", "\t"), REFUSED),
        "comment before": (lambda text: "# made by hand\n" + text, REFUSED),
        "comment within": (lambda text: _line(text, 5, "# a comment"), REFUSED),
        "comment after": (lambda text: text + "# end\n", REFUSED),
        "a field more": (lambda text: _line(text, 5, text.splitlines()[5] + ",7"), REFUSED),
        "a field more in all": (lambda text: _all_rows(text, lambda line: line + ",7"), REFUSED),
        "a field less": (lambda text: _line(text, 5, text.splitlines()[5].rpartition(",")[0]), REFUSED),
        "comma at the end": (lambda text: _all_rows(text, lambda line: line + ","), JUDGED),
        "two commas at the end": (lambda text: _all_rows(text, lambda line: line + ",,"), JUDGED),
        "empty line": (lambda text: _line(text, 5, ""), JUDGED),
        "open quote": (lambda text: _line(text, 5, '"' + text.splitlines()[5]), REFUSED),
        "quotes": (lambda text: _all_rows(text, lambda line: ",".join(f'"{one}"' for one in line.split(","))), JUDGED),
        "byte order mark": (lambda text: "\ufeff" + text, JUDGED),
        "NUL": (lambda text: _line(text, 5, text.splitlines()[5] + "\x00"), REFUSED),
        "carriage returns": (lambda text: text.replace("\n", "\r"), JUDGED),
        "only a header": (lambda text: text.splitlines()[0] + "\n", REFUSED),
        "no header": (lambda text: text.partition("\n")[2], REFUSED),
        "empty": (lambda text: "", REFUSED),
        "blank": (lambda text: "\n\n", REFUSED),
        "cut": (lambda text: text[: len(text) // 2], JUDGED),
        "units below the header": (lambda text: _line(text, 1, "s" + ",deg" * text.splitlines()[0].count(",")), REFUSED),
        "a word": (lambda text: _line(text, 5, "n/a" + "," * text.splitlines()[0].count(",")), REFUSED),
        "a long field": (lambda text: _line(text, 5, "9" * 200_000 + text.splitlines()[5]), REFUSED),
        "blanks": (lambda text: text.replace(",", " , "), JUDGED),
        "thousands": (lambda text: text.replace(".0,", ".000.000,"), REFUSED),
        "escape": (lambda text: text.replace("t_s", "\x1b[31mt_s", 1), REFUSED),
    }
    for table in TABLES:
        for kind, (edit, expected) in edits.items():

            def damage(folder: Path, table: str = table, edit: Callable[[str], str] = edit) -> None:
                path = folder / "REC" / f"{table}.parquet"
                text = pd.read_parquet(path).to_csv(index=False)
                path.unlink()
                path.with_suffix(".csv").write_text(edit(text), encoding="utf-8", newline="")

            yield Bad(f"{table}.csv", kind, ("calibrate", "REC"), damage, expected)


def files() -> Iterator[Bad]:
    """Files that are damaged, missing, or something else."""
    rng = np.random.default_rng(11)
    for table in TABLES:
        name = f"REC/{table}.parquet"
        edits: dict[str, Callable[[Path], object]] = {
            "missing": lambda path: path.unlink(),
            "empty": lambda path: path.write_bytes(b""),
            "a folder": lambda path: (path.unlink(), path.mkdir()),
            "text": lambda path: path.write_text("t_s\n1\n"),
            "zeros": lambda path: path.write_bytes(bytes(path.stat().st_size)),
            "link to nothing": lambda path: (path.unlink(), path.symlink_to("nothing")),
            "both kinds": lambda path: path.with_suffix(".csv").write_text("t_s\n1\n"),
        }
        for kind, edit in edits.items():
            yield Bad(f"{table}.parquet", kind, ("calibrate", "REC"), lambda folder, e=edit, n=name: e(folder / n))
        for share in (0.1, 0.5, 0.9, 0.999):
            yield Bad(f"{table}.parquet", f"cut at {share:g}", ("calibrate", "REC"), _cut(name, share))
        for place in rng.uniform(size=25):
            yield Bad(f"{table}.parquet", f"byte at {place:.4f}", ("calibrate", "REC"), _flip(name, place), JUDGED)
    for kind in ("nothing", "", "REC/recording.toml", "/dev/null", "/", "REC/gyro.parquet", "a\x1b[2J"):
        yield Bad("recording", f"path {kind!a}", ("calibrate", kind))
    for command in (("allan",), ("diagnose",), ("predict", "--from", "100"), ("compare",)):
        yield Bad("recording", f"nothing, {command[0]}", (*command, "nothing"))
        for kind in ("none", "one", "two"):
            count = ("none", "one", "two").index(kind)
            yield Bad("recording", f"{kind} rows, {command[0]}", (*command, "REC"), _cut_rows(count))


def _bad(table: str, name: str, change: Change, expected: str) -> Bad:
    def damage(folder: Path) -> None:
        path = folder / "REC" / f"{table}.parquet"
        change(pd.read_parquet(path)).to_parquet(path, index=False) if name != "rows: column twice" else _twice(path)

    return Bad(f"{table} table", name, ("calibrate", "REC"), damage, expected)


def _twice(path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pq.read_table(path)
    pq.write_table(pa.table([*table.columns, table.column(0)], names=[*table.column_names, "t_s"]), path)


def _setting(column: str, rows: slice, number: float) -> Change:
    def change(frame: pd.DataFrame) -> pd.DataFrame:
        frame.iloc[rows, frame.columns.get_loc(column)] = number  # type: ignore[index]
        return frame

    return change


def _column(column: str, made: Callable[[pd.Series], object]) -> Change:
    return lambda frame: frame.assign(**{column: made(frame[column])})


def _line(text: str, number: int, line: str) -> str:
    lines = text.splitlines()
    return "\n".join([*lines[:number], line, *lines[number:]]) + "\n"


def _all_rows(text: str, edit: Callable[[str], str]) -> str:
    header, *lines = text.splitlines()
    return "\n".join([header, *map(edit, lines)]) + "\n"


def _cut(name: str, share: float) -> Callable[[Path], object]:
    def damage(folder: Path) -> None:
        data = (folder / name).read_bytes()
        (folder / name).write_bytes(data[: int(len(data) * share)])

    return damage


def _flip(name: str, place: float) -> Callable[[Path], object]:
    def damage(folder: Path) -> None:
        data = bytearray((folder / name).read_bytes())
        data[int(place * len(data))] ^= 0x55
        (folder / name).write_bytes(data)

    return damage


def _cut_rows(count: int) -> Callable[[Path], object]:
    def damage(folder: Path) -> None:
        path = folder / "REC" / "gyro.parquet"
        pd.read_parquet(path).iloc[:count].to_parquet(path, index=False)

    return damage
