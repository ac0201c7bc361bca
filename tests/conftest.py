import pytest
from click.testing import CliRunner
from hypothesis import settings
from threadpoolctl import threadpool_limits

from studies.cli.main import main

# The same examples in every run, and no deadline: a verdict must not hang on how busy the machine is.
settings.register_profile("suite", deadline=None, derandomize=True, database=None)
settings.load_profile("suite")


@pytest.fixture(scope="session", autouse=True)
def _one_thread_of_blas():
    """Tests run side by side on few cores: threads of the linear algebra would only wait for one another."""
    with threadpool_limits(1, user_api="blas"):
        yield


@pytest.fixture
def run_cli():
    """Run the command line in this process; stdout and stderr are kept apart."""
    runner = CliRunner()
    return lambda *arguments: runner.invoke(main, list(arguments))
