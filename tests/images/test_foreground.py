"""Foreground: a learned background, the body's colours, and their odds on a static grid."""

from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxmocap.geometry.cameras import Camera, on_host, project
from jaxmocap.images import foreground
from jaxmocap.images.background_model import (
    LEAST_NOISE,
    Background,
    RunningBackground,
    equally_exposed,
    exposure,
    learn_background,
    most_alike,
    nth_smallest,
    undo_gains,
)
from jaxmocap.images.colours import BINS, Colours, RunningColours, colour_bins, learn_colours
from jaxmocap.images.foreground import (
    MOST_ODDS,
    box_about,
    learn_foreground,
    log_odds,
    person_grids,
    shrink,
    shrunk_size,
    weigh_odds,
)
from jaxmocap.images.regions import crop
from jaxmocap.synthetic.drawing_camera import image_size, look_at
from jaxmocap.synthetic.movements.motions import table_tennis
from jaxmocap.synthetic.people.clothed_person import clothed_actor
from jaxmocap.synthetic.renderer import Scene, render_frames

HEIGHT, WIDTH, FRAMES = 72, 96, 24
SHIRT = np.array([40, 60, 190])
Clip = tuple[np.ndarray, np.ndarray, np.ndarray]


def wall(seed: int = 0) -> np.ndarray:
    """A room (h, w, 3) float: soft patches of grey-green and beige."""
    rng = np.random.default_rng(seed)
    patches = cv2.resize(rng.uniform(0, 1, (6, 8)), (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    mix = np.clip(patches, 0, 1)[..., None]
    return mix * [110, 140, 100] + (1 - mix) * [150, 180, 200]


def block(left: float, width: int = 16, grow: int = 0) -> np.ndarray:
    """Where somebody's rectangular body stands (h, w) bool; ``grow`` pixels more on every side."""
    mask = np.zeros((HEIGHT, WIDTH), bool)
    x = round(left)
    mask[12 - grow : 60 + grow, max(0, x - grow) : x + width + grow] = True
    return mask


def clip(lefts, gains=None, noise: float = 1.5, seed: int = 0) -> Clip:
    """Frames of a body at those places, what it covers, and its reach when the pose errs a bit."""
    rng, room = np.random.default_rng(seed), wall(seed)
    gains = np.ones(len(lefts)) if gains is None else gains
    shown = np.stack([block(left) for left in lefts])
    frames = np.where(shown[..., None], SHIRT + rng.normal(0, 12, (HEIGHT, WIDTH, 3)), room)
    frames = frames * np.reshape(gains, (-1, 1, 1, 1)) + rng.normal(0, noise, frames.shape)
    reach = np.stack([block(left, grow=4) for left in lefts])
    return np.clip(np.rint(frames), 0, 255).astype(np.uint8), shown, reach


def core(shown: np.ndarray) -> np.ndarray:
    """The inner part of bodies (N, h, w) bool."""
    kernel = np.ones((7, 7), np.uint8)
    return np.stack([cv2.erode(mask.astype(np.uint8), kernel) > 0 for mask in shown])


def walking() -> np.ndarray:
    return np.linspace(4, 74, FRAMES)


def standing() -> np.ndarray:
    return np.full(FRAMES, 40.0) + np.sin(np.arange(FRAMES))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 40))
def test_the_value_of_a_rank_is_that_of_sorting(seed, count):
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 256, (count, 3, 5, 3), dtype=np.uint8)
    rank = rng.integers(0, count, (3, 5, 1))
    expected = np.take_along_axis(np.sort(values, 0), rank[None], 0)[0]
    np.testing.assert_array_equal(nth_smallest(values, rank), expected)


def test_the_background_is_the_masked_median_with_its_noise():
    frames, _, reach = clip(walking(), noise=5.0)
    learned = learn_background(frames, reach)
    masked = np.ma.masked_array(frames, np.broadcast_to(reach[..., None], frames.shape))
    # Of an even number of sightings the lower of the middle two, and exposure may move it by one.
    assert np.abs(learned.colour - np.ma.median(masked, 0)).max() < 9
    assert np.abs(learned.colour - wall()).mean() < 2
    assert abs(np.median(learned.noise) - 5.0) < 0.7
    assert (learned.certainty == 1).all()


def test_a_static_torso_is_unknown_and_never_background():
    frames, shown, reach = clip(standing())
    cores = core(shown)
    background, colours = learn_foreground(frames, cores, reach)
    always = np.logical_and.reduce(shown)
    assert background.certainty[always].max() == 0
    silent = np.stack([log_odds(frame, background, colours, alone=0) for frame in frames])
    inner = core(np.stack([always]))[0]
    np.testing.assert_allclose(silent[:, inner], 0, atol=1e-6)
    assert log_odds(frames[0], background, colours)[inner].min() > 0


