"""Recordings with raw sensor tables that the tests of their model and of their diagnosis share."""

from dataclasses import replace
from functools import cache

from diagnosis.model.sensors.arcs import build_arcs, fit_arcs
from simulator import scenario
from simulator.effects.sensor import SENSOR_EFFECTS, parse
from simulator.sensors.raw_tables import simulate_sensor_tables
from simulator.simulate import motion, simulate

MONTHS = scenario.load("trmm_months")
DAYS = ("d01", "d09", "d17", "d25", "d33", "d37", "d45", "d53", "d61", "d69", "d73", "d81")
FEW = MONTHS.model_copy(update={"interval": tuple(one for one in MONTHS.interval if one.name in DAYS)})
ONE = MONTHS.model_copy(update={"interval": tuple(one for one in MONTHS.interval if one.name == "d73")})
MOTION = motion(FEW)
EFFECTS = tuple(SENSOR_EFFECTS.values())


BARE = FEW.model_copy(update={"sensors": None})  # whose own tables would not be looked at


@cache
def recorded(*effects, seed=1, change=None):
    """A recording whose attitudes and gyro are those of the seed, with noise."""
    plain = simulate(BARE, seed=seed)
    return replace(plain, sensors=simulate_sensor_tables(FEW, MOTION, [parse(one) for one in effects], seed, change=change))


def fits_of(recording):
    """Its arcs fitted under M0."""
    return fit_arcs(build_arcs(recording)[0])[0]
