"""Sentences of an answer: that a calibration sees no gap, and why there is one."""

from dataclasses import replace

import pytest
import scipy.special

from diagnosis.diagnose import diagnose
from gyrocal import calibrate
from tests.diagnosis.recordings import recorded

FITTING = "The residuals after a calibration fit"


@pytest.mark.parametrize(
    ("effects", "why"),
    [
        pytest.param(("bias_orbital:y=0.05",), "bias_orbital:y takes ", id="a pattern"),
        pytest.param(("vibration:x=0.002",), "the gyro samples show", id="of the samples"),
    ],
)
def test_a_gap_that_no_calibration_sees_is_told_with_its_reason(effects, why):
    recording = recorded(3, *effects)
    found, of_calibration = diagnose(recording), calibrate(recording)
    assert of_calibration.p_value > 0.01
    assert found.present
    (note,) = [one for one in found.notes if one.startswith(FITTING)]
    assert why in note
    # The same sum as that of the calibration.
    assert float(scipy.special.chdtrc(of_calibration.dof, of_calibration.chi2)) == pytest.approx(
        float(note.split("p = ")[1].split(")")[0]), rel=0.02
    )


def test_numbers_in_another_unit_are_told():
    """The noise is as it was, and the number that states it is another; sigmas in arcsec are 3600 times too large."""
    arw, sigma = 60.0, 3600.0
    plain = recorded(3, "bias_orbital:y=0.5")
    gyro, attitudes = replace(plain.gyro, arw=arw * plain.gyro.arw), plain.attitudes
    found = diagnose(replace(plain, gyro=gyro, attitudes=replace(attitudes, sigma=sigma * attitudes.sigma)))
    notes = " ".join(one for one in found.notes if "look at the number" in one)
    assert "1/60, as of an angle" in notes
    assert "1/3600, as of sigmas" in notes
    for name, factor in (("noise_excess", 1 / arw), ("reference_noise_excess", 1 / sigma)):
        noise = next(one for one in found.causes if one.effect == name)
        assert abs(noise.size - factor) < 4 * noise.sigma
    # With the noise as it is, what is at work shows as ever.
    other = next(one for one in found.causes if one.effect == "bias_orbital")
    assert abs(other.size - 0.5) < 4 * other.sigma
