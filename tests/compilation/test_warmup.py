"""Compiling ahead: what is tracked for it, what is counted, what is reported."""

import json
from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_recording import SAMPLES, small_recording, with_frames

from jaxmocap.cli.program import main
from jaxmocap.formats.files.errors import InputError
from jaxmocap.pipelines import warmup
from jaxmocap.pipelines.warmup import counting_compilations, first_half_second


def test_programs_are_counted_and_those_that_were_there_apart():
    def fresh():
        return jax.jit(lambda x: jnp.sin(x) * 3 + x.shape[0])

    with counting_compilations("first") as first:
        fresh()(np.ones(7, np.float32))
    with counting_compilations("second") as second:
        fresh()(np.ones(7, np.float32))
    with counting_compilations("outside") as outside:
        pass
    fresh()(np.ones(8, np.float32))
    assert (first.programs, second.programs, second.from_cache) == (1, 1, 1)
    assert list(first.longest_s) == ["<lambda>"] and first.longest_s["<lambda>"] > 0
    assert (outside.programs, outside.from_cache, outside.longest_s) == (0, 0, {})
    assert "0 programs compiled, 1 were there" in second.text()


def test_what_is_tracked_is_the_first_half_second_that_has_both():
    recording = small_recording()
    positions = np.concatenate([recording.positions_world] * 3)
    positions[:4] = np.nan
    long = replace(recording, times=np.arange(3 * SAMPLES) / 60, positions_world=positions)
    assert first_half_second(replace(long, videos=())).times[[0, -1]] == pytest.approx(
        [4 / 60, 33 / 60]
    )
    times, images = recording.videos[0].frames
    late = first_half_second(with_frames(long, times + 0.1, images))
    assert late.times[[0, -1]] == pytest.approx([7 / 60, 36 / 60])
    assert late.videos and len(late.positions_world) == len(late.times)
    positions[10:60] = np.nan
    with pytest.raises(InputError, match="no marker was measured beside the video"):
        first_half_second(
            with_frames(replace(long, positions_world=positions), times + 0.2, images)
        )


def test_the_command_tracks_both_ways_and_says_what_it_took(monkeypatch, capsys):
    asked = []
    made = lambda recording, settings: SimpleNamespace(settings=settings)  # noqa: E731
    monkeypatch.setattr(warmup.HybridTracker, "from_recording", made)
    monkeypatch.setattr(
        warmup,
        "track",
        lambda recording, tracker, mode, **_: asked.append((recording, tracker, mode)),
    )
    assert main(["warmup", "--refine", "none", "--json", "-"]) == 0
    printed = capsys.readouterr()
    assert [mode for _, _, mode in asked] == ["own", "causal"]
    assert asked[0][1].settings.refine == "none"
    assert asked[0][0].name == "standing" and len(asked[0][0].times) == 15
    assert [each["mode"] for each in json.loads(printed.out)["modes"]] == list(
        warmup.MODE_NAMES.values()
    )
    assert "track: 0.0 s, 0 programs compiled" in printed.err and "kept in" in printed.err


@pytest.mark.parametrize(
    ("settings", "modes"),
    [
        ("smooth = false\nlow_pass = 2.0\n", ["own"]),
        ("smooth = false\nsearch = false\n", ["nearest"]),
        ('smooth = false\nrefine = "simplex"\n', ["own", "causal"]),
    ],
)
def test_ways_that_the_settings_do_not_allow_are_not_compiled(
    tmp_path, monkeypatch, settings, modes
):
    asked = []
    made = lambda recording, settings: SimpleNamespace(settings=settings)  # noqa: E731
    monkeypatch.setattr(warmup.HybridTracker, "from_recording", made)
    monkeypatch.setattr(warmup, "track", lambda recording, mode, **_: asked.append(mode))
    (tmp_path / "s.toml").write_text(settings)
    assert main(["warmup", "--settings", str(tmp_path / "s.toml")]) == 0
    assert asked == modes


def test_a_live_file_is_compiled_for_live_with_and_without_smoothing(tmp_path, monkeypatch, capsys):
    asked = []

    class Compiles:
        def __init__(self, setup, settings, smooth):
            asked.append((setup.marker_names, settings.refine, smooth))

        def wait_until_ready(self):
            pass

    monkeypatch.setattr(warmup, "LiveTracking", Compiles)
    path = tmp_path / "live.toml"
    path.write_text("[markers.on]\nHmd = { bone = 'head' }\n")
    assert main(["warmup", str(path), "--refine", "none"]) == 0
    assert asked == [(("Hmd",), "none", False), (("Hmd",), "none", True)]
    assert "live --smooth: 0.0 s, 0 programs compiled" in capsys.readouterr().out
    # Which live runs take without smoothing only.
    asked.clear()
    assert main(["warmup", str(path), "--refine", "simplex"]) == 0
    assert asked == [(("Hmd",), "simplex", False)]
