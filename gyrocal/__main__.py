"""``python -m gyrocal``: the command line, which is installed with this package and imports it."""

from importlib.metadata import entry_points

if __name__ == "__main__":
    (command,) = entry_points(group="console_scripts", name="gyrocal")
    command.load()(prog_name="python -m gyrocal")
