"""The command line: parse, call, print. Exit code 0 when the work was done, 2 for input that cannot be used."""

from torchrbd.cli.main import main

__all__ = ["main"]
