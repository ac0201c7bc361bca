"""Damaged recordings: what an operations team may hand over by mistake, each a small recording with one thing wrong.

A damage changes the files of an intact recording in a folder. `damages` lists all of them by name; `intact` writes the
recording that they are done to. `PYTHONPATH=. python -m tests.corpus_recordings` runs `gyrocal.load`, `gyrocal.calibrate` and
`diagnosis.diagnose.diagnose` on each and prints what they say: nothing but an answer or one line of a `GyrocalError` is right.
"""

from __future__ import annotations

import itertools
import os
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from diagnosis.diagnose import diagnose
from diagnosis.settings import DiagnosisSettings
from gyrocal import GyrocalError, Orbit, Recording, calibrate, load, save
from tests.builders import piecewise_recording

Damage = Callable[[Path], None]
Frame = pd.DataFrame

SLEW = np.deg2rad(1.5)
AXES = np.vstack([np.eye(3), -np.eye(3), np.ones((1, 3)) / np.sqrt(3)])
PLAN = tuple(((tuple(0 * axis), 20.0), (tuple(SLEW * axis), 60.0), (tuple(0 * axis), 20.0)) for axis in AXES)
RATES = ("rate_x_deg_s", "rate_y_deg_s", "rate_z_deg_s")
QUATERNION = ("q1", "q2", "q3", "q4")
SIGMAS = ("sigma_x_deg", "sigma_y_deg", "sigma_z_deg")
EXTREMES = (1e300, -1e300, 1e-310, np.nan, np.inf, -np.inf)
QUICK = DiagnosisSettings(null_draws=20)  # of an answer, here, only that there is one matters


def slews(seed: int = 1) -> Recording:
    """The recording that the damages are done to: seven slews of 90 deg, about each axis, with rests."""
    arw = np.deg2rad(2e-4)
    recording = piecewise_recording(
        PLAN, 0.5, series_s=5.0, sigma_deg=0.01, arw=arw, rng=np.random.default_rng(seed), gap_s=50.0
    )
    return replace(recording, orbit=Orbit(500.0, 350.0, 35.0))


def intact(folder: Path) -> Path:
    """Write it with a gyro temperature."""
    save(slews(), folder)
    gyro = pd.read_parquet(folder / "gyro.parquet")
    warm = 20.0 + 0.01 * gyro["t_s"]
    pd.DataFrame({"t_s": gyro["t_s"], "gyro_temperature_c": warm}).to_parquet(folder / "housekeeping.parquet", index=False)
    return folder


def damages() -> Iterator[tuple[str, Damage]]:
    """All damages with their names."""
    yield from _readings()
    yield from _streams()
    yield from _noises()
    yield from _values()
    yield from _headers()
    yield from _files()


def _of(table: str, change: Callable[[Frame], Frame]) -> Damage:
    """A damage to one table."""

    def damage(folder: Path) -> None:
        path = folder / f"{table}.parquet"
        change(pd.read_parquet(path)).to_parquet(path, index=False)

    return damage


def _of_header(old: str, new: str) -> Damage:
    """A damage to the header: all lines that begin with one text are replaced by another."""

    def damage(folder: Path) -> None:
        path = folder / "recording.toml"
        lines = path.read_text().splitlines()
        assert any(line.startswith(old) for line in lines), old
        path.write_text("\n".join(new if line.startswith(old) else line for line in lines) + "\n")

    return damage


def _set(columns: tuple[str, ...], change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Frame], Frame]:
    return lambda frame: frame.assign(**dict(zip(columns, change(frame[list(columns)].to_numpy()).T, strict=True)))


def _put(column: str, rows: slice | int, value: float) -> Callable[[Frame], Frame]:
    def change(frame: Frame) -> Frame:
        values = frame[column].to_numpy(dtype=float).copy()
        values[rows] = value
        return frame.assign(**{column: values})

    return change


