"""More gyros than three: what they say of the body's rate, and what they say of one another.

Each gyro reads the rate about its own axis, ω_raw,i = K_i · ω + c_i, with K_i its scale factor times its axis; K is (n, 3).
From the gyros that are on,

    G = K⁺ = (KᵀK)⁻¹ Kᵀ,  b = −G c:    ω = G ω_raw + b                                                        R (7)
    Vᵀ K = 0,  VᵀV = I:                Vᵀ (ω_raw − c) = 0 whatever the motion: n − 3 parity residuals

G V = 0, so that white noise of one size in all gyros is uncorrelated between the rates, ARW² G Gᵀ, and the parity, ARW² I.
Source: Potter and Suman, Thresholdless redundancy management with arrays of skewed instruments, AGARDograph 224, 1977.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.recording.names import TRIAD
from gyrocal.recording.parts import GyroStream
from gyrocal.recording.recording_data import Recording

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

TAG_ROUNDING = 1e-6  # of a sample


def compute_nominal_gyros(gyro: GyroStream) -> tuple[Array, Array]:
    """K (n, 3) and c (n,) rad/s that the a-priori G and b stand for: K = G⁺, c = −K b."""
    K = np.linalg.pinv(gyro.apriori_G)
    return np.asarray(K), -K @ gyro.apriori_bias


def compute_gyro_gain(K: Array, chosen: Indices, sigma: Array | None = None) -> Array:
    """G (3, n) of the chosen gyros, zero for the others.

    With the sigmas (n,) of gyros of different noise it is that of weighted least squares, (KᵀWK)⁻¹ KᵀW with W = σ⁻², whose
    noise is uncorrelated with that of the parity as well.
    """
    weight = np.ones(len(chosen)) if sigma is None else sigma.mean() / sigma[chosen]
    G = np.zeros((3, len(K)))
    G[:, chosen] = np.linalg.pinv(K[chosen] * weight[:, None]) * weight
    return G


def compute_parity_basis(K: Array, chosen: Indices) -> Array:
    """V (n, chosen − 3), an orthonormal basis of the parity of the chosen gyros, zero for the others."""
    V = np.zeros((len(K), len(chosen) - 3))
    V[chosen] = np.linalg.svd(K[chosen])[0][:, 3:]
    return V


def select_interval_samples(recording: Recording, interval: int) -> tuple[slice, Array]:
    """The gyro samples that start in an interval, and the time that each averages over, s."""
    gyro, one = recording.gyro, recording.intervals[interval]
    margin = TAG_ROUNDING * gyro.sample_s
    low, high = np.searchsorted(gyro.t_s, [one.start_s - margin, one.stop_s - margin])
    return slice(int(low), int(high)), np.minimum(gyro.sample_s, one.stop_s - gyro.t_s[low:high])


def triad(recording: Recording, K: Array | None = None, c: Array | None = None, noise: Array | None = None) -> Recording:
    """The recording of the three body rates that its gyros stand for; one of x, y and z is left as it is.

    The noise of its rates has the mean power of the three axes'.

    Parameters
    ----------
    recording : any recording
    K, c : (n, 3) and (n,) rad/s of the gyros; those of its a-priori G and b by default
    noise : (n,) white noise of each gyro, as a factor of the stated one

    Raises
    ------
    InputError
        It has no reference attitudes.
    """
    if not recording.is_array:
        return recording
    if not recording.attitudes.t_s.size:
        raise InputError("the recording has no reference attitudes; its gyros can only be compared with one another")
    gyro = recording.gyro
    bias = np.array(gyro.apriori_bias) if c is None else np.zeros(3)
    K = compute_nominal_gyros(gyro)[0] if K is None else K
    read = gyro.rates - (0.0 if c is None else c)
    factor = np.ones(len(K)) if noise is None else noise
    rates = np.nan_to_num(read) @ compute_gyro_gain(K, np.arange(len(K)), factor).T
    power = []
    for number in range(len(recording.intervals)):
        part, _ = select_interval_samples(recording, number)
        chosen = recording.switched_on(number)
        begins = recording.intervals[number].start_s + TAG_ROUNDING * gyro.sample_s
        if part.start and gyro.t_s[part.start - 1] + gyro.sample_s > begins:  # a sample that the interval starts in
            part = slice(part.start - 1, part.stop)
        G = compute_gyro_gain(K, chosen, factor)
        rates[part] = np.nan_to_num(read[part]) @ G.T
        power.append(float(np.sum((G * factor) ** 2)) / 3)
    body = replace(
        gyro,
        rates=rates,
        arw=gyro.arw * float(np.sqrt(np.mean(power))),
        apriori_G=np.eye(3),
        apriori_bias=bias,
        names=TRIAD,
    )
    return replace(recording, gyro=body, intervals=tuple(replace(one, gyros=None) for one in recording.intervals))


def need_triad(gyro: GyroStream) -> None:
    """Raise an `InputError` for other gyros than x, y and z, where only these are understood."""
    if gyro.names != TRIAD:
        raise InputError(
            f"this takes the three gyros x, y and z, not {', '.join(gyro.names)}; "
            "gyrocal.triad makes the recording of their body rates, and gyrocal.calibrate_gyros calibrates each of them"
        )