def test_someone_who_leaves_leaves_no_ghost():
    lefts = np.where(np.arange(FRAMES) < 14, 20.0, 62.0)
    frames, shown, reach = clip(lefts)
    odds = learned_odds(frames, shown, reach)
    left_place, new_place = core(shown[:1])[0], core(shown[-1:])[0]
    assert odds[-1][left_place].max() < -2
    assert odds[0][left_place].min() > 2
    assert odds[-1][new_place].min() > 2
    assert odds[0][new_place].max() < -2


def learned_odds(frames: np.ndarray, shown: np.ndarray, reach: np.ndarray) -> np.ndarray:
    background, colours = learn_foreground(frames, core(shown), reach)
    return np.stack([log_odds(frame, background, colours) for frame in frames])


def shares(odds: np.ndarray, shown: np.ndarray) -> tuple[float, float]:
    """Of the body the share with positive odds, of the rest that with negative ones; no borders."""
    rest = core(np.logical_not(shown))
    return float((odds[core(shown)] > 0).mean()), float((odds[rest] < 0).mean())


def test_a_camera_that_brightens_and_darkens_is_followed():
    gains = 1 + 0.25 * np.sin(np.arange(FRAMES))
    frames, shown, reach = clip(walking(), gains)
    body, rest = shares(learned_odds(frames, shown, reach), shown)
    assert body > 0.98
    assert rest > 0.99


def test_gain_is_read_past_somebody_in_the_way():
    frames, _, reach = clip(walking())
    background = learn_background(frames, reach)
    brighter = np.clip(frames[5] * np.array([1.2, 1.1, 0.9]), 0, 255).astype(np.uint8)
    free = np.logical_not(reach[5])
    gains, agreement = exposure(brighter, background, free)
    restored = undo_gains(brighter, gains)
    assert agreement == 1
    assert np.abs(restored[free] - background.colour[free]).mean() < 2
    assert np.abs(brighter[free] - background.colour[free]).mean() > 10