def _readings() -> Iterator[tuple[str, Damage]]:
    """Tables that are read in another way than they were written."""
    rates, turned = "gyro", "attitude"
    for name, factor in {
        "deg/h taken for deg/s": 3600.0,
        "deg/s taken for deg/h": 1 / 3600,
        "rad/s taken for deg/s": np.pi / 180,
        "deg/s taken for rad/s": 180 / np.pi,
        "rates x 1000": 1000.0,
        "rates / 1000": 1e-3,
        "rates reversed": -1.0,
        "rates doubled": 2.0,
    }.items():
        yield name, _of(rates, _set(RATES, lambda values, factor=factor: factor * values))
    for order in list(itertools.permutations(range(3)))[1:]:
        yield f"rates ordered {order}", _of(rates, _set(RATES, lambda values, order=order: values[:, order]))
        whole = (*order, 3)
        yield f"quaternion ordered {whole}", _of(turned, _set(QUATERNION, lambda values, whole=whole: values[:, whole]))
    for axis in range(3):
        sign = np.where(np.arange(3) == axis, -1.0, 1.0)
        yield f"rate {axis} reversed", _of(rates, _set(RATES, lambda values, sign=sign: values * sign))
        four = np.append(sign, 1.0)
        yield f"q{axis + 1} reversed", _of(turned, _set(QUATERNION, lambda values, four=four: values * four))
        yield f"rate {axis} zero", _of(rates, _put(RATES[axis], slice(None), 0.0))
    yield "scalar first", _of(turned, _set(QUATERNION, lambda values: np.roll(values, 1, axis=1)))
    yield "body to inertial", _of(turned, _set(QUATERNION, lambda values: values * [-1, -1, -1, 1]))
    yield "one attitude throughout", _of(turned, _set(QUATERNION, lambda values: np.tile(values[:1], (len(values), 1))))
    yield "attitudes shuffled", _of(turned, _set(QUATERNION, lambda q: q[np.random.default_rng(1).permutation(len(q))]))
    yield "signs of quaternions", _of(turned, _set(QUATERNION, lambda q: q * np.where(np.arange(len(q)) % 2, -1, 1)[:, None]))
    for name, value in {"zero": 0.0, "constant": 0.1}.items():
        yield f"rates all {name}", _of(rates, _set(RATES, lambda values, value=value: 0 * values + value))
    for offset in (10.0, -10.0, 100.0, 1e9):
        yield f"gyro {offset:+g} s", _of(rates, _set(("t_s",), lambda values, offset=offset: values + offset))
        yield f"attitude {offset:+g} s", _of(turned, _set(("t_s",), lambda values, offset=offset: values + offset))
    yield "all times in ms", _everywhere(lambda folder: [_scaled_time(folder, name, 1e3) for name in ("gyro", "attitude")])
    for bias in (0.01, 1.0, 100.0):
        yield f"bias of {bias} deg/s", _of(rates, _set(RATES, lambda values, bias=bias: values + bias))


def _everywhere(change: Callable[[Path], object]) -> Damage:
    def damage(folder: Path) -> None:
        change(folder)

    return damage


def _scaled_time(folder: Path, table: str, factor: float) -> None:
    _of(table, _set(("t_s",), lambda values: values * factor))(folder)


