"""Bad recordings of several star trackers or gyros (format 2), and to the commands that take more than one file."""

import json
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from tests.corpus.cases import FREE, JUDGED, Bad
from tests.corpus.headers import VALUES, write

TRACKERS, GYROS = "agile_trackers", "trmm_tetrahedron"
CONDITIONS = ("", "p", "p<", "<0.1", "p<x", "p<nan", "nothing<1", "p=1", "p<0.1<0.2", "\x1b[31m")
Change = Callable[[pd.DataFrame], pd.DataFrame]


def trackers() -> Iterator[Bad]:
    """Headers and attitude tables in which rows name their sensor."""
    said = ("name", "mounting", "estimated", "sigma_deg", "mounting_sigma_deg")
    for path in [("attitude", "sensor", 0, name) for name in said] + [("attitude", "maps"), ("format",)]:
        for kind, value in {**VALUES, "left out": None}.items():
            if value is not None or path[-1] not in ("sigma_deg", "mounting_sigma_deg"):
                yield _of(TRACKERS, "trackers", f"{'.'.join(map(str, path))}: {kind}", partial(_header, path=path, value=value))
    mountings = {
        "of norm 2": "[0.0, 0.0, 0.0, 2.0]",
        "of zeros": "[0.0, 0.0, 0.0, 0.0]",
        "of three": "[0.0, 0.0, 1.0]",
        "of the other": "[0.953716950748227, 0.0, 0.0, 0.300705799504273]",
        "scalar first": "[-0.300705799504273, 0.953716950748227, 0.0, 0.0]",
        "sensor to body": "[-0.953716950748227, 0.0, 0.0, -0.300705799504273]",
    }
    for kind, value in mountings.items():
        change = partial(_header, path=("attitude", "sensor", 0, "mounting"), value=value)
        yield _of(TRACKERS, "trackers", f"mounting {kind}", change)
    for kind, value in {"the same": '"st1"', "no digit": '"star"', "an axis": '"x"'}.items():
        yield _of(
            TRACKERS, "trackers", f"second name: {kind}", partial(_header, path=("attitude", "sensor", 1, "name"), value=value)
        )
    tables: dict[str, Change] = {
        "no column": lambda frame: frame.drop(columns="sensor"),
        "numbers": lambda frame: frame.assign(sensor=np.arange(len(frame)) % 2),
        "of none": lambda frame: frame.assign(sensor=None),
        "unknown": lambda frame: frame.assign(sensor="st3"),
        "one unknown": lambda frame: frame.assign(sensor=["st3", *frame["sensor"][1:]]),
        "exchanged": lambda frame: frame.assign(sensor=frame["sensor"].map({"st1": "st2", "st2": "st1"})),
        "all of one": lambda frame: frame.assign(sensor="st1"),
        "of the first alone": lambda frame: frame[frame["sensor"] == "st1"],
        "in capitals": lambda frame: frame.assign(sensor=frame["sensor"].str.upper()),
        "rows twice": lambda frame: pd.concat([frame, frame]).sort_values("t_s"),
        "shuffled": lambda frame: frame.sample(frac=1, random_state=0),
        "a row": lambda frame: frame.iloc[:1],
        "no sigma": lambda frame: frame.drop(columns=["sigma_x_deg", "sigma_y_deg", "sigma_z_deg"]),
    }
    for kind, change in tables.items():
        yield _of(TRACKERS, "trackers", f"sensor column: {kind}", partial(_table, name="attitude", change=change))
    for column in ("t_s", "q2", "sigma_z_deg"):
        for number in (np.nan, np.inf, 0.0, -1.0, 1e308):
            for where, rows in {"one": slice(40, 41), "all": slice(None)}.items():
                setting = partial(_set, column=column, rows=rows, number=number)
                yield _of(
                    TRACKERS,
                    "trackers",
                    f"{column} {number:g}, {where}",
                    partial(_table, name="attitude", change=setting),
                )
    for command in ("predict", "allan"):
        more = ("--from", "300") if command == "predict" else ()
        yield Bad("trackers", command, (command, "REC", *more), expected=FREE, scenario=TRACKERS)
    yield Bad("trackers", "export csv", ("export", "csv", "REC", "OUT"), expected=FREE, scenario=TRACKERS)


