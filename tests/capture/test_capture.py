"""Streams over time: markers between samples, frames of whole and broken videos, their order."""

import struct
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from conftest import complaint, read_calibration
from hypothesis import given
from hypothesis import strategies as st

from jaxmocap.capture import video as video_module
from jaxmocap.capture.markers import interpolate_markers
from jaxmocap.capture.timeline import SIMULTANEOUS_S, build_timeline, check_overlap
from jaxmocap.capture.video import MemoryVideo, Video, check_size, open_video
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.recording import VideoSource
from jaxmocap.geometry.cameras import Camera

CODECS = {".mp4": "mpeg4", ".avi": "mjpeg"}


def picture(i: int) -> np.ndarray:
    """A (48, 64, 3) image that tells its number by its brightness, brighter in one corner."""
    image = np.full((48, 64, 3), 20 + 8 * i, np.uint8)
    image[:16, :16] = 255
    return image


def write_video(
    path: Path, stamps=range(20), gop: int = 5, options=None, rotation: int = 0
) -> Path:
    """One picture per stamp, in hundredths of a second."""
    with av.open(str(path), "w", options=options or {}) as container:
        stream = container.add_stream(CODECS.get(path.suffix, "mpeg4"), rate=100)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        if path.suffix == ".avi":
            stream.pix_fmt = "yuvj420p"
        stream.codec_context.time_base = stream.time_base = Fraction(1, 100)
        stream.codec_context.gop_size, stream.codec_context.bit_rate = gop, 4_000_000
        if rotation:
            stream.set_display_rotation(rotation)
        for i, stamp in enumerate(stamps):
            frame = av.VideoFrame.from_ndarray(picture(i), format="bgr24")
            frame.pts, frame.time_base = stamp, Fraction(1, 100)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def numbers(video) -> list[int | None]:
    """Which picture each frame is, by its brightness."""
    levels = [None if image is None else float(image[24:, 32:].mean()) for _, image in video]
    return [None if level is None else round((level - 20) / 8) for level in levels]


# Markers -----------------------------------------------------------------------------------------

ascending = st.lists(st.integers(1, 40), min_size=2, max_size=30).map(lambda s: np.cumsum(s) / 1000)


@given(ascending, st.data())
def test_interpolation_is_exact_for_a_straight_motion(times, data):
    at = np.array(data.draw(st.lists(st.floats(float(times[0]), float(times[-1])), max_size=10)))
    velocity = np.array([1.0, -2.0, 3.0])
    positions = times[:, None, None] * velocity + np.ones((1, 2, 1))
    actual = interpolate_markers(times, positions, at)
    gap = np.diff(times)[np.clip(np.searchsorted(times, at, "right") - 1, 0, len(times) - 2)]
    is_valid = (gap <= 3 * np.median(np.diff(times))) | np.isin(at, times)
    expected = np.where(is_valid[:, None, None], at[:, None, None] * velocity + 1, np.nan)
    np.testing.assert_allclose(actual, np.broadcast_to(expected, actual.shape), atol=1e-9)


@given(ascending, st.booleans(), st.integers(0, 99))
def test_at_a_samples_own_time_it_is_that_sample_gaps_or_not(times, causal, seed):
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(len(times), 3, 3))
    positions[rng.random(positions.shape[:2]) < 0.4] = np.nan
    order = rng.permutation(len(times))
    actual = interpolate_markers(times, positions, times[order], causal)
    np.testing.assert_array_equal(actual, positions[order])


@given(ascending, st.integers(0, 99))
def test_causal_interpolation_uses_no_later_sample(times, seed):
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(len(times), 1, 3))
    at = rng.uniform(times[0] - 0.01, times[-1] + 0.05, 10)
    actual = interpolate_markers(times, positions, at, causal=True)
    for t, here in zip(at, actual, strict=True):
        is_earlier = times <= t
        altered = np.where(is_earlier[:, None, None], positions, 1e6)
        np.testing.assert_array_equal(
            interpolate_markers(times, altered, np.array([t]), True)[0], here
        )


def test_a_missing_neighbour_leaves_the_marker_unknown_and_no_other():
    times = np.array([0.0, 0.1, 0.2, 0.3])
    positions = np.zeros((4, 2, 3))
    positions[1, 0] = np.nan
    actual = interpolate_markers(times, positions, np.array([0.05, 0.15, 0.25]))
    assert np.isnan(actual[:, 0]).all(-1).tolist() == [True, True, False]
    assert (actual[:, 1] == 0).all()


