"""Bone lengths from a recording: estimated where it shows them, and reported as open where not."""

import json
import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import on_device
from drawn_arms import SIZE
from painted_motion import (
    CAMERAS,
    CELL_PX,
    CELLS,
    MODEL,
    PERSON,
    limb_distances,
    per_metre,
    problem,
    truth,
)

from jaxmocap.body.pose import Pose
from jaxmocap.body.proportions import (
    GIRTHS,
    LENGTHS,
    PROPORTIONS,
    covariance_among_people,
    scale_skeleton,
)
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.calibration.fitting.lengths import LengthsFit, fit_lengths
from jaxmocap.evidence.silhouettes import SilhouetteGrids
from jaxmocap.formats.recordings.recording import write_recording
from jaxmocap.formats.recordings.subject import read_subject, write_subject
from jaxmocap.formats.time_series.trc import write_trc
from jaxmocap.images.regions import Region
from jaxmocap.images.silhouette_grid import Grid
from jaxmocap.pipelines.scaling.lengths_report import (
    DETERMINED,
    NOT_DETERMINED,
    PARTLY_DETERMINED,
    LengthsReport,
    verdict_of,
)
from jaxmocap.smoothing.problem import UNTURNED, Trajectory, Views
from jaxmocap.solvers.status import Status

NAMES = [proportion.name for proportion in LENGTHS]
ALL = len(LENGTHS) + len(GIRTHS)
# The person is stated with an upper arm and a forearm that are this wrong.
WRONG = {"upper arm": -0.07, "forearm": 0.06}
COUNT, SOFTNESS = 64, (0.8,)


def test_a_factor_changes_its_own_bones_and_nothing_else():
    for row, proportion in enumerate((*LENGTHS, *GIRTHS)):
        logarithms = jnp.zeros(ALL).at[row].set(0.1)
        person = scale_skeleton(PERSON, logarithms)
        own = np.isin(PERSON.tree.bones, PERSON.tree.names_in(*proportion.bones))
        assert own.any()
        lengths = np.where(own & (row < len(LENGTHS)), np.exp(0.1), 1.0)
        girths = np.where(own & (row >= len(LENGTHS)), np.exp(0.1), 1.0)
        np.testing.assert_allclose(person.lengths / PERSON.lengths, lengths, rtol=1e-5)
        ratio = np.asarray(person.diameters / PERSON.diameters)
        np.testing.assert_allclose(ratio, np.stack([girths, girths], 1), rtol=1e-5)


def test_fewer_factors_are_the_first_ones():
    few = jnp.array([0.05, -0.04])
    padded = jnp.concatenate([few, jnp.zeros(ALL - 2)])
    np.testing.assert_allclose(
        scale_skeleton(PERSON, few).lengths, scale_skeleton(PERSON, padded).lengths
    )


def test_people_of_one_stature_have_lengths_in_common():
    among = covariance_among_people(ALL)
    assert (np.linalg.eigvalsh(among) > 0).all()
    common = among[NAMES.index("thigh"), NAMES.index("forearm")]
    assert common > 0
    assert not among[len(LENGTHS) :, : len(LENGTHS)].any()
    two = covariance_among_people(len(PROPORTIONS))
    np.testing.assert_allclose(two, np.diag([p.deviation**2 for p in PROPORTIONS]))


def coverage(pose, camera, grids):
    """The person (S, S) as the tracker draws it."""
    return jax.nn.sigmoid(-limb_distances(pose, camera, grids)[0] / 0.2)


