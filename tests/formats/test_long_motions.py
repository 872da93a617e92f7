"""What a long motion takes in memory while its files are written, and that they are."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from jaxmocap.body.motion import Motion, Report
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.formats.animation.export import write_animation
from jaxmocap.formats.armatures import armature
from jaxmocap.formats.motion_npz import load_motion, save_motion
from jaxmocap.formats.time_series.csv import write_csv
from jaxmocap.formats.time_series.mot import write_isb, write_mot
from jaxmocap.formats.time_series.trc import write_trc
from jaxmocap.geometry import euler, rows

RATE = 90.0


def swaying(samples: int) -> Motion:
    skeleton, times = Skeleton.human(1.75), np.arange(samples) / RATE
    limits, relaxed = np.asarray(skeleton.limits), np.asarray(skeleton.relaxed)
    phases = np.random.default_rng(0).uniform(0, 6, len(relaxed))
    angles = relaxed + 0.15 * np.ptp(limits, axis=1) * np.sin(times[:, None] + phases)
    parts = np.zeros((samples, 3)), np.tile(np.eye(4)[0], (samples, 1)), angles
    return Motion(skeleton, times, Pose(*(part.astype(np.float32) for part in parts)))  # type: ignore[arg-type]


def points_of(motion: Motion) -> dict[str, np.ndarray]:
    """As many as there are landmarks."""
    return {name: np.asarray(motion.poses.position) for name in LANDMARKS}


# Few rows at a time.
BLOCKS = (
    (rows, "BLOCK_ROWS", 200),
    (armature, "BLOCK_ROTATIONS", 5_000),
    (euler, "_BLOCK_ROTATIONS", 5_000),
    (euler, "_BLOCK_STEPS", 20_000),
)
# Writer -> bytes a sample that it may take: the angles of a motion, and where each triple of them
# comes from.
WRITERS = {
    "angles.mot": (write_mot, 300),
    "angles_isb.mot": (write_isb, 700),
    "motion.bvh": (write_animation, 700),
    "motion.glb": (write_animation, 150),
    "joints.trc": (lambda path, motion: write_trc(path, motion.times, points_of(motion)), 100),
    "joints.csv": (lambda path, motion: write_csv(path, motion.times, points_of(motion)), 100),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_sample_more_takes_little_more_memory(name, tmp_path, monkeypatch):
    for module, block, size in BLOCKS:
        monkeypatch.setattr(module, block, size)
    write, most = WRITERS[name]
    peaks = []
    counts = 2_000, 8_000
    # What is compiled and imported is no part of it.
    write(tmp_path / name, swaying(300))
    for count in counts:
        motion = swaying(count)
        tracemalloc.start()
        write(tmp_path / name, motion)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert (peaks[1] - peaks[0]) / (counts[1] - counts[0]) < most, peaks


def test_sentences_that_many_samples_share_are_in_the_file_once(tmp_path):
    """An hour's own of every sample are more than is read."""
    motion, count = swaying(2_000), 2_000
    sentences = ("marker Hand is missing", "left elbow: not determined within 15 cm")
    statuses = tuple(sentences[: i % 3] for i in range(count))
    none, unknown = np.zeros((count, 0)), np.full((count, 2), np.nan)
    of_all = np.zeros((count, len(LANDMARKS), 3))
    report = Report((), none, unknown, unknown, of_all, of_all[..., 0], statuses)
    save_motion(tmp_path / "motion.npz", replace(motion, report=report))
    read = load_motion(tmp_path / "motion.npz").report
    assert read is not None and read.statuses == statuses
    with np.load(tmp_path / "motion.npz") as file:
        assert len(str(file["report.statuses"])) < 5 * count
