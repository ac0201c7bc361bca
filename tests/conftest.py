import pytest
from click.testing import CliRunner

from studies.cli import main


@pytest.fixture
def run_cli():
    """Run the command line in this process; stdout and stderr are kept apart."""
    runner = CliRunner()
    return lambda *arguments: runner.invoke(main, list(arguments))