def test_gaps_and_the_outside_are_unknown():
    times = np.array([0.0, 0.1, 0.2, 0.6, 0.7, 0.8])
    positions = np.ones((6, 1, 3)) * times[:, None, None]
    at = np.array([-0.06, -0.04, 0.4, 0.84, 0.86])
    actual = interpolate_markers(times, positions, at)[:, 0, 0]
    np.testing.assert_allclose(actual, [np.nan, -0.04, np.nan, 0.84, np.nan], atol=1e-12)
    causal = interpolate_markers(times, positions, np.array([0.05, 0.25, 0.31, 0.65, 0.89]), True)[
        :, 0, 0
    ]
    np.testing.assert_allclose(causal, [np.nan, 0.25, np.nan, np.nan, 0.89], atol=1e-12)


@pytest.mark.parametrize("causal", [False, True])
def test_a_leap_is_no_motion_to_be_followed(causal):
    times = np.arange(6) / 60
    positions = np.zeros((6, 2, 3))
    positions[3:, 0] += [1.5, 0.0, 0.0]
    at = np.array([3.3, 4.3]) / 60 if causal else np.array([2.3, 3.3]) / 60
    actual = interpolate_markers(times, positions, at, causal)
    assert np.isnan(actual[0, 0]).all() and np.isfinite(actual[0, 1]).all()
    np.testing.assert_allclose(actual[1, 0], [1.5, 0.0, 0.0])


def test_a_single_sample_is_valid_at_its_time_only():
    actual = interpolate_markers(np.array([1.0]), np.ones((1, 1, 3)), np.array([0.9, 1.0, 1.1]))
    assert np.isfinite(actual).all((1, 2)).tolist() == [False, True, False]


# Events ------------------------------------------------------------------------------------------


@st.composite
def streams(draw):
    """Marker times and the frame times of up to three cameras, with jitter, loss and any phase."""
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))

    def stream(rate: float, jitter: float) -> np.ndarray:
        times = np.arange(draw(st.integers(1, 30))) / rate
        times = times + rng.uniform(-0.5, 0.5) + rng.uniform(0, jitter / rate, len(times))
        return np.unique(times[rng.random(len(times)) < 0.9])

    markers = stream(draw(st.sampled_from([60.0, 90.0])), draw(st.sampled_from([0.0, 0.3])))
    rates = draw(st.lists(st.sampled_from([30.0, 60.0, 1500.0]), max_size=3))
    videos = [stream(rate, draw(st.sampled_from([0.0, 0.3, 0.9]))) for rate in rates]
    return (markers if len(markers) else np.zeros(1)), videos


@given(streams(), st.sampled_from(["own", "causal"]))
def test_every_sample_and_every_frame_appears_exactly_once_in_order_of_time(recorded, mode):
    markers, videos = recorded
    timeline = build_timeline(markers, videos, mode)
    samples, frames = timeline.sample_index, timeline.frame_index
    assert (np.diff(timeline.event_times) >= 0).all()
    assert samples[samples >= 0].tolist() == list(range(len(markers)))
    assert frames.shape == (len(samples), len(videos))
    np.testing.assert_array_equal(timeline.event_times[samples >= 0], markers)
    assert ((samples >= 0) | (frames >= 0).any(1)).all()
    for camera, times in enumerate(videos):
        has_frame = frames[:, camera] >= 0
        assert frames[has_frame, camera].tolist() == list(range(len(times)))


@given(streams(), st.sampled_from(["own", "causal"]))
def test_a_frame_is_at_most_half_an_interval_from_its_event(recorded, mode):
    markers, videos = recorded
    timeline = build_timeline(markers, videos, mode)
    intervals = [np.median(np.diff(times)) for times in videos if len(times) > 1]
    reach = max(min(intervals, default=0) / 2, SIMULTANEOUS_S) + SIMULTANEOUS_S + 1e-9
    for camera, times in enumerate(videos):
        has_frame = timeline.frame_index[:, camera] >= 0
        late = times[timeline.frame_index[has_frame, camera]] - timeline.event_times[has_frame]
        assert (np.abs(late) <= reach).all()
        if mode == "causal":
            assert (late <= SIMULTANEOUS_S + 1e-9).all()


