"""The Allan deviation of a recording's gyro, drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gyrocal.allan.deviation import overlapping_allan_deviation
from gyrocal.errors import InputError
from gyrocal.importing.motion import compute_speed, find_rests

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from gyrocal.recording.recording_data import Recording

GAP_SAMPLES = 1.5  # samples without a reading, from which on two are not of one stretch


def plot_allan(recording: Recording, ax: Axes | None = None, interval: str | None = None) -> Axes:
    """See `gyrocal.Recording.plot_allan`."""
    gyro = recording.gyro
    parts = [np.rad2deg(gyro.rates[first:stop]) for first, stop in _list_stretches(recording, interval)]
    if ax is None:
        import matplotlib.pyplot as plt

        ax = plt.subplots()[1]
    for k, name in enumerate("xyz"):
        found = overlapping_allan_deviation([part[:, k] for part in parts], gyro.sample_s)
        ax.loglog(found.tau_s, found.deviation, marker=".", label=name)
    if gyro.arw > 0:
        ax.loglog(found.tau_s, np.rad2deg(gyro.arw) / np.sqrt(found.tau_s), ":", color="0.4", label="stated angle random walk")
    ax.set(xlabel="averaging time, s", ylabel="overlapping Allan deviation, deg/s", title=recording.title)
    ax.legend()
    return ax


def _list_stretches(recording: Recording, interval: str | None) -> list[tuple[int, int]]:
    """Samples of an interval without its holes; of the rests without one."""
    gyro, attitudes = recording.gyro, recording.attitudes
    if interval is None:
        found = find_rests(
            gyro.rates @ gyro.apriori_G.T, gyro.sample_s, compute_speed(attitudes.t_s, attitudes.quaternions, gyro.t_s)
        )
        found = [part for first, stop in found for part in _split_at_holes(gyro.t_s, first, stop, gyro.sample_s)]
        if not found:
            raise InputError(
                "no rest was found: name an interval in which the body turns at a constant rate; "
                "gyrocal allan takes the motion out by the references"
            )
        return found
    named = [one for one in recording.intervals if one.name == interval]
    if not named:
        raise InputError(f"no interval {interval!r}; there are {', '.join(one.name for one in recording.intervals)}")
    first, stop = np.searchsorted(gyro.t_s, [named[0].start_s, named[0].stop_s - 0.5 * gyro.sample_s])
    return _split_at_holes(gyro.t_s, int(first), int(stop), gyro.sample_s)


def _split_at_holes(t_s: NDArray[np.float64], first: int, stop: int, sample_s: float) -> list[tuple[int, int]]:
    """The stretches from one sample to before another that have no hole."""
    cuts = first + 1 + np.flatnonzero(np.diff(t_s[first:stop]) > GAP_SAMPLES * sample_s)
    return list(zip([first, *cuts.tolist()], [*cuts.tolist(), stop], strict=True))
