"""A head that turns by 60°: head and hands stay where they are measured, in every mode."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from turning_head import write_turning_head

from jaxmocap import Recording, Settings
from jaxmocap.body.kinematics import forward, site_positions
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.pipelines.tracking.track import track

# What a measured head or hand may be off in 95 % of the samples, metres and degrees.
HELD_M, HELD_DEG = 0.01, 3.0


@pytest.mark.slow
@pytest.mark.parametrize("oriented", [True, False])
@pytest.mark.parametrize("way", ["smoothed", "frame by frame", "no video"])
def test_measured_head_and_hands_hold_while_the_head_turns(tmp_path, way, oriented):
    path, R_world_head = write_turning_head(tmp_path, oriented=oriented, filmed=way != "no video")
    recording, settings = Recording.load(path), Settings()
    settings = replace(settings, smooth=way == "smoothed")
    poses = jax.tree.map(np.asarray, track(recording, settings, mode="causal").poses)
    model = HybridTracker.from_recording(recording, settings).model

    def placed(pose):
        frames = forward(model.skeleton, pose)
        head = frames.R_world_bone[model.skeleton.tree.bone("head")]
        return site_positions(model.skeleton, frames, model.markers), head

    points, R = jax.jit(jax.vmap(placed))(poses)
    off = np.linalg.norm(np.asarray(points) - recording.positions_world, axis=-1)
    assert np.percentile(off, 95) < HELD_M
    if oriented:
        between = np.einsum("tij,tij->t", np.asarray(R), R_world_head)
        turned = np.degrees(np.arccos(np.clip((between - 1) / 2, -1, 1)))
        assert np.percentile(turned, 95) < HELD_DEG
