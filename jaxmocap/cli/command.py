"""What a command of the command line is: its name, its options, what it runs.

INPUTS: none. OUTPUTS: Command records, one in each file of the rooms below.
"""

import argparse
from collections.abc import Callable
from typing import NamedTuple


class Command(NamedTuple):
    """One command.

    Attributes:
        name: as it is typed.
        purpose: one line of the help.
        run: runs it with the parsed options; an exit code, or None for 0.
        add_options: adds its options to a parser.
        example: a command line of it.
        reports_figures: whether it takes --json, a file for its figures.
    """

    name: str
    purpose: str
    run: Callable[[argparse.Namespace], int | None]
    add_options: Callable[[argparse.ArgumentParser], None]
    example: str
    reports_figures: bool = True
