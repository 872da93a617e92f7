"""Segmentation by level sets: steps, densities, canvases and contours where there is a truth."""

from itertools import pairwise

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.clips import displaced
from bench.segmentation import region_about_mask
from jaxmocap.capture.photographs import read_empty_room
from jaxmocap.images.background_model import Background, learn_background
from jaxmocap.images.canvases import (
    Canvas,
    canvas,
    full_mask,
    keep_attached,
    mask_canvas,
    silhouette_distance,
)
from jaxmocap.images.regions import Region
from jaxmocap.reference import level_set as reference
from jaxmocap.silhouette.segmentation import densities
from jaxmocap.silhouette.segmentation.background_models import background_of_picture
from jaxmocap.silhouette.segmentation.contour import contours
from jaxmocap.silhouette.segmentation.level_set import (
    LevelSetMotion,
    downsample,
    evolve,
    step,
    upsample,
)
from jaxmocap.silhouette.segmentation.segment import (
    CanvasImages,
    Histograms,
    LevelSetSettings,
    Segmentation,
    SegmentationPlan,
    segment,
)
from jaxmocap.silhouette.segmentation.sharpen import sharpen_silhouette
from jaxmocap.synthetic.four_cameras import cameras_around
from jaxmocap.synthetic.movements.exercises import exercise
from jaxmocap.synthetic.people.rigged_mesh import load_rig
from jaxmocap.synthetic.renderer import Sensor, render_frames

SIZE = 64
PLAN = SegmentationPlan(background=False)
Y, X = np.mgrid[:SIZE, :SIZE].astype(np.float32)


def disc(x=31.0, y=30.0, radius=15.0) -> np.ndarray:
    """Signed distance (1, SIZE, SIZE) to a circle, cells."""
    return (radius - np.hypot(X - x, Y - y))[None].astype(np.float32)


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    return (a & b).sum() / (a | b).sum()


def canvas_of(image: np.ndarray, room: np.ndarray | None = None) -> CanvasImages:
    """A picture (SIZE, SIZE, 3) uint8 as a canvas, before a learned room."""
    ones = np.ones((SIZE, SIZE), np.float32)
    behind = image if room is None else room
    return CanvasImages.of([Canvas(image, ones, behind, 4 * ones, ones * (room is not None))])


