"""What a browser shows of a recording, looked at roughly: a broken layout fails."""

import base64
import json
import shutil
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import cv2
import numpy as np
import pytest
from test_outputs import START, make_camera, make_motion

from jaxmocap.body.motion import Motion
from jaxmocap.body.skeleton import ELBOWS, LANDMARKS
from jaxmocap.outputs.viewer import Footage, write_rerun
from jaxmocap.pipelines.view import LOOPBACK, free_port, serve_page

# fmt: off
OPTIONS = (
    "--headless=new", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--use-gl=angle",
    "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--window-size=1500,950",
)
# fmt: on
WAIT_S = 120
# Rows and columns of a picture of 1500 x 807 pixels, as shares.
BODY, IMAGE = np.s_[0.09:0.69, 0.0:0.49], np.s_[0.12:0.69, 0.52:1.0]
ANGLES, DEVIATIONS = np.s_[0.75:0.93, 0.1:0.37], np.s_[0.75:0.93, 0.43:0.74]


@contextmanager
def browser() -> Iterator:
    """Takes a method, a path and a body, and sends them to ChromeDriver; its answer's value."""
    port = free_port()
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    driver = subprocess.Popen([str(shutil.which("chromedriver")), f"--port={port}"], **silent)

    def call(method: str, path: str, body: dict | None = None):
        content = None if body is None else json.dumps(body).encode()
        url, header = f"http://{LOOPBACK}:{port}{path}", {"Content-Type": "application/json"}
        request = urllib.request.Request(url, content, header, method=method)
        return json.loads(urllib.request.urlopen(request, timeout=60).read())["value"]

    session = ""
    try:
        for _ in range(100):
            try:
                call("GET", "/status")
                break
            except OSError:
                time.sleep(0.1)
        wanted = {"alwaysMatch": {"goog:chromeOptions": {"args": list(OPTIONS)}}}
        session = "/session/" + call("POST", "/session", {"capabilities": wanted})["sessionId"]
        yield lambda method, path, body=None: call(method, session + path, body)
    finally:
        if session:
            call("DELETE", session)
        driver.terminate()
        driver.wait()


def part(picture: np.ndarray, shares: tuple[slice, slice]) -> np.ndarray:
    """(N, 3) BGR of a part of the picture."""
    rows, columns = (
        slice(int(share.start * size), int(share.stop * size))
        for share, size in zip(shares, picture.shape, strict=False)
    )
    return picture[rows, columns].reshape(-1, 3).astype(int)


def missing_from(picture: np.ndarray) -> list[str]:
    """What a picture of the viewer does not show."""
    blue, green, red = part(picture, BODY).T
    skin = (red - blue > 25) & (red - blue < 110) & (red > green) & (green > blue)
    level = (np.abs(red - green) < 16) & (blue > red) & (blue - red < 35) & (green > 120)
    shares = {
        "a body": (skin.mean(), 0.015, 0.4),
        "a floor and a calm background": (level.mean(), 0.4, 0.99),
        "the camera's image": (_share(part(picture, IMAGE), IMAGE_BGR, 40), 0.3, 0.999),
        "the body in the image": (_share(part(picture, IMAGE), LINE_BGR, 60), 0.001, 0.2),
    }
    for name, place in (("joint angles", ANGLES), ("elbows' ± cm", DEVIATIONS)):
        for side, colour in LINES_BGR.items():
            shares[f"{name}, {side}"] = _share(part(picture, place), colour, 90), 0.0005, 0.2
    return [
        f"{name}: a share of {share:.4f}, expected {low} to {high}"
        for name, (share, low, high) in shares.items()
        if not low < share < high
    ]


IMAGE_BGR, LINE_BGR = (60, 140, 60), (255, 170, 70)
LINES_BGR = {"left": (255, 170, 70), "right": (60, 160, 255)}


def _share(pixels: np.ndarray, colour: tuple[int, int, int], near: int) -> float:
    return float((np.abs(pixels - colour).sum(1) < near).mean())


def test_what_is_missing_from_an_empty_page_is_everything():
    for grey in (0, 128, 255):
        assert len(missing_from(np.full((807, 1500, 3), grey, np.uint8))) == 8


def wavering(motion: Motion) -> Motion:
    """The motion, its elbows' deviations going up and down, so that both curves show."""
    deviations = np.full((len(motion.times), len(LANDMARKS), 3), 0.02)
    for elbow, shift in zip(ELBOWS, (0.0, 1.5), strict=True):
        deviations[:, elbow] += 0.01 * np.sin(9 * (motion.times - START) + shift)[:, None]
    return replace(motion, report=replace(motion.report, landmarks_std=deviations))


@pytest.mark.slow
def test_a_browser_shows_body_image_and_curves(tmp_path):
    if not (shutil.which("chromium") and shutil.which("chromedriver")):
        pytest.skip("no chromium and chromedriver here")
    image = np.full((480, 640, 3), IMAGE_BGR, np.uint8)
    footage = Footage(make_camera(640, 480), [(START + i / 30, image) for i in range(13)])
    write_rerun(tmp_path / "recording.rrd", wavering(make_motion()), {"cam": footage})
    served = serve_page(tmp_path / "recording.rrd", free_port())
    end, missing = time.monotonic() + WAIT_S, ["a picture"]
    try:
        with browser() as call:
            call("POST", "/url", {"url": served.page})
            while missing and time.monotonic() < end:
                time.sleep(3)
                try:
                    content = base64.b64decode(call("GET", "/screenshot"))
                except urllib.error.HTTPError:
                    # A busy machine draws it too slowly for ChromeDriver's ten seconds.
                    continue
                (tmp_path / "shown.png").write_bytes(content)
                picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
                missing = missing_from(picture)
    finally:
        served.end()
    assert not missing, (missing, tmp_path / "shown.png")
