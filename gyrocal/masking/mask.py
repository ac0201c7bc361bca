"""The mask of a recording: the stretches that were not measured, and the recording without them.

A clipped or stopped gyro measures no rate, a frozen or false reference no attitude. No error model describes such a stretch,
which distorts the estimates. Nothing is repaired: an interval ends before a stretch of the gyro, and the next reference starts
a new one. False references are left out. An interval is cut at a lasting jump of the references.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gyrocal.arrays import Array, Mask
from gyrocal.errors import InputError
from gyrocal.recording import Interval, Recording, find_reference_rows
from gyrocal.recording.parts import TIME_TOLERANCE_S

if TYPE_CHECKING:
    import pandas as pd


TABLE = "masked"  # of a recording: the stretches that an import has left out
COLUMNS = ("t_s", "to_s", "what", "axis", "size")
OF_REFERENCES = ("frozen", "reference jump")
MOST_SHOWN = 8  # jumps of the references in a sentence


@dataclass(frozen=True)
class MaskedStretch:
    """One stretch of a recording that was not measured."""

    what: str  # "clipped" or "stopped" gyro, "frozen" references, "reference jump", or "excluded" by hand
    axis: str | None  # of the gyro, or of the largest component of a jump of the references; None for all
    from_s: float  # from_s, to_s: s since the epoch; equal at a lasting jump of the references
    to_s: float
    size: float = 0.0  # level of a gyro, deg/s, or angle of a jump, deg

    @property
    def key(self) -> tuple[str, str | None, float]:
        """Kind, gyro, and the side of clipping; stretches with equal keys are described in one sentence."""
        if self.what == "reference jump":
            return self.what, None, 0.0
        return self.what, self.axis, float(np.sign(self.size)) if self.what == "clipped" else 0.0

    def describe_kind(self, sizes: Sequence[float]) -> str:
        """Describe stretches of this kind with their sizes."""
        gyro = f"gyro {self.axis}" if self.axis else "every gyro"
        if self.what == "reference jump":
            spread = f"{min(sizes):.2g} to {max(sizes):.2g}" if len(sizes) > 1 else f"{sizes[0]:.2g}"
            return f"the references jump {len(sizes)} time(s) by {spread} deg, which the gyro does not confirm"
        level = f"{float(np.median(sizes)):.4g} deg/s"
        return {
            "clipped": f"{gyro} is clipped at {level}",
            "stopped": f"{gyro} stops at {level} while the references turn",
            "frozen": "the references repeat one attitude while the gyro turns",
            "excluded": "excluded by hand",
        }[self.what]

    def to_json(self) -> dict[str, Any]:
        """Return the stretch as a documented entry of a result."""
        return {"what": self.what, "axis": self.axis, "from_s": self.from_s, "to_s": self.to_s, "size": self.size}


@dataclass(frozen=True)
class DataMask:
    """Stretches of a recording that were not measured."""

    stretches: tuple[MaskedStretch, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.stretches)

    def add(self, stretches: Sequence[MaskedStretch]) -> DataMask:
        """Add stretches to the mask, in order of time."""
        merged = {*self.stretches, *stretches}
        return DataMask(tuple(sorted(merged, key=lambda stretch: (stretch.from_s, stretch.what, stretch.axis or ""))))

    def exclude(self, recording: Recording, spans: Sequence[tuple[float, float]]) -> DataMask:
        """Add stretches excluded by hand to the mask, each from and to a time in s since the first gyro sample."""
        start = float(recording.gyro.t_s[0])
        return self.add([MaskedStretch("excluded", None, start + first, start + stop) for first, stop in spans])

    def mark_false_references(self, t_s: Array) -> Mask:
        """Mark the references (m,) at these times that were not measured."""
        out = np.zeros(t_s.size, dtype=bool)
        for stretch in self.stretches:
            if stretch.what in OF_REFERENCES:
                out |= (t_s >= stretch.from_s - TIME_TOLERANCE_S) & (t_s < stretch.to_s - TIME_TOLERANCE_S)
        return out

    def mark_cuts(self, t_s: Array) -> Mask:
        """Mark the times (m,), in order, that are separated from the one before by a stretch of the gyro or a lasting jump."""
        cuts = [stretch for stretch in self.stretches if stretch.what not in OF_REFERENCES or stretch.from_s == stretch.to_s]
        begun = np.searchsorted(np.sort([cut.from_s for cut in cuts]), t_s, side="left")
        ended = np.searchsorted(np.sort([cut.to_s for cut in cuts]), t_s, side="right")
        return np.append(False, begun[1:] > ended[:-1])

    def apply(self, recording: Recording) -> Recording:
        """Cut the intervals of a recording and leave out its false references; the recording itself with an empty mask.

        An `InputError` if no interval remains.
        """
        if not self.stretches or not recording.attitudes.t_s.size:
            return recording
        kept = np.flatnonzero(~self.mark_false_references(recording.attitudes.t_s))
        t_s = recording.attitudes.t_s[kept]
        pieces = [piece for interval in recording.intervals for piece in self._cut_interval(interval, t_s)]
        if not pieces:
            causes = "; ".join(self.describe(recording))
            raise InputError(f"no two references of an interval are left: {causes}; give intervals without these stretches")
        inside = np.unique(np.concatenate([find_reference_rows(t_s, piece) for piece in pieces]))
        return replace(recording, attitudes=recording.attitudes.select_rows(kept[inside]), intervals=tuple(pieces))

    def _cut_interval(self, interval: Interval, t_s: Array) -> Iterator[Interval]:
        """Cut an interval into its parts with two references or more; t_s (m,) are the references' times."""
        times = t_s[find_reference_rows(t_s, interval)]
        pieces = np.split(times, np.flatnonzero(self.mark_cuts(times))) if times.size else []
        if len(pieces) == 1 and times.size >= 2:
            yield interval
            return
        for number, piece in enumerate([piece for piece in pieces if piece.size >= 2]):
            yield replace(interval, name=f"{interval.name}/{number}", start_s=float(piece[0]), stop_s=float(piece[-1]))

    def compute_share(self, recording: Recording) -> float:
        """Compute the share of the gyro's samples in masked stretches."""
        t_s = recording.gyro.t_s
        out = np.zeros(t_s.size, dtype=bool)
        for stretch in self.stretches:
            out |= (t_s >= stretch.from_s) & (t_s < stretch.to_s)
        return float(out.mean())

    def describe(self, recording: Recording) -> list[str]:
        """Describe the masked stretches, a sentence for each kind; times in s since the first gyro sample."""
        sentences, start = [], float(recording.gyro.t_s[0])
        for key in dict.fromkeys([stretch.key for stretch in self.stretches]):
            stretches = [stretch for stretch in self.stretches if stretch.key == key]
            what = stretches[0].describe_kind([stretch.size for stretch in stretches])
            if stretches[0].what == "reference jump":
                largest = sorted(stretches, key=lambda jump: -jump.size)[:MOST_SHOWN]
                jumps = sorted(largest, key=lambda jump: jump.from_s)
                listed = ", ".join(f"{jump.from_s - start:.2f} s ({jump.size:.2g} deg, {jump.axis})" for jump in jumps)
                sentences.append(f"{what}{', the largest' if len(stretches) > MOST_SHOWN else ''} at {listed}")
                continue
            first, last = stretches[0].from_s - start, max(stretch.to_s for stretch in stretches) - start
            total = sum(stretch.to_s - stretch.from_s for stretch in stretches)
            often = f"for {total:.3g} s in {len(stretches)} stretches, " if len(stretches) > 1 else ""
            sentences.append(f"{what}, {often}from {first:.2f} to {last:.2f} s")
        return sentences

    def to_json(self) -> list[dict[str, Any]]:
        """Return the stretches as documented entries of a result, times in s since the epoch."""
        return [stretch.to_json() for stretch in self.stretches]

    def to_frame(self) -> pd.DataFrame:
        """Build the table in which a recording stores the masked stretches."""
        import pandas as pd  # late: 65 MiB that a Monte Carlo worker does without

        rows = [(stretch.from_s, stretch.to_s, stretch.what, stretch.axis or "", stretch.size) for stretch in self.stretches]
        return pd.DataFrame(rows, columns=list(COLUMNS))


def read_mask(recording: Recording) -> DataMask:
    """Read the stretches that an import has left out of a recording; an `InputError` if its table has other columns."""
    table = recording.tables.get(TABLE)
    if table is None:
        return DataMask()
    missing = [name for name in COLUMNS if name not in table.columns]
    if missing:
        raise InputError(f"{TABLE}: column {', '.join(missing)} is missing; it has {', '.join(map(str, table.columns))}")
    rows = table[list(COLUMNS)].itertuples(index=False)
    return DataMask().add([MaskedStretch(what, axis or None, begin, stop, size) for begin, stop, what, axis, size in rows])