def painted(truth: np.ndarray, person, rest, noise=6.0) -> np.ndarray:
    """A picture of the truth (SIZE, SIZE) bool in two colours, with noise."""
    colour = np.where(truth[..., None], np.array(person, float), np.array(rest, float))
    noisy = colour + np.random.default_rng(0).normal(0, noise, colour.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


def segmented(
    canvas_of: CanvasImages, start: np.ndarray, plan: SegmentationPlan = PLAN
) -> Segmentation:
    before = Histograms.empty(len(start), plan)
    return segment(canvas_of, jnp.asarray(start), before, LevelSetSettings(), plan)


def found(image: np.ndarray, start: np.ndarray, *, room=None, plan=PLAN) -> np.ndarray:
    """(SIZE, SIZE) bool: whom the first level set ends about."""
    return np.asarray(segmented(canvas_of(image, room), start, plan).phi[0]) > 0


@given(seed=st.integers(0, 2**32 - 1), width=st.sampled_from([1.0, 1.5, 4.0]))
def test_a_step_is_the_references(seed, width):
    rng = np.random.default_rng(seed)
    phi = rng.uniform(-6, 6, (2, 12, 12)).astype(np.float32)
    ratio = rng.uniform(-3, 3, (2, 12, 12)).astype(np.float32)
    moved = step(jnp.asarray(phi), jnp.asarray(ratio), LevelSetMotion(0.7, 0.3, 0.35, 0.15), width)
    for view in range(2):
        expected = reference.step(phi[view].astype(float), ratio[view], 0.7, 0.3, 0.35, 0.15, width)
        np.testing.assert_allclose(moved[view], expected, atol=2e-4)


def test_steps_lower_the_energy_of_the_paper():
    ratio = np.where(disc(radius=20.0) > 0, 2.0, -2.0).astype(np.float32)
    phi, energies = jnp.asarray(disc(x=36.0, radius=11.0)), []
    for _ in range(5):
        energies.append(reference.energy(np.asarray(phi[0], float), ratio[0], 0.5, 1.5))
        phi = evolve(phi, jnp.asarray(ratio), LevelSetMotion(0.5), 1.5, 6)
    assert all(later < before - 1 for before, later in pairwise(energies))


def test_length_alone_rounds_a_corner_and_shrinks_a_disc():
    phi = jnp.asarray(disc(radius=10.0))
    shrunk = evolve(phi, jnp.zeros_like(phi), LevelSetMotion(1.0), 1.5, 30)
    # dr/dt = -ν / r by (4.20).
    area = float((shrunk > 0).sum())
    expected = np.pi * (100 - 2 * 0.33 * 30)
    assert abs(area - expected) < 0.08 * expected


def test_the_level_set_stays_near_a_distance():
    ratio = np.where(disc(radius=22.0) > 0, 3.0, -3.0).astype(np.float32)
    phi = evolve(jnp.clip(disc(radius=12.0), -8, 8), jnp.asarray(ratio), LevelSetMotion(), 1.5, 60)
    rows, columns = np.gradient(np.asarray(phi[0]))
    slope = np.hypot(rows, columns)[np.abs(phi[0]) < 2]
    assert slope.min() > 0.6 and slope.max() < 3
    assert abs(float((phi > 0).sum()) - np.pi * 22**2) < 60


def test_halving_and_doubling_keep_the_contour():
    phi = jnp.asarray(disc())
    again = upsample(downsample(phi) / 2)
    near = np.abs(disc()) < 4
    np.testing.assert_allclose(again[near], disc()[near], atol=0.1)


def test_a_histogram_is_a_smoothed_density():
    colour = np.zeros((1, 3, SIZE, SIZE), np.float32)
    colour[:] = 90.0
    colour[:, :, :, SIZE // 2 :] = 170.0
    bins, weights = densities.joint_bins(jnp.asarray(colour)), jnp.ones((1, SIZE, SIZE))
    counts = densities.histogram_counts(bins, weights, densities.LEVELS**3)
    assert float(counts.sum()) == pytest.approx(SIZE**2 / densities.COUNT_STRIDE**2, rel=1e-3)
    density = densities.colour_density(counts)
    assert float(density.sum()) * (256 / densities.LEVELS) ** 3 == pytest.approx(1, rel=1e-4)
    at = densities.lookup(density, bins)
    assert float(at[0, 0, 0]) == pytest.approx(float(at[0, 0, -1]), rel=0.2)
    even = densities.colour_density(jnp.zeros_like(counts))
    np.testing.assert_allclose(even, 256.0**-3, rtol=1e-5)


def test_a_shadow_on_the_room_is_still_the_room():
    room = jnp.full((1, 3, 2, 2), 150.0)
    noise, density = jnp.full((1, 2, 2), 4.0), jax.jit(densities.background_density)
    lit, shaded, person = (
        float(density(room * share, room, noise)[0, 0, 0])
        for share in (1.0, 0.75, jnp.array([1.0, 0.5, 0.3])[:, None, None])
    )
    assert lit > shaded > 1e3 * person


@pytest.mark.parametrize(
    "plan", [SegmentationPlan(colour=False, background=False), PLAN], ids=["grey", "colour"]
)
def test_a_disc_of_another_colour_is_found_from_a_start_that_is_off(plan):
    truth = disc()[0] > 0
    image = painted(truth, (60, 60, 160), (170, 150, 140))
    start = disc(x=36.0, y=26.0, radius=12.0)
    actual = found(image, start, plan=plan)
    assert overlap(start[0] > 0, truth) < 0.6
    assert overlap(actual, truth) > 0.97


def test_a_learned_room_finds_whom_colours_cannot():
    truth, rng = disc()[0] > 0, np.random.default_rng(1)
    # Both are speckled in the same colours: only the place of each speckle tells.
    room, person = rng.choice(np.array([[60, 60, 160], [170, 150, 140]]), (2, SIZE, SIZE))
    image = np.where(truth[..., None], person, room).astype(np.uint8)
    start = disc(x=35.0, y=27.0, radius=12.0)
    by_colour = found(image, start)
    by_room = found(image, start, room=room.astype(np.uint8), plan=SegmentationPlan())
    assert overlap(by_room, truth) > 0.7
    assert overlap(by_room, truth) > overlap(by_colour, truth) + 0.1


def test_a_limb_beside_the_predicted_one_does_not_change_places_with_the_floor():
    trunk, limb, predicted = disc(20, 20, 10), disc(46, 44, 7), disc(32, 50, 7)
    truth, start = np.maximum(trunk, limb)[0] > 0, np.maximum(trunk, predicted)
    room = np.random.default_rng(2).integers(60, 200, (SIZE, SIZE, 3)).astype(np.uint8)
    # All of the room lies in shadow; the limb's colour shows nowhere in the predicted silhouette.
    image = np.where(truth[..., None], np.array([60, 60, 230]), 0.7 * room)
    image[limb[0] > 0] = (230, 90, 40)
    actual = found(image.astype(np.uint8), start, room=room, plan=SegmentationPlan())
    assert overlap(start[0] > 0, truth) < 0.6
    assert overlap(actual, truth) > 0.9


def test_pieces_that_lie_nowhere_near_the_prediction_are_not_the_person():
    person, hand, stranger = disc(20, 20, 10)[0], disc(40, 20, 4)[0], disc(45, 50, 8)[0]
    actual = keep_attached(np.maximum(np.maximum(person, hand), stranger), disc(30, 20, 9)[0])
    np.testing.assert_array_equal(actual > 0, (person > 0) | (hand > 0))
    np.testing.assert_array_equal(keep_attached(person, -np.ones_like(person)), person)


def test_an_empty_room_is_read_from_a_picture_of_the_videos_size(tmp_path):
    picture = np.random.default_rng(0).integers(0, 256, (12, 16, 3), np.uint8)
    cv2.imwrite(str(tmp_path / "empty.png"), picture)
    actual = background_of_picture(read_empty_room(tmp_path / "empty.png", (16, 12)))
    np.testing.assert_array_equal(actual.colour, picture)
    assert actual.certainty.min() == 1 and actual.noise.min() > 1


def test_a_room_without_colours_is_refused():
    with pytest.raises(ValueError, match=r"expected plan\.colour = True"):
        segmented(
            canvas_of(np.zeros((SIZE, SIZE, 3), np.uint8)), disc(), SegmentationPlan(colour=False)
        )


def test_histograms_are_carried_to_the_next_frame():
    truth = disc()[0] > 0
    image = painted(truth, (60, 60, 160), (170, 150, 140))
    first = segmented(canvas_of(image), disc(x=33.0))
    kept = first.histograms
    assert float(kept.person.sum()) > 0.5 * truth.sum() / densities.COUNT_STRIDE**2
    again = segment(canvas_of(image), jnp.asarray(disc(x=33.0)), kept, LevelSetSettings(), PLAN)
    assert overlap(np.asarray(again.phi[0]) > 0, truth) > 0.97


def compiled() -> int:
    """How many programs of the segmentation there are."""
    return segment._cache_size()  # type: ignore[attr-defined]


def test_frames_of_any_kind_are_segmented_by_one_program():
    image = painted(disc()[0] > 0, (60, 60, 160), (170, 150, 140))
    before = compiled()
    for start, picture in (
        (disc(), image),
        (disc(x=5.0), np.zeros_like(image)),
        (np.full_like(disc(), -32.0), image),
        (np.full_like(disc(), 32.0), np.full_like(image, 255)),
    ):
        actual = segmented(canvas_of(picture), start)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(actual))
    assert compiled() <= before + 1


def test_a_contours_points_lie_on_a_circle_and_look_out():
    radii = (6.0, 20.0, 28.0)
    phi = np.concatenate([disc(31.3, 30.6, r) for r in radii])
    origin = np.array([[10.5, 20.5]] * 3, np.float32)
    region = Region(origin, np.full(3, 1.7, np.float32))
    actual = contours(phi, np.clip(phi, -3, 3), np.ones_like(phi), region, 128)
    middle = origin[0] + (np.array([31.3, 30.6]) + 0.5) * 1.7
    for view, radius in enumerate(radii):
        valid = np.asarray(actual.valid[view])
        away = np.asarray(actual.points_xy[view])[valid] - middle
        distance = np.hypot(*away.T)
        np.testing.assert_allclose(distance, 1.7 * radius, atol=0.08)
        outward = np.sum(away / distance[:, None] * np.asarray(actual.normals[view])[valid], -1)
        assert outward.min() > 0.99
        sectors = np.histogram(np.arctan2(away[:, 1], away[:, 0]), 8)[0]
        assert sectors.min() > 0.5 * sectors.mean()
    # Twice the change of Φ over four cells, of the largest change.
    assert np.asarray(actual.contrast)[1, :20].min() > 0.6


def test_a_border_of_the_image_is_no_contour_and_nothing_has_none():
    phi = np.concatenate([disc(x=2.0), np.full_like(disc(), -8.0)])
    inside = np.broadcast_to((X > 8).astype(np.float32), phi.shape)
    region = Region(np.zeros((2, 2), np.float32), np.ones(2, np.float32))
    actual = contours(phi, phi, inside, region, 128)
    assert not actual.valid[1].any() and np.isfinite(actual.points_xy).all()
    valid = np.asarray(actual.valid[0])
    assert valid.any() and np.asarray(actual.points_xy[0])[valid, 0].min() > 7


def test_a_canvas_follows_the_person_and_leads_back_to_the_image():
    mask = np.zeros((120, 160), bool)
    cv2.ellipse(canvas_mask := mask.astype(np.uint8), (90, 60), (20, 45), 20, 0, 360, 1, -1)
    mask = canvas_mask > 0
    region = region_about_mask(mask, SIZE)
    phi = silhouette_distance(mask_canvas(mask, region, SIZE) > 0.5)
    assert overlap(full_mask(phi, region, mask.shape), mask) > 0.95
    image = np.dstack([np.full(mask.shape, 40), 255 * mask, np.indices(mask.shape)[1]])
    room = Background(image.astype(np.float32), np.ones(mask.shape, np.float32), 1.0 * mask)
    taken = canvas(image.astype(np.uint8), region, SIZE, room)
    assert taken.colour.shape == (SIZE, SIZE, 3)
    assert CanvasImages.of([taken, taken]).colour.shape == (2, 3, SIZE, SIZE)
    columns = region.origin[0] + (np.arange(SIZE) + 0.5) * region.scale
    within = (columns > 1) & (columns < 158)
    np.testing.assert_allclose(taken.colour[30, within, 2], columns[within], atol=0.6)
    assert taken.inside[30, within].min() == 1
    assert ((taken.colour[..., 1] > 128) == (phi > 0)).mean() > 0.99


def test_a_canvas_of_nobody_is_the_whole_image_and_beyond_it_nothing_is_inside():
    nobody = np.zeros((60, 100), bool)
    region = region_about_mask(nobody, SIZE)
    taken = canvas(np.zeros((60, 100, 3), np.uint8), region, SIZE)
    covered = taken.inside.sum() * float(region.scale) ** 2
    assert covered == pytest.approx(60 * 100, rel=1e-3)
    assert (silhouette_distance(mask_canvas(nobody, region, SIZE)) < 0).all()


def test_a_rendered_person_before_clutter_is_found_from_a_pose_that_is_off(recordings):
    person = exercise(load_rig(recordings / "person" / "person.npz"), "jumping", 1.0)
    off, time = displaced(person, np.random.default_rng(3)), 0.9
    frames, starts, rooms, truths = [], [], [], []
    for view in cameras_around(person, 1.0)[:1]:
        scene = view.scene(person, 0)
        frames += list(render_frames(scene, np.array([time])))
        sensor = Sensor.create((640, 480), np.random.default_rng(9))
        rooms.append(learn_background(np.stack([sensor.expose(scene.background)] * 3)))
        starts.append(view.mask(off, time))
        truths.append(view.mask(person, time))
    regions = [region_about_mask(start, 192) for start in starts]
    canvases = [canvas(f, r, 192, b) for f, r, b in zip(frames, regions, rooms, strict=True)]
    phi = np.stack(
        [
            silhouette_distance(mask_canvas(mask, region, 192) > 0.5)
            for mask, region in zip(starts, regions, strict=True)
        ]
    )
    actual = segmented(CanvasImages.of(canvases), phi, SegmentationPlan())
    whole = Region(np.array([-0.5, -0.5], np.float32), np.array(1, np.float32))
    for view, truth in enumerate(truths):
        region, level_set = regions[view], np.asarray(actual.phi[view])
        cells = overlap(full_mask(level_set, region, truth.shape), truth)
        patch = sharpen_silhouette(frames[view], level_set, region, rooms[view])
        sharp = patch.phi(whole, 640)[:480] > 0
        assert overlap(starts[view], truth) < 0.85 and cells > 0.88
        assert overlap(sharp, truth) > max(0.94, cells + 0.01)
