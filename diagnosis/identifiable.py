"""Recordings that cannot show whether there is a gap.

An answer without a gap says that the recording shows nothing which the baseline would not do. Two kinds of recordings show
nothing of it because they cannot. One has no more observations than M0 has parameters. In the other, the calibration turns the
gyro's axes by more than those of a gyro are plausibly misaligned. A constant error of the references does the same: they are
wrong by a rotation E for A_obs = E A, and propagating them takes rates in the axes of E, so that G becomes E G exactly. No
recording of rates and reference attitudes tells the two apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from diagnosis.settings import DiagnosisSettings

Array = NDArray[np.float64]


@dataclass(frozen=True)
class IdentifiableSettings:
    """Constants of `diagnosis.identifiable`."""

    offset: float = 0.1  # rad, prior sigma of a constant rotation of references that are mounted otherwise than stated


SETTINGS = IdentifiableSettings()


def explain_blindness(
    degrees_of_freedom: int, G: Array, sigma_G: Array, apriori_G: Array, plausible_G: float, settings: DiagnosisSettings
) -> str | None:
    """Explain why a recording without a visible gap cannot show whether there is one; None if it can.

    A rotation of the axes is one that gyros of the grade have, or that and one of the references. The priors of its three
    components are normal, that of the references by `OFFSET`.

    Parameters
    ----------
    degrees_of_freedom : observations less nuisance parameters
    G, sigma_G : (3, 3) as calibrated under M0, and standard errors
    apriori_G : (3, 3) what the gyro is known to be
    plausible_G : plausible range of an element of G, dimensionless
    settings : priors
    """
    if degrees_of_freedom <= 0:
        return "M0 has as many parameters as this recording has observations, so that no gap could be seen"
    U, _, V = np.linalg.svd(G @ np.linalg.inv(apriori_G))
    turn = Rotation.from_matrix(U @ V if np.linalg.det(U @ V) > 0 else np.eye(3)).as_rotvec()
    of_gyro = float(np.sqrt(plausible_G**2 + np.sum(sigma_G**2) / 9))
    prior = settings.another * settings.unlisted_share
    wide = float(np.hypot(of_gyro, SETTINGS.offset))  # ratio of the densities of two normal variables of these sigmas
    log_odds = np.log(prior / (1 - prior)) + np.sum(0.5 * turn**2 * (of_gyro**-2 - wide**-2) - np.log(wide / of_gyro))
    if log_odds < np.log(settings.unknown / (1 - settings.unknown)):
        return None
    angle = float(np.linalg.norm(turn))
    about = ", ".join(f"{value:.3g}" for value in np.rad2deg(turn))
    return (
        f"The calibration turns the gyro's axes by {np.rad2deg(angle):.3g} deg ({about} deg about x, y, z), more than any "
        "plausible misalignment; a constant offset of the references does the same, and this recording cannot tell them apart"
    )
