"""Kinds of evidence, one against another: the key points that are made, and a quick run."""

import json

import jax.numpy as jnp
import numpy as np
import pytest
from small_recording import CAMERA

from bench import evidence
from bench.clips import Clip
from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.formats.keypoints import read_keypoints
from jaxmocap.formats.trc import write_trc
from jaxmocap.geometry.cameras import project

FRAMES = 200


def test_made_key_points_lie_near_the_truth_but_for_some(tmp_path):
    times = np.arange(FRAMES) / 30
    points = {
        name: np.full((FRAMES, 3), [0.0, 0.02 * i, 0.3 + 0.05 * i])
        for i, name in enumerate(LANDMARKS)
    }
    write_trc(tmp_path / "truth.trc", times, points)
    same = {name: name for name in LANDMARKS}
    clip = Clip("tennis", "clip", tmp_path / "recording.toml", same, seed=3)
    evidence.write_keypoints(tmp_path / "points", clip, CAMERA, times)
    found = read_keypoints(tmp_path / "points", evidence.MODEL)
    assert found.numbers.tolist() == list(range(FRAMES))
    assert {"elbow_l", "elbow_r", "wrist_l", "vertex"} <= set(found.landmarks)
    true = np.stack(
        [np.asarray(project(CAMERA, jnp.asarray(points[name]))) for name in found.landmarks], 1
    )
    off = np.linalg.norm(found.pixels_xy[:, 0] - true, axis=-1)
    assert np.median(off) == pytest.approx(1.18 * evidence.NOISE_PX, rel=0.1)
    assert 0.5 * evidence.FALSE < np.mean(off > 15) < 1.2 * evidence.FALSE
    assert found.confidences.min() >= 0.19 and found.confidences.max() <= 1


def test_a_quick_run_measures_key_points(tmp_path, capsys):
    evidence.main(["--quick", "--seeds", "0", "--json", str(tmp_path / "found.json")])
    assert "silhouettes, colours, key points" in capsys.readouterr().out
    metrics = json.loads((tmp_path / "found.json").read_text())["metrics"]
    found = {metric["name"].split(", ", 1)[1]: metric["value"] for metric in metrics}
    assert list(found) == ["markers alone", evidence.USUAL, *evidence.QUICK]
    assert 0 < found[evidence.QUICK[0]] < found["markers alone"]