def gyros() -> Iterator[Bad]:
    """Headers and gyro tables of four gyros."""
    names = {
        "of three": '["1", "2", "3"]',
        "of five": '["1", "2", "3", "4", "5"]',
        "twice": '["1", "2", "3", "3"]',
        "axes": '["x", "y", "z", "4"]',
        "empty": '["1", "2", "3", ""]',
        "exchanged": '["2", "1", "3", "4"]',
        "numbers": "[1, 2, 3, 4]",
        "none": "[]",
        "many": json.dumps([str(number) for number in range(1000)]),
    }
    for kind, value in names.items():
        yield _of(GYROS, "gyros", f"names {kind}", partial(_header, path=("gyro", "names"), value=value))
    matrices = {
        "three columns": "[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]",
        "zeros": "[[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]]",
        "two rows": "[[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]]",
        "a plane": "[[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 0.0, 0.0]]",
        "huge": "[[1e308, 0.0, 0.0, 0.0], [0.0, 1e308, 0.0, 0.0], [0.0, 0.0, 1e308, 0.0]]",
    }
    for kind, value in matrices.items():
        yield _of(GYROS, "gyros", f"G of {kind}", partial(_header, path=("gyro", "apriori_G"), value=value))
    for kind, value in {"two": '["1", "2"]', "unknown": '["1", "2", "9"]', "none": "[]", "the same": '["1", "1", "2"]'}.items():
        yield _of(GYROS, "gyros", f"interval with {kind}", partial(_header, path=("interval", 0, "gyros"), value=value))
    swapped = {"rate_1_deg_s": "rate_2_deg_s", "rate_2_deg_s": "rate_1_deg_s"}
    tables: dict[str, Change] = {
        "one missing": lambda frame: frame.drop(columns="rate_4_deg_s"),
        "one of NaN": lambda frame: frame.assign(rate_4_deg_s=np.nan),
        "one of zeros": lambda frame: frame.assign(rate_4_deg_s=0.0),
        "one reversed": lambda frame: frame.assign(rate_4_deg_s=-frame["rate_4_deg_s"]),
        "one of another": lambda frame: frame.assign(rate_4_deg_s=frame["rate_3_deg_s"]),
        "one in rad": lambda frame: frame.assign(rate_4_deg_s=np.deg2rad(frame["rate_4_deg_s"])),
        "two exchanged": lambda frame: frame.rename(columns=swapped),
        "a NaN": partial(_set, column="rate_2_deg_s", rows=slice(40, 41), number=np.nan),
        "infinite": partial(_set, column="rate_2_deg_s", rows=slice(40, 41), number=np.inf),
        "huge": partial(_set, column="rate_2_deg_s", rows=slice(40, 41), number=1e308),
    }
    for kind, change in tables.items():
        yield _of(GYROS, "gyros", f"gyros: {kind}", partial(_table, name="gyro", change=change))
    yield _of(GYROS, "gyros", "no attitude", lambda folder: (folder / "REC" / "attitude.parquet").unlink())
    yield Bad("gyros", "to predict", ("predict", "REC", "--from", "1000"), expected=FREE, scenario=GYROS)


def following() -> Iterator[Bad]:
    """To `compare`: scenarios that cannot be compared with the recording."""
    for kind in ("nothing.toml", "", "/dev/null", "REC/gyro.parquet", "a\x1b[31m.toml"):
        yield Bad("compare", f"scenario {kind!a}", ("compare", "REC", kind))


def conditions() -> Iterator[Bad]:
    """Conditions for scripts that say nothing."""
    for command in ("calibrate", "diagnose"):
        for text in CONDITIONS:
            yield Bad("condition", f"{command} {text!a}", (command, "REC", f"--fail-on={text}"))


def exports() -> Iterator[Bad]:
    """Recordings that are none, to `export`."""
    for kind in ("nothing", "/dev/null", "REC/gyro.parquet"):
        yield Bad("export", f"csv of {kind}", ("export", "csv", kind, "OUT"))
    yield Bad("export", "csv, no attitude", ("export", "csv", "REC", "OUT"), partial(_gone, name="attitude"))
    yield Bad("export", "csv to /dev/full", ("export", "csv", "REC", "/dev/full"))


def _of(scenario: str, family: str, name: str, damage: Callable[[Path], object]) -> Bad:
    return Bad(family, name, ("calibrate", "REC"), damage, JUDGED, scenario)


def _header(folder: Path, path: tuple[object, ...], value: str | None) -> None:
    write(folder, "REC/recording.toml", path, value)


def _table(folder: Path, name: str, change: Change) -> None:
    path = folder / "REC" / f"{name}.parquet"
    change(pd.read_parquet(path)).to_parquet(path, index=False)


def _set(frame: pd.DataFrame, column: str, rows: slice, number: float) -> pd.DataFrame:
    frame.iloc[rows, frame.columns.get_loc(column)] = number  # type: ignore[index]
    return frame


def _gone(folder: Path, name: str) -> None:
    (folder / "REC" / f"{name}.parquet").unlink()