def _streams() -> Iterator[tuple[str, Damage]]:
    """Streams that lack something or have too much of it."""
    for each in (2, 5, 50):
        yield f"every {each}th sample", _of("gyro", lambda frame, each=each: frame.iloc[::each])
        yield f"without every {each}th sample", _of("gyro", lambda frame, each=each: frame[frame.index % each != 0])
        yield f"every {each}th attitude", _of("attitude", lambda frame, each=each: frame.iloc[::each])
    yield "one sample", _of("gyro", lambda frame: frame.iloc[:1])
    yield "no sample", _of("gyro", lambda frame: frame.iloc[:0])
    yield "first half of the samples", _of("gyro", lambda frame: frame.iloc[: len(frame) // 2])
    yield "samples twice", _of("gyro", lambda frame: frame.loc[frame.index.repeat(2)])
    yield "samples in reverse", _of("gyro", lambda frame: frame.iloc[::-1])
    yield "one attitude", _of("attitude", lambda frame: frame.iloc[:1])
    yield "two attitudes an interval", _of("attitude", lambda frame: frame[frame.index % 21 % 20 == 0])
    yield "attitudes twice", _of("attitude", lambda frame: frame.loc[frame.index.repeat(2)])
    for count in (1, 2, 3, 4, 5, 8):
        yield f"intervals of {count} samples", lambda folder, count=count: _short(folder, count)
    yield "gap in the stream", _of("gyro", lambda frame: frame.drop(frame.index[100:120]))
    yield "frozen from the middle", _of("gyro", _set(RATES, lambda x: np.where(np.arange(len(x))[:, None] < 700, x, x[700])))
    yield "on two values", _of("gyro", _set(RATES, np.sign))
    yield "on a coarse lattice", _of("gyro", _set(RATES, lambda x: np.round(x / 0.5) * 0.5))
    yield "clipped at once", _of("gyro", _set(RATES, lambda x: np.clip(x, -0.001, 0.001)))
    yield "clipped", _of("gyro", _set(RATES, lambda x: np.clip(x, -1.2, 1.2)))
    yield "spikes", _of("gyro", _set(RATES, lambda x: x + 30 * (np.arange(x.size).reshape(x.shape) % 97 == 5)))
    yield "one huge spike", _of("gyro", _put(RATES[1], 300, 8.9e4))
    yield "an attitude 60 deg off", _of("attitude", lambda frame: _turned(frame, 30, 60.0))
    yield "a first attitude 60 deg off", _of("attitude", lambda frame: _turned(frame, 21, 60.0))


def _turned(frame: Frame, row: int, angle_deg: float) -> Frame:
    q = frame[list(QUATERNION)].to_numpy().copy()
    q[row] = (Rotation.from_quat(q[row]) * Rotation.from_rotvec(np.deg2rad([angle_deg, 0, 0]))).as_quat()
    return frame.assign(**dict(zip(QUATERNION, q.T, strict=True)))


def _short(folder: Path, count: int) -> None:
    """Intervals of a few samples, with an attitude at either end."""
    gyro, attitude = (pd.read_parquet(folder / f"{name}.parquet") for name in ("gyro", "attitude"))
    text = (folder / "recording.toml").read_text()
    head, *_ = text.partition("[[interval]]")
    rows = range(0, 140, 5 * max(1, count // 2))
    pairs = [(attitude.iloc[21 * (k // 20) + k % 20], f"i{k}") for k in rows]
    kept, blocks = [], []
    for one, name in pairs:
        start, stop = float(one["t_s"]), float(one["t_s"]) + 0.5 * count
        kept += [one, one.replace({one["t_s"]: stop})]
        blocks.append(f'[[interval]]\nname = "{name}"\nactivity = "short"\nstart_s = {start}\nstop_s = {stop}\n')
    (folder / "recording.toml").write_text(head + "\n".join(blocks))
    frame = pd.DataFrame(kept).sort_values("t_s").drop_duplicates("t_s")
    frame.to_parquet(folder / "attitude.parquet", index=False)
    gyro.to_parquet(folder / "gyro.parquet", index=False)


def _noises() -> Iterator[tuple[str, Damage]]:
    """Stated noise that is not that of the data."""
    for value in (0.0, 1e-300, 1e-20, 1e-9, 1.0, 1e3):
        yield f"arw {value:g}", _of_header("arw_deg_per_sqrt_s", f"arw_deg_per_sqrt_s = {value!r}")
    for value in (1e-300, 1e-9, 1e-6, 1.0, 179.0, 0.0, -0.01):
        yield f"sigma {value:g}", _of("attitude", _set(SIGMAS, lambda x, value=value: 0 * x + value))
    yield (
        "sigma and arw of 1e-9",
        lambda folder: [
            _of_header("arw_deg_per_sqrt_s", "arw_deg_per_sqrt_s = 1e-9")(folder),
            _of("attitude", _set(SIGMAS, lambda x: 0 * x + 1e-9))(folder),
        ],
    )
    yield "one sigma of 1e-9", _of("attitude", _put(SIGMAS[0], 40, 1e-9))
    yield "one axis of 179 deg", _of("attitude", _put(SIGMAS[2], slice(None), 179.0))


def _values() -> Iterator[tuple[str, Damage]]:
    """Numbers that are none, or hardly."""
    columns = [("gyro", "t_s"), ("gyro", RATES[0]), ("attitude", "t_s"), ("attitude", "q1"), ("attitude", SIGMAS[1])]
    for (table, column), value in itertools.product([*columns, ("housekeeping", "gyro_temperature_c")], EXTREMES):
        yield f"{table} {column} {value:g}", _of(table, _put(column, 50, value))
    for value in EXTREMES:
        yield f"all rates {value:g}", _of("gyro", _set(RATES, lambda x, value=value: 0 * np.nan_to_num(x) + value))
    yield "rates x 1e-310", _of("gyro", _set(RATES, lambda x: x * 1e-310))
    yield "rates as 32 bit", _of("gyro", lambda frame: frame.astype(dict.fromkeys(RATES, "float32")))
    yield "times as 32 bit", _of("gyro", lambda frame: frame.astype({"t_s": "float32"}))
    for table, column in (*columns, ("housekeeping", "gyro_temperature_c"), ("housekeeping", "t_s")):
        yield f"{table} {column} as text", _of(table, lambda frame, column=column: frame.astype({column: str}))
        yield f"{table} without {column}", _of(table, lambda frame, column=column: frame.drop(columns=column))
        words = lambda frame, column=column: frame.assign(**{column: "off"})  # noqa: E731
        yield f"{table} {column} in words", _of(table, words)
    hk = "housekeeping"
    yield "housekeeping with a column of words", _of(hk, lambda frame: frame.assign(mode="nominal"))
    yield "housekeeping all missing", _of(hk, lambda frame: frame.assign(gyro_temperature_c=np.nan))
    yield (
        "housekeeping missing mostly",
        _of(hk, lambda frame: frame.assign(gyro_temperature_c=frame["t_s"].where(frame["t_s"] < 9))),
    )
    yield "housekeeping constant", _of(hk, lambda frame: frame.assign(gyro_temperature_c=20.0))
    yield "housekeeping of truth values", _of(hk, lambda frame: frame.assign(gyro_temperature_c=frame["t_s"] > 300))
    yield (
        "housekeeping of dates",
        _of(hk, lambda frame: frame.assign(gyro_temperature_c=pd.to_datetime(frame["t_s"], unit="s"))),
    )
    yield "housekeeping backwards", _of(hk, lambda frame: frame.iloc[::-1])
    yield "housekeeping of one row", _of(hk, lambda frame: frame.iloc[:1])
    yield "housekeeping of no row", _of(hk, lambda frame: frame.iloc[:0])


def _headers() -> Iterator[tuple[str, Damage]]:
    """Headers that do not belong to the data."""
    for value in (0.25, 1.0, 1e-300, 1e300, 0.0, -0.5):
        yield f"sample_s {value:g}", _of_header("sample_s", f"sample_s = {value!r}")
    yield (
        "a-priori G transposed and negative",
        _of_header("apriori_G", "apriori_G = [[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]"),
    )
    yield "a-priori G of 100", _of_header("apriori_G", "apriori_G = [[100.0, 0.0, 0.0], [0.0, 100.0, 0.0], [0.0, 0.0, 100.0]]")
    for value in (0.05, 1.0, 1e5):
        yield f"a-priori bias {value:g}", _of_header("apriori_bias_deg_s", f"apriori_bias_deg_s = [{value!r}, 0.0, 0.0]")
    yield "orbit of 1e-300 s", _orbit(1e-300)
    yield "orbit of 1e300 s", _orbit(1e300)
    yield "orbit of 10 s", _orbit(10.0)
    yield "no orbit", _without_orbit


def _without_orbit(folder: Path) -> None:
    path = folder / "recording.toml"
    head, _, rest = path.read_text().partition("[orbit]")
    path.write_text(head + rest[rest.index("[[interval]]") :])


def _orbit(period_s: float) -> Damage:
    def damage(folder: Path) -> None:
        path = folder / "recording.toml"
        path.write_text(path.read_text().replace("period_s = 500.0", f"period_s = {period_s!r}"))

    return damage


def _files() -> Iterator[tuple[str, Damage]]:
    """Files that are none."""

    def cut(folder: Path) -> None:
        path = folder / "gyro.parquet"
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])

    def text(folder: Path) -> None:
        (folder / "gyro.parquet").write_text("t_s,rate_x_deg_s\n0,0\n")

    def fifo(name: str) -> Damage:
        def damage(folder: Path) -> None:
            (folder / name).unlink()
            os.mkfifo(folder / name)

        return damage

    def link(name: str, target: str) -> Damage:
        def damage(folder: Path) -> None:
            (folder / name).unlink()
            (folder / name).symlink_to(target)

        return damage

    def as_folder(folder: Path) -> None:
        (folder / "gyro.parquet").unlink()
        (folder / "gyro.parquet").mkdir()

    yield "half a file", cut
    yield "CSV named Parquet", text
    yield "a folder as a table", as_folder
    for name in ("recording.toml", "gyro.parquet", "attitude.parquet", "housekeeping.parquet"):
        yield f"a pipe as {name}", fifo(name)
        yield f"/dev/zero as {name}", link(name, "/dev/zero")


def run(names: list[str]) -> None:
    """Print what loading, calibration and diagnosis make of all damages, or of those whose names hold one of some texts."""
    for name, damage in damages():
        if names and not any(part in name for part in names):
            continue
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            damage(intact(Path(folder)))
            began = time.process_time()
            try:
                recording = load(folder)
            except GyrocalError as error:
                print(f"{name}: load: {str(error).replace(folder, 'REC')}", flush=True)
                continue
            for what, call in (("calibrate", calibrate), ("diagnose", lambda one: diagnose(one, settings=QUICK))):
                try:
                    found = call(recording)
                    said = f"{found.verdict} {[cause.label for cause in found.causes]}" if what == "diagnose" else "done"
                except GyrocalError as error:
                    said = f"{type(error).__name__}: {error}"
                except Exception as error:
                    frames = traceback.extract_tb(error.__traceback__)[-4:]
                    said = f"!!! {type(error).__name__}: {error}; " + " < ".join(f"{f.filename}:{f.lineno}" for f in frames)
                print(f"{name}: {what}: {said.replace(folder, 'REC')}", flush=True)
            seen = {f"{one.category.__name__}: {one.message} {one.filename}:{one.lineno}" for one in warned}
            print(f"    {time.process_time() - began:.1f} s", *sorted(seen), sep="\n    ", flush=True)


if __name__ == "__main__":
    run(sys.argv[1:])
