"""Network cameras: what is decoded, by which process, and what is refused."""

import http.server
import os
import re
import signal
import socket
import socketserver
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import ClassVar

import av
import numpy as np
import pytest
from conftest import complaint

from jaxmocap.capture import decoding
from jaxmocap.capture.streams import cameras
from jaxmocap.capture.streams.cameras import stream_frames
from jaxmocap.capture.video import Video
from jaxmocap.formats.files.errors import InputError

SIZE = (96, 72)
MOST = cameras.max_pixels(SIZE)
MULTIPART = "multipart/x-mixed-replace;boundary=x"


def write_clip(to: str, kind: str, codec: str = "libx264", frames: int = 100, pace_s: float = 0.0):
    options = {"tune": "zerolatency", "x264-params": "repeat-headers=1"}
    with av.open(to, "w", format=kind) as container:
        stream = container.add_stream(codec, 30, options=options if codec == "libx264" else {})
        stream.width, stream.height = SIZE
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        for i in range(frames):
            image = np.full((*SIZE[::-1], 3), (i, 80, 200), np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
            time.sleep(pace_s)
        container.mux(stream.encode())


@contextmanager
def server(handle):
    """Whoever connects is handled so; the port."""

    class Handler(socketserver.BaseRequestHandler):
        def handle(self):
            handle(self.request)

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Handler) as serving:
        serving.daemon_threads = True
        threading.Thread(target=serving.serve_forever, daemon=True).start()
        try:
            yield serving.server_address[1]
        finally:
            serving.shutdown()


def clip(folder: Path, kind: str = "mpegts", codec: str = "libx264") -> bytes:
    write_clip(str(folder / "clip"), kind, codec)
    return (folder / "clip").read_bytes()


def test_a_stream_of_far_larger_images_than_calibrated_is_not_decoded(tmp_path):
    content = clip(tmp_path)
    with server(lambda connection: connection.sendall(content)) as port:
        frames = list(stream_frames(f"tcp://127.0.0.1:{port}", False, MOST))
        assert len(frames) >= 20 and frames[0].shape == SIZE[::-1]
        colour = next(stream_frames(f"tcp://127.0.0.1:{port}", True, MOST))
        assert colour.shape == (*SIZE[::-1], 3)
        # Blue grows from frame to frame.
        assert np.abs(colour[..., 1:] - np.array([80, 200])).max() <= 5
        with pytest.raises(InputError, match="images of 96 × 72 pixels, far more"):
            list(stream_frames(f"tcp://127.0.0.1:{port}", False, 1000))


def rtsp(connection: socket.socket) -> None:
    """A camera that streams by RTP over UDP to whoever plays it."""
    sdp = "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=a\r\nc=IN IP4 127.0.0.1\r\nt=0 0\r\n"
    sdp += "m=video 0 RTP/AVP 96\r\na=rtpmap:96 H264/90000\r\na=control:streamid=0\r\n"
    port = 0
    while request := connection.recv(4096).decode():
        headers = [f"CSeq: {re.search(r'CSeq: (.*)', request)[1].strip()}", "Session: 1"]
        if found := re.search(r"client_port=(\d+)", request):
            port = int(found[1])
            ports = f"client_port={port}-{port + 1};server_port=50000-50001"
            headers.append(f"Transport: RTP/AVP/UDP;unicast;{ports}")
        body = sdp if request.startswith("DESCRIBE") else ""
        headers += ["Content-Type: application/sdp", f"Content-Length: {len(body)}"] * bool(body)
        connection.sendall(("\r\n".join(["RTSP/1.0 200 OK", *headers, "", ""]) + body).encode())
        if request.startswith("PLAY"):
            write_clip(f"rtp://127.0.0.1:{port}", "rtp", frames=60, pace_s=0.02)
            return


def test_an_rtsp_camera_is_read():
    with server(rtsp) as port:
        frames = stream_frames(f"rtsp://127.0.0.1:{port}/stream", False, MOST)
        assert [next(frames).shape for _ in range(10)] == [SIZE[::-1]] * 10
        frames.close()


