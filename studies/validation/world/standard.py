"""The kinds of plans and the grades that the diagnosis was developed with."""

from studies.validation.world.kinds import Grade, Kind
from studies.validation.world.motions.carriers import (
    draw_circuit_motion,
    draw_drone_motion,
    draw_gondola_motion,
    draw_ship_motion,
    draw_staircase_motion,
)
from studies.validation.world.motions.spacecraft import (
    draw_detumble_motion,
    draw_spinner_motion,
    draw_sun_rolls,
    draw_telescope_motion,
    draw_wheel_ramps,
    draw_yaw_steering,
)
from studies.validation.world.trmm import draw_trmm_plan

ARCSEC = 1 / 3600
GRADES = {
    "mems_consumer": Grade((3e-3, 2e-2), (0.02, 0.5), (3e-3, 1.5e-2), (0.05, 1.0)),
    "mems_industrial": Grade((1e-3, 5e-3), (5e-3, 0.1), (1e-3, 5e-3), (0.02, 0.3)),
    "mems_tactical": Grade((3e-4, 1.5e-3), (5e-4, 2e-2), (5e-4, 3e-3), (0.005, 0.1)),
    "tuned_rotor": Grade((3e-5, 3e-4), (1e-4, 3e-3), (3e-4, 2e-3), (0.002, 0.05)),
    "fog_tactical": Grade((2e-4, 1e-3), (1e-4, 3e-3), (2e-4, 2e-3), (0.003, 0.05)),
    "fog_fine": Grade((1e-5, 1e-4), (1e-5, 3e-4), (1e-4, 1e-3), (2 * ARCSEC, 60 * ARCSEC)),
    "ring_laser": Grade((2e-5, 1e-4), (1e-6, 5e-5), (3e-5, 5e-4), (2 * ARCSEC, 40 * ARCSEC)),
    "resonator": Grade((2e-6, 3e-5), (1e-7, 3e-5), (2e-5, 5e-4), (1 * ARCSEC, 20 * ARCSEC)),
    "quartz_fork": Grade((1.5e-4, 8e-4), (3e-3, 8e-2), (1e-4, 1e-3), (0.003, 0.03)),
    "small_shell": Grade((2e-5, 2e-4), (2e-4, 5e-3), (2e-4, 2e-3), (10 * ARCSEC, 80 * ARCSEC)),
    "short_coil": Grade((1e-3, 6e-3), (3e-4, 5e-3), (1e-3, 6e-3), (0.002, 0.02)),
    "coarse_sky": Grade((3e-5, 2e-4), (1e-5, 1e-3), (1e-4, 1e-3), (0.1, 0.8)),
    "loose_mount": Grade((1e-5, 1e-4), (1e-4, 3e-3), (3e-3, 1.2e-2), (5 * ARCSEC, 60 * ARCSEC)),
    "floated": Grade((1e-5, 6e-5), (2e-4, 3e-3), (1e-5, 2e-4), (5 * ARCSEC, 40 * ARCSEC)),
}

FLIGHT = Grade((1e-4, 3e-4), (5e-5, 3e-4), (3e-4, 2e-3), (0.003, 0.02))  # TRMM's gyros and references
KINDS = {
    "trmm": Kind((0.5, 1, 2), (6, 6), (900, 6000), (100, 300), (0.1, 0.3), orbit=True, grade=FLIGHT, draw=draw_trmm_plan),
    "slews_and_rests": Kind((1, 2, 5, 10), (4, 14), (300, 7200), (5, 300), (0.05, 1.5)),
    "hand_motion": Kind((50, 100), (1, 6), (60, 400), (0.1, 2), (2, 30), 8, (0.05, 5)),
    "earth_with_offsets": Kind((1, 2, 4), (4, 10), (1500, 9000), (20, 600), (0.05, 0.6), orbit=True),
    "bench": Kind((20, 50, 100, 200), (3, 30), (10, 120), (0.05, 2), (1, 20), 3),
    "scan": Kind((2, 5, 10), (3, 10), (600, 5400), (5, 120), (0.05, 1.0), 2, scan=True),
    "tumble": Kind((4, 10, 20, 50), (2, 8), (60, 1500), (0.5, 20), (0.1, 2.0), 2, tumble=True),
    "swaying_craft": Kind((20, 50, 100, 200), (2, 10), (60, 900), (0.1, 5), (0.5, 6), 4, (0.05, 2)),
    "slow_drift": Kind((1, 2, 5), (6, 40), (600, 21600), (30, 600), (0.02, 0.3), 2),
    "agile": Kind((5, 10, 20), (6, 40), (60, 900), (1, 30), (0.5, 4), 5),
    "earth_agile": Kind((2, 5, 10), (4, 12), (600, 4000), (5, 120), (0.1, 1.5), 3, (0.001, 0.02), (0.002, 0.05), orbit=True),
    "spinner": Kind((4, 10, 20), (3, 10), (120, 1800), (0.25, 20), (1, 20), motion=draw_spinner_motion),
    "detumble": Kind((4, 10, 20), (2, 8), (200, 3000), (0.5, 20), (0.3, 4), orbit=True, motion=draw_detumble_motion),
    "telescope": Kind((2, 5, 10), (4, 14), (600, 5400), (5, 120), (0.05, 0.8), orbit=True, motion=draw_telescope_motion),
    "yaw_steering": Kind((1, 2, 4), (3, 10), (1500, 9000), (10, 300), (0.05, 0.1), orbit=True, motion=draw_yaw_steering),
    "wheel_ramps": Kind((2, 4, 8), (3, 12), (300, 3600), (2, 60), (0.05, 0.6), motion=draw_wheel_ramps),
    "sun_rolls": Kind((1, 2, 5), (4, 16), (600, 7200), (10, 300), (0.05, 0.5), motion=draw_sun_rolls),
    "gondola": Kind((20, 50, 100), (3, 10), (200, 1800), (0.5, 20), (0.2, 3), motion=draw_gondola_motion),
    "ship": Kind((20, 50, 100), (3, 12), (120, 1200), (0.2, 5), (0.5, 3), motion=draw_ship_motion),
    "circuits": Kind((25, 50, 100), (2, 8), (200, 1800), (0.2, 10), (2, 12), motion=draw_circuit_motion),
    "drone": Kind((100, 200), (2, 10), (30, 300), (0.05, 1), (10, 60), motion=draw_drone_motion),
    "staircase": Kind((20, 50, 100), (3, 18), (40, 400), (0.05, 2), (2, 40), motion=draw_staircase_motion),
}