@given(streams())
def test_the_papers_way_gives_each_sample_the_frame_nearest_in_time(recorded):
    markers, videos = recorded
    timeline = build_timeline(markers, videos, "nearest")
    np.testing.assert_array_equal(timeline.event_times, markers)
    np.testing.assert_array_equal(timeline.sample_index, np.arange(len(markers)))
    for camera, times in enumerate(videos):
        interval = np.median(np.diff(times)) if len(times) > 1 else 0
        for t, frame in zip(markers, timeline.frame_index[:, camera], strict=True):
            distance = np.abs(times - t)
            if len(times) and distance.min() <= max(interval, SIMULTANEOUS_S):
                assert distance[frame] == distance.min() and frame >= 0
            else:
                assert frame == -1


def test_simultaneous_frames_are_one_event_and_rounded_stamps_do_not_split_it():
    markers = np.round(np.arange(5) / 60, 6)
    exact = np.arange(5) / 60
    for mode in ("own", "causal"):
        timeline = build_timeline(markers, [exact, exact + 4e-4, exact - 4e-4], mode)
        assert timeline.sample_index.tolist() == [0, 1, 2, 3, 4]
        assert (timeline.frame_index == np.arange(5)[:, None]).all()


def test_of_several_frames_at_one_sample_the_nearest_is_merged_and_the_others_stay():
    timeline = build_timeline(np.array([0.0]), [np.array([-0.0006, 0.0001, 0.0008])])
    np.testing.assert_allclose(timeline.event_times, [-0.0006, 0.0, 0.0008])
    assert timeline.sample_index.tolist() == [-1, 0, -1]
    assert timeline.frame_index[:, 0].tolist() == [0, 1, 2]


def test_unsynchronised_video_has_events_of_its_own():
    timeline = build_timeline(np.array([0.0, 0.1, 0.2]), [np.array([0.05, 0.15])])
    np.testing.assert_allclose(timeline.event_times, [0, 0.05, 0.1, 0.15, 0.2])
    assert timeline.sample_index.tolist() == [0, -1, 1, -1, 2]
    assert timeline.frame_index[:, 0].tolist() == [-1, 0, -1, 1, -1]


def test_a_bundle_is_at_the_middle_of_its_frames_or_causally_at_the_last():
    videos = [np.array([0.0, 0.1]), np.array([0.02, 0.12])]
    markers = np.array([0.5])
    np.testing.assert_allclose(build_timeline(markers, videos).event_times, [0.01, 0.11, 0.5])
    causal = build_timeline(markers, videos, "causal")
    np.testing.assert_allclose(causal.event_times, [0.02, 0.12, 0.5])


def test_markers_and_video_without_common_time_are_refused():
    markers = np.array([0.0, 1.0])
    check_overlap(markers, np.array([1.0, 2.0]), "v.mp4")
    for video in ([1.5, 2.0], [-2.0, -0.5]):
        with pytest.raises(InputError, match=r"v.mp4: no overlap.*check the offset"):
            check_overlap(markers, np.array(video), "v.mp4")


# Video -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", CODECS)
def test_a_video_yields_its_frames_at_their_times(tmp_path, suffix):
    video = Video(write_video(tmp_path / f"v{suffix}"), offset=2.0)
    assert (video.size, len(video)) == ((64, 48), 20)
    assert video.fps == pytest.approx(100)
    np.testing.assert_allclose(video.times, 2 + np.arange(20) / 100, atol=1e-9)
    np.testing.assert_array_equal([t for t, _ in video], video.times)
    assert numbers(video) == numbers(video) == list(range(20))


def test_uneven_frame_times_are_kept(tmp_path):
    stamps = [0, 1, 4, 5, 11, 12]
    video = Video(write_video(tmp_path / "v.mp4", stamps))
    np.testing.assert_allclose(video.times, np.array(stamps) / 100, atol=1e-9)
    assert numbers(video) == list(range(6))


def test_colour_is_bgr_and_luma_is_grey(tmp_path):
    video = Video(write_video(tmp_path / "v.mp4"))
    colour = next(video.frames())[1]
    grey = next(video.frames(luma=True))[1]
    assert colour is not None and colour.shape == (48, 64, 3)
    assert grey is not None and grey.shape == (48, 64) and grey.dtype == np.uint8
    assert grey[:12, :12].mean() > 200 > 60 > grey[30:].mean()


