"""The kinds of ``jaxmocap silhouette``: tracking without markers.

Begin with ``track``.
"""

from jaxmocap.cli.command import Command
from jaxmocap.cli.silhouette import demo, model, track

PURPOSE = "track a person without markers, by silhouettes"
COMMANDS: tuple[Command, ...] = (track, demo, model)
