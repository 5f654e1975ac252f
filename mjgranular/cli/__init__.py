"""The command `mjgranular`."""

from mjgranular.cli.main import main as main