def test_a_frame_that_is_covered_beside_the_person_says_nothing():
    frames, shown, reach = clip(np.full(FRAMES, 4.0) + np.arange(FRAMES) / 2)
    background, colours = learn_foreground(frames, core(shown), reach)
    window = box_about(reach[0])
    whole = log_odds(frames[0], background, colours, window=window)
    assert np.abs(whole).max() > 2
    covered = frames[0].copy()
    covered[:, WIDTH // 2 :] = 90
    np.testing.assert_array_equal(log_odds(covered, background, colours, window=window), 0)


def pushed() -> Clip:
    """Of the last 9 of 24 frames the camera shows the room 12 pixels further."""
    frames, shown, reach = clip(walking())
    rough = np.random.default_rng(4).normal(0, 25, (HEIGHT, WIDTH, 1))
    frames = np.clip(np.where(shown[..., None], frames, frames + rough), 0, 255).astype(np.uint8)
    frames[-9:], reach = np.roll(frames[-9:], 12, 2), reach | np.roll(reach, 12, 2)
    return frames, shown, reach


def test_a_background_is_of_the_frames_before_a_camera_was_pushed_or_after():
    frames, shown, reach = pushed()
    np.testing.assert_array_equal(most_alike(frames, ~reach), np.arange(15))
    together = learn_background(frames, reach)
    alone = learn_background(frames[:15], reach[:15])
    np.testing.assert_array_equal(together.colour, alone.colour)
    background, colours = learn_foreground(frames, core(shown), reach)
    odds = [log_odds(frame, background, colours, window=box_about(reach[0])) for frame in frames]
    assert [bool(own.any()) for own in odds] == [True] * 15 + [False] * 9


@pytest.mark.parametrize("colour", [(64, 177, 10), (250, 250, 250), (15, 15, 15), (90, 110, 100)])
def test_a_room_of_one_colour_shows_the_person(colour):
    """A green screen has a dark channel, a white wall is burnt out."""
    frames, shown, reach = clip(walking())
    noise = np.random.default_rng(3).normal(0, 1.5, frames.shape)
    frames = np.where(shown[..., None], frames, np.clip(np.rint(colour + noise), 0, 255))
    odds = learned_odds(frames.astype(np.uint8), shown, reach)
    body, rest = shares(odds, shown)
    assert body > 0.95 and rest > 0.95


@pytest.mark.parametrize("noise", [1.0, 6.0, 12.0])
def test_frames_of_a_noisy_camera_are_alike(noise):
    frames, _, reach = clip(walking(), 1 + 0.2 * np.sin(np.arange(FRAMES)), noise)
    even = equally_exposed(frames, ~reach)
    assert len(most_alike(even, ~reach)) == FRAMES
    running = learned(frames, reach)
    assert np.abs(running.background().colour - wall()).mean() < 8


@pytest.mark.parametrize("what", ["black", "white", "another room"])
def test_a_frame_that_does_not_show_the_room_says_nothing(what):
    frames, shown, reach = clip(walking())
    background, colours = learn_foreground(frames, core(shown), reach)
    noise = np.random.default_rng(1).integers(0, 255, frames[0].shape, dtype=np.uint8)
    strange = {"black": noise // 80, "white": 255 - noise // 80, "another room": noise}[what]
    np.testing.assert_array_equal(log_odds(strange, background, colours), 0)


def test_a_shadow_on_the_floor_is_not_the_person():
    frames, shown, reach = clip(walking())
    background, colours = learn_foreground(frames, core(shown), reach)
    dim = np.zeros((HEIGHT, WIDTH), bool)
    dim[50:70, 60:90] = True
    shaded = np.where(dim[..., None], 0.75 * frames[0], frames[0]).astype(np.uint8)
    assert (log_odds(shaded, background, colours)[dim & ~reach[0]] > 0).mean() < 0.01


def test_a_passer_by_changes_nothing_around_the_person():
    frames, shown, reach = clip(np.linspace(4, 40, FRAMES))
    calm = learned_odds(frames, shown, reach)
    busy = frames.copy()
    for i, frame in enumerate(busy):
        frame[20:70, 70 + i % 7 : 90] = 30 + 9 * (i % 12)
    here = np.zeros((HEIGHT, WIDTH), bool)
    here[:, :60] = True
    assert np.abs(learned_odds(busy, shown, reach) - calm)[:, here].mean() < 0.1


def test_colours_are_densities_that_tell_shirt_from_wall():
    frames, shown, reach = clip(walking())
    colours = learn_colours(frames, core(shown), reach)
    for density in (colours.body, colours.rest):
        assert density.dtype == np.float32
        assert (density > 0).all()
        assert abs(float(density.sum()) * 16**3 - 1) < 1e-4
    ratio = np.log(colours.body / colours.rest)
    assert ratio[colour_bins(SHIRT.astype(np.uint8))] > 3
    assert np.median(ratio[colour_bins(frames[0][~reach[0]])]) < -3


def test_without_any_pixel_every_colour_is_alike():
    assert np.ptp(RunningColours().colours().body) == 0
    frame, plane = np.zeros((HEIGHT, WIDTH, 3), np.uint8), np.zeros((HEIGHT, WIDTH), np.float32)
    nothing = Background(frame.astype(np.float32), plane + np.float32(LEAST_NOISE), plane)
    even = Colours(*(np.full(BINS, 256.0**-3, np.float32),) * 2)
    np.testing.assert_array_equal(log_odds(frame, nothing, even), 0)


def test_the_running_background_uses_earlier_frames_only():
    frames, _, reach = clip(walking(), noise=6.0)
    running = RunningBackground()
    for i in range(5):
        running.update(frames[i], reach[i])
    then = running.background()
    kept = Background(then.colour.copy(), then.noise.copy(), then.certainty.copy())
    for i in range(5, FRAMES):
        running.update(frames[i], reach[i])
    now = running.background()
    for name in ("colour", "noise", "certainty"):
        np.testing.assert_array_equal(getattr(then, name), getattr(kept, name))
        assert (getattr(now, name) != getattr(then, name)).any()
    assert np.abs(now.colour - wall()).mean() < 3


def learned(frames, reach, **options) -> RunningBackground:
    """What is learned of a clip, frame by frame."""
    running = RunningBackground(**options)
    for frame, body in zip(frames, reach, strict=True):
        running.update(frame, body)
    return running


def test_what_stands_unmasked_in_a_single_frame_hardly_moves_the_running_background():
    frames, _, reach = clip(walking())
    running = learned(frames, reach)
    before = running.background().colour
    visited = frames[-1].copy()
    visited[20:50, 10:40] = 255
    running.update(visited, reach[-1])
    assert np.abs(running.background().colour - before).max() < 1.5


def test_the_running_background_grows_sure_with_unmasked_sightings():
    frames, shown, reach = clip(standing())
    running, last = RunningBackground(), np.zeros((HEIGHT, WIDTH), np.float32)
    for frame, body in zip(frames, reach, strict=True):
        running.update(frame, body)
        certainty = running.background().certainty
        assert (certainty >= last - 1e-6).all()
        last = certainty
    assert last[shown.all(0)].max() == 0
    assert last[~reach.any(0)].min() == 1


def test_a_running_background_tells_the_person_like_a_learned_one():
    frames, shown, reach = clip(np.tile(walking(), 2), 1 + 0.2 * np.sin(np.arange(2 * FRAMES)))
    running, counted, odds = RunningBackground(), RunningColours(), []
    for frame, inner, body in zip(frames, core(shown), reach, strict=True):
        running.update(frame, body)
        counted.update(colour_bins(frame), inner, body)
        odds.append(log_odds(frame, running.background(), counted.colours()))
    body, rest = shares(np.stack(odds[FRAMES:]), shown[FRAMES:])
    assert body > 0.98
    assert rest > 0.99


def test_a_running_background_outlives_a_blackout_and_starts_again_after_a_move():
    frames, _, reach = clip(walking())
    running = learned(frames, reach, patience=8)
    before = running.background().colour
    for _ in range(7):
        running.update(np.zeros_like(frames[0]))
    np.testing.assert_array_equal(running.background().colour, before)
    moved = clip(walking(), seed=3)[0][0, ::-1, ::-1]
    for _ in range(12):
        running.update(moved)
    assert np.abs(running.background().colour - moved).mean() < 2


def test_a_background_is_asked_for_after_the_first_frame():
    with pytest.raises(ValueError, match="no frame yet"):
        RunningBackground().background()


def person_grid(odds: np.ndarray, *place, **options) -> tuple[np.ndarray, np.ndarray]:
    layers = weigh_odds(odds)
    return person_grids((layers, layers), *place, **options)[0]


DISCS = st.tuples(st.floats(60, 100), st.floats(50, 80), st.floats(12, 25), st.floats(1.7, 6.4))


@settings(max_examples=25, deadline=None)
@given(DISCS, st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_a_disc_lies_on_the_grid_where_it_lies_in_the_image(disc, dx, dy):
    x, y, radius, cell = disc
    rows, columns = np.mgrid[:160, :200]
    distance = np.hypot(columns - x, rows - y)
    odds = MOST_ODDS * np.clip(radius - distance, -1, 1).astype(np.float32)
    size = 64
    origin = np.array([x + dx * cell, y + dy * cell]) - cell * size / 2
    probability, weight = person_grid(odds, origin, cell, size, blur=0.0)
    assert probability.dtype == weight.dtype == np.float32
    # Where there is nobody the probability is a little above 0, which would weigh in the mean.
    there = np.maximum(np.where(weight > 0, probability, 0) - 0.05, 0)
    i, j = np.mgrid[:size, :size]
    middle = np.array([(there * j).sum(), (there * i).sum()]) / there.sum()
    expected = (np.array([x, y]) - origin) / cell - 0.5
    np.testing.assert_allclose(middle, expected, atol=0.05)


def test_cells_far_larger_than_the_image_take_no_more_memory():
    for cell in (1e3, 2e5, 1e9):
        origin = np.array([-24.0, -24.0]) * cell
        odds = np.full((160, 200), 2.0, np.float32)
        probability, weight = person_grid(odds, origin, cell, 48)
        assert probability.shape == (48, 48) and np.isfinite(probability).all()
        assert np.isfinite(weight).all() and (weight > 0).sum() <= 4


def test_the_grid_lies_where_a_region_of_the_same_origin_lies():
    rng = np.random.default_rng(0)
    image = cv2.GaussianBlur(rng.normal(0, 40, (90, 120)).astype(np.float32), (0, 0), 5)
    odds = np.clip(image, -MOST_ODDS, MOST_ODDS)
    origin = np.array([19.5, 9.5])
    region = crop(1 / (1 + np.exp(-odds)), origin, 3.0, 20)
    probability, _ = person_grid(np.where(odds < 0, -4, 4).astype(np.float32), origin, 3.0, 20, 0.0)
    assert np.corrcoef(region.ravel(), probability.ravel())[0, 1] > 0.9
    shifted, _ = person_grid(odds, origin + np.array([3, 0]), 3.0, 20, 0.0)
    straight, _ = person_grid(odds, origin, 3.0, 20, 0.0)
    np.testing.assert_allclose(shifted[:, :-1], straight[:, 1:], atol=1e-5)


def test_the_grid_weighs_nothing_outside_the_image_and_where_nothing_was_learned():
    odds = np.full((40, 60), -4, np.float32)
    odds[:, 30:] = 0
    probability, weight = person_grid(odds, np.array([-20.5, -0.5]), 2.0, 40)
    assert weight[:, :10].max() == 0
    assert weight[20:].max() == 0
    assert weight[:20, 10:22].min() > 0.95
    assert weight[:, 28:].max() < 1e-3
    assert probability[:20, 10:22].max() < 0.05
    np.testing.assert_allclose(probability[:20, 32:], 0.5, atol=0.01)


def shrunk_pixels(pixels_xy: np.ndarray, size: tuple[int, int], rows: int) -> np.ndarray:
    """Where pixels (..., 2) of an image of width and height ``size`` lie once it is shrunk."""
    ratio = np.divide(shrunk_size(size, rows), size)
    return (np.asarray(pixels_xy) + 0.5) * ratio - 0.5


@given(st.integers(2, 400), st.integers(2, 300), st.integers(1, 400))
def test_shrinking_maps_edges_onto_edges(width, height, rows):
    small = shrunk_size((width, height), rows)
    image = np.zeros((height, width, 3), np.uint8)
    assert shrink(image, rows).shape == (small[1], small[0], 3)
    corners = np.array([[-0.5, -0.5], [width - 0.5, height - 0.5]])
    expected = [[-0.5, -0.5], [small[0] - 0.5, small[1] - 0.5]]
    np.testing.assert_allclose(shrunk_pixels(corners, (width, height), rows), expected, atol=1e-9)


@settings(deadline=None)
@given(st.floats(60, 140), st.floats(50, 90), st.integers(40, 139))
def test_a_spot_shrinks_to_where_its_pixel_is_said_to_be(x, y, rows):
    i, j = np.mgrid[:140, :200]
    spot = np.exp(-((j - x) ** 2 + (i - y) ** 2) / 200).astype(np.float32)
    small = shrink(spot, rows)
    v, u = np.mgrid[: small.shape[0], : small.shape[1]]
    actual = np.array([(small * u).sum(), (small * v).sum()]) / small.sum()
    np.testing.assert_allclose(actual, shrunk_pixels(np.array([x, y]), (200, 140), rows), atol=0.02)


@pytest.fixture(scope="module")
def rendered() -> tuple[np.ndarray, np.ndarray, Camera]:
    """Frames of somebody playing table tennis, and the pixels that truly show the person."""
    camera = look_at((3.0, 0.75, 1.30), (0.1, 0.0, 1.12), size=(240, 180), focal=296.0)
    scene = Scene.in_room(camera, clothed_actor(table_tennis(4.0, 4), 4), 4)
    times = np.arange(24) / 6
    frames = np.stack(list(render_frames(scene, times)))
    return frames, np.stack(list(bodies(scene, times))), camera


def bodies(scene: Scene, times: np.ndarray) -> Iterator[np.ndarray]:
    """Every face of the mesh, filled, at the middles of the exposures."""
    lens = on_host(scene.camera)
    for vertices in scene.mover.vertices(times):
        corners = np.rint(project(lens, vertices)[scene.mover.mesh.faces] * 16).astype(np.int32)
        mask = np.zeros(image_size(lens)[::-1], np.uint8)
        for corner in corners:
            cv2.fillConvexPoly(mask, corner, 1, cv2.LINE_8, 4)
        yield mask > 0


def test_a_rendered_player_is_told_from_the_room(rendered):
    frames, shown, _ = rendered
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (9, 9))
    thin = np.stack([cv2.erode(mask.astype(np.uint8), disc) > 0 for mask in shown])
    reach = np.stack([cv2.dilate(mask.astype(np.uint8), disc) > 0 for mask in shown])
    background, colours = learn_foreground(frames, thin, reach)
    odds = np.stack([log_odds(frame, background, colours) for frame in frames])
    three = np.ones((3, 3), np.uint8)
    inside = np.stack([cv2.erode(mask.astype(np.uint8), three) > 0 for mask in shown])
    outside = np.stack([cv2.dilate(mask.astype(np.uint8), three) == 0 for mask in shown])
    visible = inside & (background.certainty > 0.5)
    assert (odds[outside] < 0).mean() > 0.97
    assert (odds[visible] > 0).mean() > 0.95
    assert (odds[inside] > 0).mean() > 0.8
    assert (odds[inside] < -0.5).mean() < 0.06


def test_odds_stay_within_their_bounds_and_noise_above_its_floor(rendered):
    frames, shown, _ = rendered
    background, colours = learn_foreground(frames, shown, shown)
    odds = log_odds(frames[0], background, colours)
    assert odds.dtype == np.float32
    assert np.abs(odds).max() <= foreground.MOST_ODDS + 1e-5
    assert background.noise.min() >= LEAST_NOISE
    assert background.certainty.min() >= 0
    assert background.certainty.max() <= 1
