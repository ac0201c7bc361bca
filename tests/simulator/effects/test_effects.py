"""Effects with columns: each against finite differences of the simulator and against closed forms; their text form."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import simulator
from gyrocal import InputError
from simulator.effects import EFFECTS, Stream, parse, setting
from simulator.effects.base import AXIS_NAMES
from simulator.effects.gyro.rate_lag import apply_lag
from simulator.effects.housekeeping_columns import STANDARD_GRAVITY
from simulator.effects.recording_view import extract_references, interpolate_housekeeping
from simulator.truth.rotation import separation

DEG_H = np.deg2rad(1 / 3600)
SCENARIO = simulator.override(
    simulator.load("trmm_series"),
    {
        "control_motion": {"amplitude_deg": [0.1, 0.2, 0.1], "period_s": [130.0, 170.0, 90.0]},
        "interval": [
            {"name": "a", "activity": "+x forward", "start_s": 0.0, "stop_s": 900.0, "mode": "+x"},
            {
                "name": "b",
                "activity": "+x to -x yaw maneuver",
                "start_s": 2000.0,
                "stop_s": 3100.2,
                "mode": "+x",
                "slew": [{"axis": [0.0, 0.0, 1.0], "angle_deg": 180.0, "start_s": 60.0, "duration_s": 800.0}],
            },
            {"name": "c", "activity": "-x forward", "start_s": 4000.0, "stop_s": 4700.0, "mode": "-x"},
        ],
    },
)
MOTION = simulator.motion(SCENARIO)
PLAIN = simulator.simulate(SCENARIO, noise=False)
HOUSEKEEPING = simulator.simulate(SCENARIO, noise=False, effects=[parse("bias_temperature:x=1")])
ACCELERATIONS = simulator.simulate(SCENARIO, noise=False, effects=[parse("acceleration_sensitivity:x=1,toward=x")])
MIDDLE_S = MOTION.t_s + 0.5 * MOTION.duration_s
STREAM = Stream(
    t_s=MOTION.t_s + 0.5 * MOTION.duration_s,
    duration_s=MOTION.duration_s,
    rates=MOTION.rates,
    raw=PLAIN.gyro.rates,
    intervals=MOTION.intervals,
    orbit_period_s=PLAIN.orbit.period_s,
    span_s=(0.0, 4700.0),
    housekeeping={
        "gyro_temperature_c": np.interp(MIDDLE_S, *HOUSEKEEPING.tables["housekeeping"].to_numpy(dtype=float).T),
        **{
            name: np.interp(MIDDLE_S, ACCELERATIONS.tables["housekeeping"]["t_s"], values)
            for name, values in ACCELERATIONS.tables["housekeeping"].items()
            if name != "t_s"
        },
    },
)
# Sizes whose effect is far above rounding, and for the timing small enough for a derivative.
SIZE = {"scale_asymmetry": 1e4, "scale_quadratic": 1e5, "g_matrix_step": 1e4, "time_offset": 1e-3, "rate_lag": 1e-3,
        "clock_drift": 0.5, "clock_slip": 1e-3, "g_matrix_temperature": 1e3}  # fmt: skip


def variants(name):
    """Parameters that the columns hold fixed: a period, step times in a gap, inside an interval, inside a sample."""
    names = {parameter.name for parameter in EFFECTS[name].parameters}
    times = [{"time_s": t} for t in (1500.0, 2500.0, 4100.2)] if "time_s" in names else [{}]
    if "begin_s" in names:
        times = [{"begin_s": 400.0, "end_s": 2500.0}, {"begin_s": 2500.0, "end_s": 1e12}]
    if "period_s" in names:
        times = [{"period_s": 370.0}]
    return [{**t, "toward": toward} for t in times for toward in AXIS_NAMES] if "toward" in names else times


CASES = [
    (name, axis, parameters)
    for name, effect in EFFECTS.items()
    if effect.has_columns
    for axis in (effect.axes or (None,))
    for parameters in variants(name)
]


@pytest.mark.parametrize(("name", "axis", "parameters"), CASES)
def test_columns_are_the_simulators_derivative(name, axis, parameters):
    effect, size = EFFECTS[name], SIZE.get(name, 1.0)
    on_references = effect.on_references
    make = effect.reference_columns if on_references else effect.columns
    columns = make(extract_references(PLAIN) if on_references else STREAM, axis, parameters)
    for k in range(columns.shape[2]):
        amplitude = np.eye(columns.shape[2])[k] * size
        total, held = effect.from_amplitudes(amplitude)
        made = setting(name, axis, total, {**parameters, **held})
        np.testing.assert_allclose(effect.amplitudes(made), amplitude, atol=1e-15 * size)
        shown = simulator.simulate(SCENARIO, noise=False, effects=[made])
        if on_references:
            difference = separation(shown.attitudes.quaternions, PLAIN.attitudes.quaternions)
            np.testing.assert_array_equal(shown.gyro.rates, PLAIN.gyro.rates)
            difference = -difference  # exp([e×]) A(plain) = A(shown)
        else:
            difference = shown.gyro.rates - PLAIN.gyro.rates
            np.testing.assert_array_equal(shown.attitudes.quaternions, PLAIN.attitudes.quaternions)
        scale = np.abs(columns[..., k]).max()
        assert scale > 0
        # Rounding for what is linear; the next order of 1e-3 s against the motion's fastest for the timing.
        tolerance = 1e-3 if effect.stage in ("filter", "clock") else 1e-9
        np.testing.assert_allclose(difference / size, columns[..., k], rtol=0, atol=tolerance * scale)


def test_an_effect_that_cannot_act_is_refused():
    for text, words in (
        ("vibration:z=1,apparent_hz=1.5", "half the sampling rate"),
        ("stale_samples=1,fraction=0.9", "longer runs"),
        ("bias_temperature:z=1,column=battery_v", "no housekeeping column battery_v; there is gyro_temperature_c"),
    ):
        with pytest.raises(InputError, match=re.escape(words)):
            simulator.simulate(SCENARIO, effects=[parse(text)])


def shown(*texts):
    made = simulator.simulate(SCENARIO, noise=False, effects=[parse(text) for text in texts])
    return made.gyro.rates - PLAIN.gyro.rates


def test_a_positive_size_reads_high_as_written():
    t, omega, T = STREAM.t_s, MOTION.rates, STREAM.housekeeping["gyro_temperature_c"]
    n, a = 2 * np.pi / PLAIN.orbit.period_s, STREAM.housekeeping["gyro_acceleration_y_m_s2"]
    expected = {
        "bias_drift:z=3": (2, 3 * DEG_H * t / 86400),
        "bias_step:x=0.2,time_s=1500": (0, 0.2 * DEG_H * (t > 1500)),
        "bias_orbital:y=0.2,phase_deg=30": (1, 0.2 * DEG_H * np.sin(n * t + np.pi / 6)),
        "bias_periodic:x=0.2,period_s=700,phase_deg=30": (
            0,
            0.2 * DEG_H * np.sin(2 * np.pi * t / 700 + np.pi / 6) * np.sinc(MOTION.duration_s / 700),
        ),
        "bias_temperature:z=0.5": (2, 0.5 * DEG_H * (T - T.mean())),
        "scale_asymmetry:y=700": (1, 7e-4 * np.abs(omega[:, 1])),
        "scale_quadratic:z=9e4": (2, 9e-2 * omega[:, 2] * np.abs(np.rad2deg(omega[:, 2]))),
        "g_matrix_step:z=1300,toward=y,time_s=1500": (2, 1.3e-3 * omega[:, 1] * (t > 1500)),
        "g_matrix_temperature:z=500,toward=y": (2, 5e-4 * omega[:, 1] * (T - T.mean())),
        "acceleration_sensitivity:x=30,toward=y": (0, 30 * DEG_H * (a - a.mean()) / STANDARD_GRAVITY),
    }
    for text, (axis, values) in expected.items():
        difference = shown(text)
        np.testing.assert_allclose(difference[:, axis], values, rtol=0, atol=1e-9 * np.abs(values).max(), err_msg=text)
        assert not np.delete(difference, axis, axis=1).any(), text


def test_reference_effects_in_closed_form():
    n, t = 2 * np.pi / PLAIN.orbit.period_s, PLAIN.attitudes.t_s
    expected = {
        "reference_orbital:x=0.02,phase_deg=40": np.outer(0.02 * np.sin(n * t + np.deg2rad(40)), [1, 0, 0]),
        "reference_horizon:y=0.02,phase_deg=40": np.outer(0.02 * np.sin(2 * n * t + np.deg2rad(40)), [0, 1, 0]),
        "reference_periodic:z=0.02,period_s=300": np.outer(0.02 * np.sin(2 * np.pi * t / 300), [0, 0, 1]),
        "reference_mode_offset:z=0.1": np.outer(0.1 * (t > 2460), [0, 0, 1]),
    }
    for text, values in expected.items():
        made = simulator.simulate(SCENARIO, noise=False, effects=[parse(text)]).attitudes.quaternions
        np.testing.assert_allclose(np.rad2deg(separation(made, PLAIN.attitudes.quaternions)), -values, atol=1e-12, err_msg=text)


def test_lag_of_a_sine_in_closed_form():
    """After the transient the output is the input turned and shrunk by 1/(1 + iωτ); at three samples a time constant."""
    tau, omega, dt = 1.5, 2 * np.pi / 40, 0.5
    edge = dt * np.arange(401)
    angle = np.diff(np.exp(1j * omega * edge) / (1j * omega)) / dt
    rates = np.column_stack([angle.imag, 0 * angle.imag, np.ones(400)])
    out = apply_lag(rates, np.full(400, dt), tau)
    np.testing.assert_allclose(out[60:-1, 0], (angle / (1 + 1j * omega * tau)).imag[60:-1], atol=2e-6)  # the spline ends there
    np.testing.assert_allclose(out[:, 2], 1.0, atol=1e-14)


def test_text_form():
    made = parse("g_matrix_step:z=1300,toward=y,time_s=15000")
    assert (made.effect, made.axis, made.size) == ("g_matrix_step", "z", 1300.0)
    assert dict(made.parameters) == {"toward": "y", "time_s": 15000.0}
    assert made.label() == "g_matrix_step:z"
    assert parse(" spikes : x = 1 , fraction = 0.01 ").label() == "spikes:x"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("bias_drft:z=1", "did you mean bias_drift"),
        ("bias_drift=1", "which axis"),
        ("bias_drift:z", "give its size in deg/h per day"),
        ("bias_drift:z=much", "much is not a number"),
        ("time_offset:x=1", "has no axis"),
        ("spikes:x=1,fractoin=0.1", "no parameter fractoin; it has fraction"),
        ("bias_drift:z=nan", "not a finite number"),
        ("rate_lag=-1", "not within 0"),
        ("bias_step:z=1", "time_s is missing"),
        ("bias_orbital:z=1,phase_deg=1,phase_deg=2", "given twice"),
    ],
)
def test_bad_text_is_one_clear_line(text, words):
    with pytest.raises(InputError, match=re.escape(words)) as caught:
        parse(text)
    assert "\n" not in str(caught.value)


def test_accelerations_are_those_of_a_body_on_a_rate_table():
    """Standard gravity in any attitude, to five sigma of the noise of 0.01 m/s² about each axis."""
    table = ACCELERATIONS.tables["housekeeping"]
    norm = np.linalg.norm(table[[f"gyro_acceleration_{k}_m_s2" for k in "xyz"]].to_numpy(), axis=1)
    np.testing.assert_allclose(norm, STANDARD_GRAVITY, atol=0.05)


@pytest.mark.parametrize("filler", [1e300, np.inf, np.nan])
def test_housekeeping_is_read_in_order_of_time_and_without_fillers(filler):
    t_s = np.arange(1000.0, -1.0, -10.0)
    table = pd.DataFrame(
        {"t_s": t_s, "gyro_temperature_c": np.where(t_s == 500.0, filler, 20.0 + 0.01 * t_s), "mode": "nominal"}
    )
    found = interpolate_housekeeping(replace(PLAIN, tables={"housekeeping": table}), np.array([100.0, 503.0]))
    assert found.keys() == {"gyro_temperature_c"}
    np.testing.assert_allclose(found["gyro_temperature_c"], [21.0, 25.03])
