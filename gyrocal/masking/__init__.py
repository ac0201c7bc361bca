"""Stretches of a recording that were not measured: import, calibration and diagnosis find, list and leave them out alike.

- `mask`: the list of such stretches and the recording without them.
- `gyro_faults`: gyros that are clipped or that stop.
- `reference_faults`: reference attitudes that freeze or jump, by the innovations of a recording.

On tables that are not yet a recording, the import leaves out single rows:

- `held_readings`: readings that a firmware holds at rest.
- `lost_references`: the identity in place of an attitude, and rows that repeat one, in any mounting of the sensor.
"""

from collections.abc import Sequence

import numpy as np

from gyrocal.innovations import Innovations, compute_innovations
from gyrocal.masking.gyro_faults import GAP_SAMPLES, find_noisy_plateaus, find_plateaus, find_stops, mark_interval_samples
from gyrocal.masking.mask import DataMask, MaskedStretch, read_mask
from gyrocal.masking.reference_faults import find_frozen, find_jumps
from gyrocal.recording import Recording, find_reference_rows

__all__ = ["DataMask", "MaskedStretch", "find_mask", "mark_interval_samples"]


def find_mask(recording: Recording, exclude: Sequence[tuple[float, float]] = ()) -> DataMask:
    """Find the stretches of a recording that were not measured.

    recording: gyro and references preferably at their full rate, since thinned references hide single false ones
    exclude: stretches to leave out by hand, each from and to a time in s since the first gyro sample
    """
    mask = read_mask(recording).exclude(recording, exclude)
    if not recording.attitudes.t_s.size:
        return mask
    masked = mask.apply(recording)
    innovations: Innovations | None = None
    for find in (find_plateaus, find_frozen, find_stops, find_noisy_plateaus, find_jumps):
        innovations = _compute_apriori_innovations(masked) if innovations is None else innovations
        stretches = find(masked, innovations)
        if stretches:  # each search is on the recording without the stretches found before
            mask = mask.add(stretches)
            masked, innovations = mask.apply(recording), None
    return mask


def _compute_apriori_innovations(recording: Recording) -> Innovations:
    """Compute the innovations of the references of a recording at its a-priori calibration."""
    gyro, attitudes = recording.gyro, recording.attitudes
    number = np.full(attitudes.t_s.size, -1, dtype=np.intp)
    for k, interval in enumerate(recording.intervals):
        rows = find_reference_rows(attitudes.t_s, interval)
        number[rows[number[rows] < 0]] = k
    # References of one number are propagated in a row: neither intervals nor gaps of the gyro lie between them.
    gaps = gyro.t_s[1:][np.diff(gyro.t_s) > GAP_SAMPLES * gyro.sample_s]
    number = np.where(number < 0, -1, number * (gaps.size + 1) + np.searchsorted(gaps, attitudes.t_s))
    rates = gyro.rates @ gyro.apriori_G.T + gyro.apriori_bias
    return compute_innovations(gyro.t_s, rates, attitudes.t_s, attitudes.quaternions, number, attitudes.sigma, gyro.arw)
