import pytest

from gyrocal.errors import InputError
from simulator.scenario import load
from studies.montecarlo.engine import run
from studies.montecarlo.study import (
    GridConfig,
    Study,
    StudyConfig,
    find,
    hash_config,
    load_base_scenario,
    load_config,
    resolve_config,
)
from tests.engine_studies import DRAWS, RECORDED, DrawsConfig, draws_case

NORMAL = {"kind": "normal", "sigma": 1e-3, "mode": "offset"}
PATH = "gyro.true_G.0.0"


def test_settings_are_changed_by_name_by_a_path_or_by_a_file(tmp_path):
    spread = NORMAL | {"sigma": 2e-3}
    changes = {"steps_s": [0.5, 4.0], "overrides.gyro.arw_deg_per_sqrt_s": 1e-4, f"dispersions.{PATH}": spread}
    config = load_config(DRAWS, None, changes)
    assert (config.steps_s, config.dispersions[PATH].sigma) == ((0.5, 4.0), 2e-3)
    assert load_base_scenario(config).gyro.arw_deg_per_sqrt_s == 1e-4
    path = tmp_path / "study.toml"
    path.write_text(f'cases = 5\nsteps_s = [1.0, 8.0]\n[dispersions."{PATH}"]\nkind = "normal"\nsigma = 1e-3\n')
    config = load_config(DRAWS, path, {"entropy": 3})
    assert (config.cases, config.entropy, config.steps_s) == (5, 3, (1.0, 8.0))
    assert config.dispersions[PATH].sigma == 1e-3
    path.write_text("cases = 5\nstep_s = 1.0\n")
    with pytest.raises(InputError, match=r"study\.toml: step_s: is not known; did you mean steps_s\?"):
        load_config(DRAWS, path)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("casse", 3, r"casse: there is no such setting; did you mean cases\?"),
        ("steps_s.2", 3.0, "there is no such setting; give steps_s as a whole"),
        ("cases", "3", "cases: must be a whole number"),
        ("cases", 0, "cases: must be between 1 and"),
        ("steps_s", [1.0, "2"], "steps_s.1"),
        (f"dispersions.{PATH}", NORMAL | {"width": 2}, "width: is not known; there are mode, kind, mean, sigma"),
        (f"dispersions.{PATH}", {"kind": "uniform", "low": 2.0, "high": 1.0}, "must be above low"),
        ("label", object(), "not JSON serializable"),
    ],
)
def test_a_wrong_setting_is_one_line(path, value, message):
    with pytest.raises(InputError, match=message) as caught:
        load_config(DRAWS, None, {path: value})
    assert "\n" not in str(caught.value)


def test_a_resolved_configuration_survives_its_json_bit_for_bit():
    ready = resolve_config(DrawsConfig(dispersions={PATH: NORMAL}, overrides={"gyro.arw_deg_per_sqrt_s": 0.1 + 0.2}))
    again = DrawsConfig.model_validate_json(ready.model_dump_json())
    assert again == ready
    assert again.scenario.gyro.arw_deg_per_sqrt_s == 0.1 + 0.2
    assert resolve_config(again) == ready


def test_the_hash_is_of_what_the_rows_depend_on():
    def sha256(config, study=DRAWS):
        return hash_config(study, resolve_config(config))

    other = {"orbit.raan_deg": NORMAL}
    distinct = [
        sha256(DrawsConfig()),
        sha256(DrawsConfig(size=3)),
        sha256(DrawsConfig(scenario="trmm_series")),
        sha256(DrawsConfig(overrides={"gyro.arw_deg_per_sqrt_s": 1e-3})),
        sha256(DrawsConfig(dispersions={PATH: NORMAL} | other)),
        sha256(DrawsConfig(dispersions=other | {PATH: NORMAL})),  # the other Sobol dimensions
        sha256(StudyConfig(), RECORDED),
    ]
    assert len(set(distinct)) == len(distinct)
    arw = load("trmm").gyro.arw_deg_per_sqrt_s
    assert sha256(DrawsConfig(overrides={"gyro.arw_deg_per_sqrt_s": arw}, scenario=load("trmm"))) == distinct[0]


def test_studies_are_found_by_name_alone(tmp_path):
    assert find(DRAWS.name) is DRAWS
    for name in ("nowhere:STUDY", "tests.engine_studies:NOTHING", "tests.engine_studies", ":", "tests.engine_studies:odd_case"):
        with pytest.raises(InputError, match=r"module:attribute|not the study"):
            find(name)
    nameless = Study("tests.engine_studies:STEPS", DrawsConfig, draws_case)
    with pytest.raises(InputError, match="not the study"):
        run(nameless, DrawsConfig(), tmp_path)


class Grid(GridConfig):
    axes = ("sizes", "steps_s")
    sizes: tuple[int, ...] = (1, 2, 3)
    steps_s: tuple[float, ...] = (0.5, 1.0)


GRID = Study("tests.engine_studies:GRID", Grid, draws_case)


def test_the_axes_of_a_grid_say_how_many_cases_there_are():
    assert Grid().points() == [(1, 0.5), (1, 1.0), (2, 0.5), (2, 1.0), (3, 0.5), (3, 1.0)]
    assert Grid().cases == 6
    smaller = load_config(GRID, None, {"sizes": [2]})
    assert smaller.points() == [(2, 0.5), (2, 1.0)]
    assert smaller.cases == 2
    # A worker gets the configuration as JSON.
    assert Grid.model_validate_json(resolve_config(smaller).model_dump_json()).cases == 2
