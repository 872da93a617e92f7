"""The viewer: what it shows without a click, and the page that it serves."""

import time
import urllib.request

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb

from jaxmocap.cli import main
from jaxmocap.formats.errors import InputError
from jaxmocap.outputs.layout import SERIES, lay_out
from jaxmocap.outputs.scene import Scene
from jaxmocap.run.viewing import LOOPBACK, free_port, serve_page

SCENE = Scene(
    ("head",),
    np.zeros(1),
    np.eye(3)[None, None],
    np.zeros((1, 1, 3)),
    np.ones((1, 1, 3)),
    np.ones((1, 2)),
)


def shown(part) -> set[str]:
    """Names of the views that are seen: of tabs only the first."""
    if isinstance(part, rrb.Container):
        contents = list(part.contents)
        if isinstance(part, rrb.Tabs):
            contents = contents[:1]
        return set().union(*(shown(each) for each in contents))
    return {part.name}


@pytest.mark.parametrize("cameras", [0, 1, 4])
def test_body_cameras_and_curves_are_shown_without_a_click(cameras):
    labels = {f"cam {i}": ["edges, left", "edges, right"] for i in range(cameras)}
    visible = shown(lay_out(labels, SCENE).root_container)
    assert visible >= {"Body", *labels, *SERIES.values()}
    assert len([name for name in visible if "edges" in name]) == min(2 * cameras, 2)


@pytest.fixture
def folder(tmp_path):
    """A folder with something that the viewer reads."""
    stream = rr.RecordingStream("test")
    stream.save(tmp_path / "recording.rrd")
    stream.log("points", rr.Points3D([[0.0, 0.0, 0.0]]))
    stream.disconnect()
    return tmp_path


def test_the_page_is_served_to_this_machine_and_its_data_beside_it(folder):
    served = serve_page(folder / "recording.rrd", free_port())
    try:
        page = str(served.page)
        assert page.startswith(f"http://{LOOPBACK}:") and LOOPBACK in served.url
        end = time.monotonic() + 60
        while True:
            try:
                text = urllib.request.urlopen(page, timeout=5).read().decode()
                break
            except OSError:
                assert time.monotonic() < end and served.process.poll() is None
                time.sleep(0.1)
        assert "<html" in text.lower() and "rerun" in text.lower()
    finally:
        served.process.terminate()
        served.process.wait()


def test_a_port_that_is_taken_is_said(folder, capsys):
    import socket

    with socket.socket() as taken:
        taken.bind((LOOPBACK, 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=f"port {port}"):
            serve_page(folder / "recording.rrd", port)
        assert main(["view", str(folder), "--web", "--port", str(port)]) == 2
    assert f"port {port}" in capsys.readouterr().err