def of_own_flesh() -> Views:
    """Views in which nothing is wrong but the lengths that are stated."""
    poses, frames = truth(COUNT), np.tile(np.arange(0, COUNT, 8), len(CAMERAS))
    cameras = np.repeat(np.arange(len(CAMERAS)), len(frames) // len(CAMERAS))
    corner = (np.array(SIZE) - CELLS * CELL_PX) // 2 - 0.5
    region = Region(np.asarray(corner, np.float32), np.asarray(CELL_PX, np.float32))
    blank = Grid(*np.zeros((2, CELLS, CELLS), np.float32))
    grids, metres = [], np.array([per_metre(camera) for camera in cameras])
    for frame, camera in zip(frames, cameras, strict=True):
        pose = on_device(Pose(*(part[frame] for part in poses)))
        where = on_device(SilhouetteGrids(region, blank, blank, per_metre(camera)))
        grids.append(coverage(pose, CAMERAS[camera], where))
    person = Grid(np.stack(grids), np.ones((len(frames), CELLS, CELLS), np.float32))
    regions = Region(*(np.tile(part, (len(frames), *[1] * part.ndim)) for part in region))
    regions = regions._replace(scale=regions.scale.ravel())
    return Views(frames, cameras, SilhouetteGrids(regions, person, person, metres))


@cache
def fitted(worth: float, blind: bool = False) -> LengthsFit:
    """Of a person who is stated wrongly."""
    logarithms = np.array([WRONG.get(name, 0.0) for name in NAMES])
    stated = scale_skeleton(PERSON, jnp.asarray(logarithms, jnp.float32))
    shown = of_own_flesh()
    drawn_recording = problem(COUNT, shown.none if blind else shown)
    drawn_recording = replace(drawn_recording, model=replace(MODEL, skeleton=stated))
    start = Trajectory(truth(COUNT), np.zeros(len(PROPORTIONS), np.float32), UNTURNED)
    return fit_lengths(drawn_recording, start, SOFTNESS, worth)


def test_lengths_that_are_stated_wrongly_are_found_by_silhouettes():
    fit = fitted(300.0)
    for name, wrong in WRONG.items():
        row = NAMES.index(name)
        assert abs(fit.logarithms[row] + wrong) < 0.5 * abs(wrong), name
        assert verdict_of(fit.before[row], fit.after[row]) == "determined"
    assert abs(fit.logarithms[NAMES.index("shoulder breadth")]) < 0.04


def test_without_pictures_girths_stay_as_uncertain_as_they_were():
    fit, girths = fitted(300.0, blind=True), slice(len(LENGTHS), None)
    np.testing.assert_allclose(fit.after[girths], fit.before[girths], rtol=1e-3)
    np.testing.assert_allclose(fit.logarithms[girths], 0, atol=1e-3)


def test_evidence_that_weighs_less_leaves_more_open():
    little, much = fitted(1.0), fitted(300.0)
    lengths = slice(len(LENGTHS))
    assert (much.after[lengths] < 0.99 * little.after[lengths]).all()
    assert (little.after < 1.001 * little.before).all()
    row = NAMES.index("forearm")
    assert abs(little.logarithms[row]) < 0.7 * abs(much.logarithms[row])


def some_fit() -> LengthsFit:
    among = covariance_among_people(ALL)
    share = np.ones(ALL)
    share[0], share[3] = 0.4, 0.6
    logarithms = np.zeros(ALL)
    logarithms[0], logarithms[3], logarithms[-1] = 0.05, -0.03, 0.1
    after = share[:, None] * among * share
    nowhere = Trajectory(truth(COUNT), logarithms, UNTURNED)
    return LengthsFit(logarithms, after, among, nowhere, Status.CONVERGED)


def test_a_report_says_of_each_length_whether_it_is_determined(tmp_path):
    fit, stated = some_fit(), Skeleton.human(1.8)
    person = scale_skeleton(stated, jnp.asarray(fit.logarithms, jnp.float32))
    report = LengthsReport.of(stated, person, 1.8, fit, tmp_path / "subject.toml")
    verdicts = {length.name: length.verdict for length in report.lengths}
    assert verdicts.pop("trunk length") == DETERMINED
    assert verdicts.pop("upper arm") == PARTLY_DETERMINED
    assert set(verdicts.values()) == {NOT_DETERMINED}
    figures = json.loads(json.dumps(report.figures()))
    arm = figures["lengths"]["upper arm"]
    assert arm["bones"] == ["humerus_l"]
    assert arm["length_m"] / arm["stated_m"] == pytest.approx(np.exp(-0.03), rel=1e-4)
    assert figures["girth_factors"]["leg's girth"] == pytest.approx(np.exp(0.1))
    write_subject(report.path, person, 1.8, report.lines())
    text = report.path.read_text()
    assert "# upper arm        0.2550 m (-3.0%)  ± 4.4%, before ± 7.3%  partly determined" in text
    assert tomllib.loads(text)["height"] == 1.8
    back = read_subject(report.path, "", {"file": report.path.name})
    np.testing.assert_allclose(back.lengths, person.lengths, atol=2e-6)
    np.testing.assert_allclose(back.diameters, person.diameters, atol=2e-5)


PLACES = {
    "Head": {"bone": "head"},
    "Left": {"bone": "radius_l", "at": 1.0},
    "Right": {"bone": "hand_r"},
}
VIDEO = [{"file": "cam.mp4", "camera": "cam"}]


def standing_still(folder: Path, seconds: float, places=PLACES) -> Path:
    """Markers of somebody who hardly moves, and no video."""
    times = np.arange(int(30 * seconds)) / 30
    at = {"Head": (0.0, 0.0, 1.7), "Left": (0.2, 0.3, 1.0), "Right": (0.2, -0.3, 1.0)}
    points = {name: np.tile(place, (len(times), 1)) for name, place in at.items()}
    write_trc(folder / "markers.trc", times, points)
    return write_recording(folder, "markers.trc", places, subject={"height": 1.8})


def test_what_cannot_tell_lengths_is_refused_in_one_sentence(tmp_path, refusal, monkeypatch):
    out = ("--out", str(tmp_path / "subject.toml"))
    path = standing_still(tmp_path, 3.0)
    given = ("--recording", str(path), *out)
    assert "film the movement as well" in refusal("scale", *given)
    assert "metres between" in refusal("scale", *given, "--height", "9")
    from jaxmocap.pipelines.scaling import fit_lengths

    def filmed(path):
        """The same with a video that nobody has opened yet."""
        return replace(lengths_loaded(path), videos=("cam",))

    lengths_loaded = fit_lengths.load_recording
    monkeypatch.setattr(fit_lengths, "load_recording", filmed)
    assert "too little to determine lengths" in refusal("scale", *given)
    standing_still(tmp_path, 0.5)
    assert "s of markers are too few" in refusal("scale", *given)
    standing_still(tmp_path, 3.0, {name: PLACES[name] for name in ("Head", "Left")})
    assert "at the head and at both hands" in refusal("scale", *given)
    assert not Path(out[1]).exists()
