"""The motion of a body by gyro and references, for columns that do not hold the noise of the residuals.

Columns of effects that follow the rate, such as its cube, are formed of the samples, whose noise is that of the attitude
which is propagated with them. A column that holds this noise explains it, and a clean gyro seems to have an effect, as
coefficients of noisy regressors are biased (Fuller, Measurement Error Models, Wiley 1987, section 1.1).

The noise itself is seen in the residuals z, with covariance V, of which it is a part: the best estimate of the noise n(t) of
the calibrated rates is E[n(t) | z] = E[n(t) zᵀ] V⁻¹ z. In inertial axes an observation at t_k holds −∫n dt up to t_k, so that

    E[n(t) | z] = −P(t) Σ_{t_k > t} u_k,    u = V⁻¹ (z − C θ),

with P the density of the noise and C θ what the nuisance parameters explain by least squares. Rates less this estimate are the
best linear unbiased estimate of the motion, whose error goes with no residual (Rao, Linear Statistical Inference and Its
Applications, Wiley 1973, section 5a.2). Smoothing them afterwards leaves that as it is.

All this holds where the residuals are of noise. With an error of a hundred sigmas in them the estimate would be a hundred times
the noise, and the rates without it would be no motion. Where χ² is larger than its degrees of freedom, u √(dof/χ²) stands for
u, which leaves the estimate as large as noise would make it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from diagnosis.arrays import Array
from diagnosis.detectors.noise_removal import remove_noise
from diagnosis.detectors.sample_report import SampleReport
from diagnosis.model.linearise import linearise_recording
from diagnosis.model.recording_model import RecordingModel


def estimate_gyro_noise(model: RecordingModel, density: Array | None) -> tuple[Array, Array]:
    """Estimate the gyro's noise from the residuals, of a density (samples, 3), rad²/s, that may differ from the stated one.

    Returns the expected error (samples, 3) of the raw rates, rad/s, zero where nothing is propagated, and rotation vectors
    (m, 3) from the propagated attitudes to the expected ones at the references, inertial axes, rad.
    """
    gyro, inverse = model.recording.gyro, np.linalg.inv(model.G)
    noise, turned = np.zeros(gyro.rates.shape), np.zeros((model.reference_rows.size, 3))
    excess = float(model.y @ model.y) / max(model.degrees_of_freedom, 1)
    weighed = model.weighed_residuals / np.sqrt(max(excess, 1.0))
    for block, references in zip(model.blocks, model.reference_slices, strict=True):
        t_s, to_inertial = model.t_s[block.steps], model.to_inertial[block.steps]
        edges = np.append(t_s - 0.5 * model.dt[block.steps], t_s[-1] + 0.5 * model.dt[block.steps][-1])
        done = block.ends[block.groups + block.counts // 2]
        # After a step come the observations that end behind it.
        after = np.zeros((t_s.size + 1, 3))
        np.add.at(after, done, weighed[block.rows].reshape(-1, 3))
        after = np.cumsum(after[::-1], axis=0)[::-1][1:]
        middle = gyro.t_s + 0.5 * gyro.sample_s
        own = np.flatnonzero((middle > edges[0]) & (middle < edges[-1]))
        step = np.searchsorted(edges, middle[own], side="right") - 1
        u = np.einsum("nij,ni->nj", to_inertial[step], after[step])  # in body axes
        power = (u @ model.G) * density[own] if density is not None else gyro.arw**2 * (u @ inverse.T)
        noise[own] = -power
        # The same of each step, by the mean over its samples, turns the attitude.
        count = np.bincount(step, minlength=t_s.size)
        mean = np.column_stack([np.bincount(step, noise[own, k], t_s.size) for k in range(3)]) / np.maximum(count, 1)[:, None]
        moved = -np.einsum("nij,nj->ni", to_inertial, mean @ model.G.T) * model.dt[block.steps, None]
        total = np.vstack([np.zeros(3), np.cumsum(moved, axis=0)])
        turned[references] = total[block.ends]
    return noise, turned


def add_expected_motion(model: RecordingModel, report: SampleReport, sigma: Array) -> RecordingModel:
    """The model with columns of the motion that gyro and references show together; sigma (references, 3) rad."""
    noise, turned = estimate_gyro_noise(model, report.density)
    shown = remove_noise(report.rates - noise, model.recording)
    again = linearise_recording(model.recording, model.G, model.bias, report.rates, shown, report.density, sigma=sigma)
    return replace(again, at_reference=Rotation.from_rotvec(turned).as_matrix() @ again.at_reference)
