"""A rehearsal of ``jaxmocap live`` under a flood of valid packets.

    python tests/live/rehearse_flood.py [--hz 20000] [--seconds 40]

A player sends markers 90 times a second, and another process as many packets as it is asked to, all
of them valid, from the first moment, while programs still compile. Run by name, not collected: it
takes all of two cores. What is asserted is that markers come in all the time, and that poses do.
"""

import argparse
import json
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from jaxmocap.outputs.senders.osc import Bundle
from jaxmocap.outputs.senders.unity import to_unity
from jaxmocap.synthetic.movements import motions
from jaxmocap.synthetic.people.clothed_person import MARKERS

RATE_HZ = 90
LIVE = """
[markers.on]
{places}
[osc]
listen = {port}
[vmc]
send = {vmc}
[subject]
height = 1.75
"""
# As many are sent at a stroke, between two looks at the clock.
STROKE_S = 0.002


def send(port: int, hz: float, seconds: float) -> None:
    """Markers of table tennis, so many samples a second; prints how many were sent."""
    times = np.arange(0, seconds, 1 / RATE_HZ)
    performance = motions.table_tennis(seconds, 3)
    bones, figure = performance.bones(times), performance.figure
    points = np.stack([figure.points(bones, *on) for on in MARKERS.values()], 1)
    bundle = Bundle(
        [("/VMC/Ext/T", [0.0]), *(("/VMC/Ext/Tra/Pos", [n, *[0.0] * 7]) for n in MARKERS)]
    )
    turns = np.tile([0.0, 0, 0, 1], (len(MARKERS), 1))
    placed = [np.hstack([each, turns]) for each in to_unity(points)]
    # Filling them in takes longer than sending them.
    packets = [bytes(bundle.filled(at, rows)) for at, rows in zip(times, placed, strict=True)]
    sender, sent, began = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), 0, time.monotonic()
    while (elapsed := time.monotonic() - began) < seconds:
        at = min(int(elapsed * RATE_HZ), len(packets) - 1)
        for _ in range(int(elapsed * hz) - sent):
            sender.sendto(packets[at], ("127.0.0.1", port))
            sent += 1
        time.sleep(min(STROKE_S, 1 / hz))
    print(sent)


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


def rehearse(hz: float, seconds: float) -> None:
    """Start everything, count the run's messages."""
    folder, port = Path(tempfile.mkdtemp(prefix="flood-")), free_port()
    places = [
        f'{name} = {{ bone = "{bone}", at = {at}, offset = {list(offset)} }}'
        for name, (bone, at, offset) in MARKERS.items()
    ]
    setup, figures_file = folder / "live.toml", folder / "figures.json"
    setup.write_text(LIVE.format(places="\n".join(places), port=port, vmc=free_port()))
    command = [sys.executable, "-m", "jaxmocap.cli", "live", str(setup)]
    live = subprocess.Popen(
        [*command, "--seconds", str(seconds), "--json", str(figures_file)],
        stderr=subprocess.PIPE,
        text=True,
    )
    assert live.stderr is not None
    senders = []
    for line in live.stderr:
        print("   ", line, end="")
        if "listening" in line:
            senders = [
                subprocess.Popen([sys.executable, __file__, "send", str(port), str(each), str(s)],
                                 stdout=subprocess.PIPE, text=True)
                for each, s in ((RATE_HZ, seconds + 5), (hz, seconds + 5))
            ]  # fmt: skip
    assert live.wait() == 0
    sent = [int(sender.communicate()[0]) for sender in senders]
    figures = json.loads(figures_file.read_text())
    messages = [each["what"] for each in figures["warnings"]]
    silent = messages.count("markers: nothing comes in")
    print(f"{sent[1] / (seconds + 5):.0f} packets a second, {figures['packets']} fetched")
    print(f"{figures['outputs']} poses, 'nothing comes in' {silent} times")
    print(f"clocks were set {figures['clock_jumps']} times")
    assert silent == 0 and figures["outputs"] > 0


def main() -> None:
    """The rehearsal, or one of its processes."""
    if sys.argv[1:2] == ["send"]:
        send(int(sys.argv[2]), float(sys.argv[3]), float(sys.argv[4]))
        return
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--hz", type=float, default=20_000)
    parser.add_argument("--seconds", type=float, default=40.0)
    options = parser.parse_args()
    rehearse(options.hz, options.seconds)


if __name__ == "__main__":
    main()
