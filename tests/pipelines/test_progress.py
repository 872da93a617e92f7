"""Bars: on a terminal unless they are refused, elsewhere only where they are asked for."""

import io
import sys

import pytest

from jaxmocap.pipelines.progress import progress_bar


class Terminal(io.StringIO):
    def isatty(self):
        return True


def shown(progress, stream, monkeypatch):
    """What a bar over three steps prints."""
    monkeypatch.setattr(sys, "stderr", stream)
    with progress_bar("tracking", progress) as show:
        for done in (1, 2, 3):
            show(done, 3)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("progress", "stream", "is_shown"),
    [
        (None, Terminal, True),
        (None, io.StringIO, False),
        (False, Terminal, False),
        (True, io.StringIO, True),
    ],
)
def test_a_bar_shows_on_a_terminal_without_being_asked_for(progress, stream, is_shown, monkeypatch):
    assert ("tracking" in shown(progress, stream(), monkeypatch)) == is_shown


def test_a_callers_own_is_called_in_place_of_a_bar(monkeypatch):
    calls = []
    assert not shown(lambda *counts: calls.append(counts), Terminal(), monkeypatch)
    assert calls == [(1, 3), (2, 3), (3, 3)]