@contextmanager
def web_server(folder: Path):
    class Quiet(http.server.SimpleHTTPRequestHandler):
        extensions_map: ClassVar = {"": "video/mp2t", ".mjpg": MULTIPART}

        def log_message(self, *_):
            pass

    with http.server.ThreadingHTTPServer(
        ("127.0.0.1", 0), partial(Quiet, directory=folder)
    ) as serving:
        threading.Thread(target=serving.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{serving.server_address[1]}"
        serving.shutdown()


@pytest.mark.parametrize(
    ("name", "kind", "codec"), [("a.mjpg", "mjpeg", "mjpeg"), ("a.ts", "mpegts", "libx264")]
)
def test_a_camera_on_the_web_is_read(tmp_path, name, kind, codec):
    content = clip(tmp_path, kind, codec)
    if kind == "mjpeg":
        # As cameras write it.
        images = re.findall(rb"\xff\xd8.*?\xff\xd9", content, re.DOTALL)
        head = b"--x\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n"
        content = b"".join(head % len(image) + image + b"\r\n" for image in images)
    (tmp_path / name).write_bytes(content)
    with web_server(tmp_path) as address:
        assert len(list(stream_frames(f"{address}/{name}", False, MOST))) >= 20


def test_a_camera_is_read_where_the_system_allows_no_larger_pipe(tmp_path, monkeypatch):
    """As beyond fs.pipe-max-size, or once a user's pipes together hold what they may."""
    fcntl = pytest.importorskip("fcntl", reason="this system has no pipes of another size")
    asked, actual = [], fcntl.fcntl

    def limited(file, what, *value):
        if what == getattr(fcntl, "F_SETPIPE_SZ", None):
            asked.append(value)
            raise PermissionError(1, "Operation not permitted")
        return actual(file, what, *value)

    monkeypatch.setattr(fcntl, "fcntl", limited)
    (tmp_path / "a.ts").write_bytes(clip(tmp_path))
    with web_server(tmp_path) as address:
        assert len(list(stream_frames(f"{address}/a.ts", False, MOST))) >= 20
    assert asked or not hasattr(fcntl, "F_SETPIPE_SZ")


def test_a_playlist_which_leads_to_other_hosts_is_no_camera(tmp_path):
    (tmp_path / "a.ts").write_bytes(clip(tmp_path))
    (tmp_path / "a.m3u8").write_text("#EXTM3U\n#EXTINF:1,\na.ts\n#EXT-X-ENDLIST\n")
    with web_server(tmp_path) as address, pytest.raises(InputError, match="Invalid data"):
        list(stream_frames(f"{address}/a.m3u8", False, MOST))


def test_a_protocol_that_is_no_cameras_is_refused(tmp_path):
    (tmp_path / "a.ts").write_bytes(clip(tmp_path))
    for address in (f"concat://{tmp_path}/a.ts", f"subfile,,:file://{tmp_path}/a.ts"):
        with pytest.raises(InputError):
            list(stream_frames(address, False, MOST))


@pytest.mark.parametrize("codec", ["snow", "flashsv"])
def test_a_codec_that_no_camera_has_is_not_decoded(tmp_path, codec):
    path = tmp_path / "a.avi"
    with av.open(str(path), "w", options={"strict": "experimental"}) as container:
        stream = container.add_stream(codec, 30, options={"strict": "experimental"})
        stream.width, stream.height = SIZE
        stream.pix_fmt = "bgr24" if codec == "flashsv" else "yuv420p"
        picture = av.VideoFrame.from_ndarray(np.zeros((*SIZE[::-1], 3), np.uint8), format="bgr24")
        container.mux([*stream.encode(picture), *stream.encode()])
    with pytest.raises(InputError, match=f"found video of the kind {codec}, which is not decoded"):
        Video(path)
    content = path.read_bytes()
    serving = server(lambda connection: connection.sendall(content))
    problem = f"of the kind {codec}, which is not decoded"
    with serving as port, pytest.raises(InputError, match=problem):
        list(stream_frames(f"tcp://127.0.0.1:{port}", False, MOST))


@pytest.mark.parametrize(
    "height, width, layout, sent",
    [(73, 96, decoding.PLANES, 73 * 144), (72, 96, decoding.GREY, 100), (72, 96, 7, 9000),
     (72, 0, decoding.BGR, 9000), (2**31, 96, decoding.GREY, 9000)],
)  # fmt: skip
def test_a_process_that_was_taken_over_is_not_believed(
    tmp_path, monkeypatch, height, width, layout, sent
):
    """Whoever has sent the stream may write what it hands on."""
    script = tmp_path / "taken_over.py"
    header = decoding.HEADER.pack(height, width, layout)
    script.write_text(f"import sys; sys.stdout.buffer.write({header!r} + bytes({sent}))")
    monkeypatch.setattr(decoding, "__file__", str(script))
    with pytest.raises(InputError, match="the process that decodes it has ended"):
        list(stream_frames("tcp://127.0.0.1:1", True, MOST))


def test_a_process_that_dies_of_a_stream_leaves_the_run_going(tmp_path, monkeypatch):
    """As a flaw of FFmpeg would let it die, or its limits."""
    content, started = clip(tmp_path), []

    def send(connection: socket.socket) -> None:
        connection.sendall(content)
        time.sleep(1.5)

    class Kept(subprocess.Popen):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            started.append(self)

    monkeypatch.setattr(subprocess, "Popen", Kept)
    with server(send) as port:
        frames = stream_frames(f"tcp://127.0.0.1:{port}", False, MOST)
        next(frames)
        os.kill(started[0].pid, signal.SIGKILL)
        assert "the process that decodes it has ended" in complaint(list, frames)
    assert started[0].returncode is not None


@pytest.mark.skipif(
    not hasattr(signal, "SIGKILL"), reason="this system cannot limit a process's memory"
)
def test_the_process_has_limits_of_memory_and_time():
    begins = "import sys; sys.path.insert(0, sys.argv[1]); import decoding; import time\n"
    hangs = "decoding.FRAME_LIMIT_S = 0.5\ndecoding.write_images(iter(lambda: time.sleep(60), 0))"
    takes = "decoding.limit_memory(decoding.MAX_MEMORY_BYTES)\nbytearray(2**31)"
    for code, ended in ((hangs, 1), (takes, 1)):
        began = time.monotonic()
        folder = Path(decoding.__file__).parent
        done = subprocess.run(
            [sys.executable, "-P", "-c", begins + code, folder], capture_output=True, text=True
        )
        assert done.returncode == ended and time.monotonic() - began < 30
        assert ("MemoryError" in done.stderr) == (code is takes)
