"""A calibration drawn, and as labelled arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gyrocal.calibration.parameters import AXES, NAMES
from gyrocal.errors import InputError

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes

    from gyrocal.calibration.davenport import CalibrationResult

ROTATIONS = ("roll", "pitch", "yaw")


def _given(ax: Axes | None) -> Axes:
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    return plt.subplots()[1]


def plot_residuals(result: CalibrationResult, ax: Axes | None = None, before: bool = False) -> Axes:
    """See `gyrocal.CalibrationResult.plot_residuals`."""
    ax, table = _given(ax), result.residuals
    for k, name in enumerate(ROTATIONS):
        after, sigma = table[f"after_{name}_deg"], table[f"sigma_{name}_deg"]
        ax.errorbar(table["t_s"], after, sigma, fmt=".", color=f"C{k}", elinewidth=0.6, label=name)
        if before:
            ax.plot(table["t_s"], table[f"before_{name}_deg"], "o", fillstyle="none", color=f"C{k}", label=f"{name}, before")
    ax.axhline(0.0, color="0.4", linewidth=0.8)
    title = f"{result.recording}: chi2 {result.chi2:.1f} of {result.dof}"
    ax.set(xlabel="t_s, s since the epoch", ylabel="residual, deg", title=title)
    ax.legend()
    return ax


def plot_parameters(result: CalibrationResult, ax: Axes | None = None) -> Axes:
    """See `gyrocal.CalibrationResult.plot_parameters`."""
    ax, table = _given(ax), result.summary()
    table = table[table["solved"]]
    places = np.arange(len(table))[::-1]
    ax.errorbar((table["correction"] / table["sigma"]).to_numpy(), places, xerr=1.0, fmt="o", capsize=3)
    labels = [
        f"{one['parameter']} = {one['calibrated']:.6g} ± {one['sigma']:.1g}{'' if one['unit'] == '1' else ' ' + one['unit']}"
        for one in table.to_dict("records")
    ]
    ax.set_yticks(places, labels)
    ax.axvline(0.0, color="0.4", linewidth=0.8)
    ax.set(xlabel="calibrated minus initial, in sigma", title=result.recording)
    return ax


def to_xarray(result: CalibrationResult) -> xarray.Dataset:
    """See `gyrocal.CalibrationResult.to_xarray`."""
    try:
        import xarray
    except ImportError:
        raise InputError("to_xarray needs xarray: pip install 'gyrocal[xarray]'") from None
    scale = np.array([1.0] * 9 + [np.rad2deg(1.0)] * 3)
    table = result.residuals

    def columns(label: str) -> np.ndarray:
        return table[[f"{label}_{name}_deg" for name in ROTATIONS]].to_numpy()

    deg, deg_s = {"units": "deg"}, {"units": "deg/s"}
    return xarray.Dataset(
        {
            "G": (("body", "gyro"), result.G),
            "bias_deg_s": ("body", result.bias_deg_s, deg_s),
            "sigma_G": (("body", "gyro"), result.sigma[:9].reshape(3, 3)),
            "sigma_bias_deg_s": ("body", result.sigma_bias_deg_s, deg_s),
            "covariance": (("parameter", "other"), result.covariance * np.outer(scale, scale), {"units": "1 and deg/s"}),
            "before_deg": (("residual", "rotation"), columns("before"), deg),
            "after_deg": (("residual", "rotation"), columns("after"), deg),
            "sigma_deg": (("residual", "rotation"), columns("sigma"), deg),
        },
        {
            "body": list(AXES),
            "gyro": list(AXES),
            "parameter": list(NAMES),
            "other": list(NAMES),
            "rotation": list(ROTATIONS),
            "t_s": ("residual", table["t_s"].to_numpy(), {"units": "s"}),
            "interval": ("residual", table["interval"].to_numpy(dtype=object)),
        },
        {"recording": result.recording, "chi2": result.chi2, "degrees_of_freedom": result.dof},
    )
