"""From a recording's files to its residuals: what a user waits for before the pass is worth speaking of."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.streams import Flight
from gyrocal import Recording, load, save
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.sampling import prepare_measurements

Array = NDArray[np.float64]


def finer_recording(recording: Recording, finer: int) -> Recording:
    """The same rates in so many times as many samples."""
    gyro = recording.gyro
    sample_s = gyro.sample_s / finer
    t_s = (gyro.t_s[:, None] + sample_s * np.arange(finer)).ravel()
    return replace(recording, gyro=replace(gyro, t_s=t_s, rates=np.repeat(gyro.rates, finer, axis=0), sample_s=sample_s))


@contextmanager
def loaders(flight: Flight, finer: int) -> Iterator[dict[str, Callable[[], Array]]]:
    """Calls from the files of case 0, as Parquet and as CSV, to the residuals (m, 3) rad at its a-priori parameters."""
    with TemporaryDirectory() as place:
        parquet, csv = Path(place, "parquet"), Path(place, "csv")
        for folder in (parquet, csv):
            save(finer_recording(flight.recording, finer), folder)
        table = csv / "gyro.parquet"
        pd.read_parquet(table).to_csv(table.with_suffix(".csv"), index=False)
        table.unlink()

        def residuals(folder: Path) -> Array:
            recording = load(folder)
            return Problem.build(recording, prepare_measurements(recording)).state(flight.initial).theta

        yield {"parquet": lambda: residuals(parquet), "csv": lambda: residuals(csv)}
