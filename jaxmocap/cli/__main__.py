"""``python -m jaxmocap.cli``: the command itself."""

from jaxmocap.cli import enter

enter()