def test_an_undecodable_frame_is_none_and_the_rest_goes_on(tmp_path):
    # Every frame of an AVI of JPEGs stands by itself: wipe out one.
    path = write_video(tmp_path / "v.avi")
    content = bytearray(path.read_bytes())
    start = [i for i in range(len(content)) if content[i : i + 2] == b"\xff\xd8"][7]
    end = content.index(b"\xff\xd9", start)
    content[start:end] = bytes(end - start)
    path.write_bytes(content)
    expected = [None if i == 7 else i for i in range(20)]
    assert numbers(Video(path)) == expected


def test_a_truncated_video_just_ends(tmp_path):
    path = write_video(tmp_path / "v.mp4", options={"movflags": "faststart"})
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * 0.8)])
    video = Video(path)
    actual = numbers(video)
    assert 0 < len([i for i in actual if i is not None]) < 20
    assert len(actual) == len(video.times)
    assert all(i == n for i, n in enumerate(actual) if n is not None)


def test_frames_that_a_decoder_skips_repeats_or_shuffles_keep_their_places(tmp_path, monkeypatch):
    video = Video(write_video(tmp_path / "v.mp4", range(6)))
    decoded = dict(video._decode_frames())
    monkeypatch.setattr(video, "_decode_frames", lambda: [(i, decoded[i]) for i in (0, 2, 1, 2, 4)])
    assert numbers(video) == [0, None, 2, None, 4, None]


@pytest.mark.parametrize("content", [b"", b"text", bytes(1000), b"RIFF\0\0\0\0AVI "])
def test_what_is_no_video_is_refused(tmp_path, content):
    path = tmp_path / "v.mp4"
    path.write_bytes(content)
    assert "v.mp4: is not a video" in complaint(Video, path)


def test_a_sound_is_refused(tmp_path):
    with av.open(str(tmp_path / "a.wav"), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000)
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), layout="mono")
        sound.sample_rate = 8000
        container.mux(stream.encode(sound))
    assert "it has no video stream" in complaint(Video, tmp_path / "a.wav")


@pytest.mark.parametrize("rotation", [90, 180, -90])
def test_a_video_that_was_taken_sideways_is_upright_as_opencv_shows_it(tmp_path, rotation):
    path = write_video(tmp_path / "v.mp4", rotation=rotation)
    video = Video(path)
    _, expected = cv2.VideoCapture(str(path)).read()
    for luma in (False, True):
        image = next(video.frames(luma))[1]
        assert image is not None and image.shape[:2] == expected.shape[:2]
        assert video.size == image.shape[1::-1]
        bright = image.reshape(*image.shape[:2], -1).mean(-1) > 150
        np.testing.assert_array_equal(bright[2::4, 2::4], expected.mean(-1)[2::4, 2::4] > 150)


def test_frames_in_memory_have_the_same_face():
    images = [picture(0), None, picture(2)]
    source = VideoSource("cam", Camera.create((64, 48), np.eye(3)), offset=1.0)
    frames = (np.array([0.0, 0.1, 0.2]), images)
    video = open_video(VideoSource(source.camera_name, source.camera, offset=1.0, frames=frames))
    assert isinstance(video, MemoryVideo)
    assert (video.size, len(video)) == ((64, 48), 3) and video.fps == pytest.approx(10)
    assert numbers(video) == [0, None, 2]
    assert [t for t, _ in video] == [1.0, 1.1, 1.2]
    grey = [image for _, image in video.frames(luma=True)]
    assert grey[0] is not None and grey[0].shape == (48, 64) and grey[1] is None
    assert "neither a file nor frames" in complaint(open_video, source)


@pytest.mark.parametrize(
    ("times", "images"),
    [
        ([0.0], [picture(0), picture(1)]),
        ([0.0, 1.0], [picture(0), picture(1)[:10]]),
        ([0.0], [None]),
        ([1.0, 0.0], [picture(0), picture(1)]),
    ],
)
def test_frames_in_memory_that_do_not_fit_are_refused(times, images):
    assert "video in memory" in complaint(MemoryVideo, np.array(times), images)


@pytest.mark.parametrize(
    ("size", "outcome"),
    [((64, 48), "fits"), ((65, 48), "warns"), ((63, 48), "warns"), ((66, 48), "refused")],
)
def test_a_video_must_fit_its_calibration_to_two_percent(size, outcome):
    video = MemoryVideo(np.array([0.0]), [picture(0)])
    camera = Camera.create(size, np.eye(3))
    if outcome == "refused":
        with pytest.raises(InputError, match="64 × 48, its calibration 66 × 48"):
            check_size(video.size, camera.size, "v.mp4")
        return
    message = check_size(video.size, camera.size, "v.mp4")
    assert (message is None) == (outcome == "fits")
    assert message is None or "not rescaled" in message


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_the_real_videos_have_60_frames_at_60_hertz(recordings, number):
    path = recordings / "balancing" / f"cam_0{number}.mp4"
    video = Video(path)
    assert len(video) == 60 and video.fps == pytest.approx(60)
    np.testing.assert_allclose(video.times, np.arange(60) / 60, atol=1e-9)
    assert video.size == ((1080, 1920) if number <= 2 else (1088, 1920))
    camera = read_calibration(recordings / "balancing" / "calibration.toml")[f"cam_0{number}"]
    message = check_size(video.size, camera.size, path)
    assert (message is None) == (number > 2)
    images = [image for _, image in video.frames(luma=True)]
    assert all(image is not None and image.shape == video.size[::-1] for image in images)


# Hostile videos ----------------------------------------------------------------------------------


def patched(path: Path, box: bytes, at: int, *numbers: int) -> Path:
    """A video whose box of that kind holds other numbers of 32 bits."""
    content = bytearray(write_video(path).read_bytes())
    start = content.index(box) + at
    content[start : start + 4 * len(numbers)] = struct.pack(f">{len(numbers)}I", *numbers)
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("box", "at", "numbers"),
    [
        (b"stts", 8, (1, 20, 2**31 - 1)),
        (b"stts", 8, (1, 20, 0)),
        (b"stts", 8, (1, 2**31, 1)),
        (b"stsz", 8, (1, 2**30)),
        (b"stsz", 8, (1, 2**28 - 1)),
        (b"mdhd", 16, (0,)),
        (b"mdhd", 16, (1,)),
        (b"mvhd", 16, (0, 2**32 - 1)),
    ],
)
def test_times_and_counts_of_a_video_are_sensible_or_refused(tmp_path, box, at, numbers):
    try:
        video = Video(patched(tmp_path / "v.mp4", box, at, *numbers))
    except InputError as error:
        assert str(error).startswith(f"{tmp_path / 'v.mp4'}: ")
        return
    assert np.isfinite(video.times).all() and (np.diff(video.times) > 0).all()
    assert len(list(video)) == len(video.times)


def test_stamps_far_apart_are_refused(tmp_path):
    write_video(tmp_path / "v.mkv", [0, 1, 2, 100 * 86400 * 30])
    assert "found frames 0 to 2.592e+06 s after its start" in complaint(Video, tmp_path / "v.mkv")


def test_images_of_any_size_that_a_file_states_are_not_decoded(tmp_path):
    """JPEG images of 30000 by 30000 pixels, as their headers say, in a small file."""
    content = bytearray(write_video(tmp_path / "v.avi").read_bytes())
    places = [i for i in range(len(content)) if content[i : i + 2] == b"\xff\xc0"]
    for place in places:
        content[place + 5 : place + 9] = struct.pack(">HH", 30_000, 30_000)
    (tmp_path / "v.avi").write_bytes(content)
    assert "none of its frames can be decoded" in complaint(Video, tmp_path / "v.avi")


def test_frames_of_another_size_are_none(tmp_path):
    images = [cv2.imencode(".jpg", np.full((h, 64, 3), 90, np.uint8))[1] for h in (48, 48, 32)]
    (tmp_path / "v.mjpeg").write_bytes(b"".join(image.tobytes() for image in images))
    video = Video(tmp_path / "v.mjpeg")
    shown = [image is not None for _, image in video]
    assert video.size == (64, 48) and shown == [True, True, False]


def test_more_frames_than_any_recording_has_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(video_module, "MAX_FRAMES", 10)
    assert "expected at most 10 frames" in complaint(Video, write_video(tmp_path / "v.mp4"))


@pytest.mark.parametrize(
    "text",
    [
        "#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nv.mp4\n",
        "ffconcat version 1.0\nfile 'v.mp4'\n",
        "v=0\no=- 0 0 IN IP4 127.0.0.1\nc=IN IP4 127.0.0.1\nm=video 9 RTP/AVP 96\n",
    ],
)
def test_lists_of_other_files_and_hosts_are_no_videos(tmp_path, text):
    write_video(tmp_path / "v.mp4")
    (tmp_path / "list.mp4").write_text(text)
    assert "list.mp4: is not a video" in complaint(Video, tmp_path / "list.mp4")
