"""A rehearsal of ``jaxmocap live`` with everything that goes wrong.

    python tests/live/rehearse_live.py

    player     replays a recording's markers as VMC over OSC, 90 a second
    camera     streams its video over TCP, 30 a second
    live       the command itself
    receiver   takes the poses

are processes of their own. Run by name, not collected: it takes a minute and a half, and prints
figures that mean something only on a machine that is otherwise idle. What is asserted is that poses
arrive, in order, with head and hands where the markers were, through every fault and within a
second after it.
"""

import argparse
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from pythonosc.osc_packet import OscPacket
from scipy.spatial.transform import Rotation

from jaxmocap import Recording
from jaxmocap.capture.video import open_video
from jaxmocap.outputs.senders.osc import Bundle
from jaxmocap.outputs.senders.unity import to_unity
from jaxmocap.synthetic.recording import write_table_tennis

RATE, FPS, GROUP = 90, 30, 15
NAMES = ("Headset", "LeftController", "RightController")
LIVE = """
[markers.on]
Headset = {{ bone = "head", at = 0.7, offset = [0.1, 0.0, 0.0] }}
LeftController = {{ bone = "hand_l", at = 0.6, offset = [0.02, 0.0, 0.0] }}
RightController = {{ bone = "hand_r", at = 0.6, offset = [0.02, 0.0, 0.0] }}
[osc]
listen = {markers}
[vmc]
send = {vmc}
[[video]]
url = "tcp://127.0.0.1:{camera}"
camera = "webcam"
[calibration]
file = "{folder}/calibration.toml"
[subject]
height = 1.75
"""
# Fault -> when it begins and ends, seconds of the rehearsal.
FAULTS = {
    "10,000 garbage packets": (8.0, 8.5),
    "marker source killed": (14.0, 16.0),
    "camera unplugged": (22.0, 25.0),
    "one hand lost": (30.0, 32.0),
    "clock jump of 1 s": (37.0, 37.0),
    "5 times the packets": (44.0, 47.0),
}
RECOVERY_S, SECONDS = 1.0, 60.0
# A pose meets its markers within this; the reference bodies are not ours to the millimetre.
NEAR_M = 0.05
# A sample's time is inferred from its packets' stamps and arrivals, which a busy machine blurs.
NEAR_S = 0.05


def there_and_back(i: int, count: int) -> int:
    """The ith of 0, 1, ... count - 1, count - 2, ... 1, 0, 1, ...: no jump anywhere."""
    around = i % (2 * count - 2)
    return min(around, 2 * count - 2 - around)


# Processes ---------------------------------------------------------------------------------------


def signal_given() -> float:
    """Say that this process is ready; when the rehearsal begins, ``monotonic`` seconds."""
    print("ready", flush=True)
    return float(input())


def play(recording: Path, port: int, begin: float, log: Path) -> None:
    """Send markers; log of what was sent: when, and where (M, 3) in Unity.

    Args:
        recording: to take them from.
        port: of UDP on this machine.
        begin: first of the rehearsal's seconds to send in.
        log: a file.
    """
    loaded = Recording.load(recording)
    frames = len(open_video(loaded.videos[0]))
    # As long as the video, so that both come back at the same time.
    points = to_unity(loaded.positions_world)[: (frames - 1) * RATE // FPS + 1]
    turns = np.tile([0.0, 0, 0, 1], (len(NAMES), 1))
    both_hands, one_hand = (
        Bundle([("/VMC/Ext/T", [0.0]), *(("/VMC/Ext/Con/Pos", [n, *[0.0] * 7]) for n in names)])
        for names in (NAMES, NAMES[:2])
    )
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    now, informed_at, began = begin, log.open("w", buffering=1), signal_given()
    while now < SECONDS:
        time.sleep(max(began + now - time.monotonic(), 0))
        index = there_and_back(int(now * RATE + 1e-6), len(points))
        lost = FAULTS["one hand lost"][0] <= now < FAULTS["one hand lost"][1]
        jump = 1.0 if now >= FAULTS["clock jump of 1 s"][0] else 0.0
        placed = np.hstack([points[index], turns])
        packet = (one_hand, placed[:2]) if lost else (both_hands, placed)
        sender.sendto(packet[0].fill(now + jump, packet[1]), ("127.0.0.1", port))
        at = time.monotonic() - began
        print(at, *points[index].ravel().tolist(), file=informed_at)
        fast = FAULTS["5 times the packets"][0] <= now < FAULTS["5 times the packets"][1]
        # A headset that was held up does not send what it has missed.
        missed = max(int((at - now) * RATE), 0)
        now += missed / RATE + 1 / (5 * RATE if fast else RATE)


def garbage(port: int) -> None:
    """10,000 packets of noise, some of which begin like OSC."""
    rng, sender = np.random.default_rng(0), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    starts = (b"", b"#bundle\0\0\0\0\0\0\0\0\1", b"/VMC/Ext/Con/Pos\0\0\0\0,sfffffff\0\0\0")
    for i in range(10_000):
        noise = rng.bytes(int(rng.integers(0, 200)))
        sender.sendto(starts[i % 3] + noise, ("127.0.0.1", port))


def film(recording: Path, port: int, begin: float) -> None:
    """Stream the video there and back, in step with the markers, to whoever connects."""
    frames = [image for _, image in open_video(Recording.load(recording).videos[0])]
    order = [there_and_back(i, len(frames)) for i in range(2 * len(frames) - 2)]
    height, width = frames[0].shape[:2]
    encoder = av.CodecContext.create("libx264", "w")
    encoder.width, encoder.height, encoder.pix_fmt = width, height, "yuv420p"
    encoder.time_base, encoder.framerate = Fraction(1, FPS), Fraction(FPS)
    # A stream may begin at any key frame.
    keys = {"g": str(GROUP), "sc_threshold": "0"}
    encoder.options = {"preset": "veryfast", "tune": "zerolatency", "crf": "18", **keys}
    packets = []
    for i, index in enumerate(order):
        picture = av.VideoFrame.from_ndarray(frames[index], format="bgr24")
        picture.pts = i
        packets += [(bytes(packet), packet.is_keyframe) for packet in encoder.encode(picture)]
    packets += [(bytes(packet), packet.is_keyframe) for packet in encoder.encode(None)]
    began = signal_given()
    time.sleep(max(began + begin - time.monotonic(), 0))
    url = f"tcp://127.0.0.1:{port}?listen=1"
    with av.open(url, "w", format="mpegts", options={"flush_packets": "1"}) as container:
        stream = container.add_stream("libx264", rate=FPS)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        first = i = GROUP * (1 + int((time.monotonic() - began) * FPS / GROUP))
        while True:
            data, key = packets[i % len(packets)]
            packet = av.Packet(data)
            packet.stream, packet.time_base, packet.is_keyframe = stream, Fraction(1, FPS), key
            packet.pts = packet.dts = i - first
            time.sleep(max(began + i / FPS - time.monotonic(), 0))
            container.mux(packet)
            i += 1


def receive(port: int, out: Path) -> None:
    """Keep every packet and when it came."""
    listening = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    listening.bind(("127.0.0.1", port))
    listening.settimeout(0.5)
    times, packets, began = [], [], signal_given()
    while time.monotonic() < began + SECONDS + 2:
        try:
            packet = listening.recv(65536)
        except TimeoutError:
            continue
        times.append(time.monotonic() - began)
        packets.append(packet)
    np.savez(out, times=np.array(times), packets=np.array(packets, object))


def started(*arguments: object, **options) -> subprocess.Popen:
    """This script in a process of its own."""
    line = [sys.executable, __file__, *map(str, arguments)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    return subprocess.Popen(line, text=True, **pipes, **options)


# What was received -------------------------------------------------------------------------------


def sent_frames(kept) -> list[tuple[float, list]]:
    """When each frame's last bundle came, and the frame's messages; that bundle has the time."""
    frames, messages = [], []
    for at, packet in zip(kept["times"], kept["packets"], strict=True):
        messages += [timed.message for timed in OscPacket(packet).messages]
        if messages[-1].address == "/VMC/Ext/T":
            frames.append((at, messages))
            messages = []
    return frames


def sent_markers(messages: list) -> tuple[float, np.ndarray] | None:
    """When a frame says that it is, and where (3, 3) head and hands would carry the markers.

    By what a receiver gets: bones' places and turns in their parents. In Unity's T pose the hands
    reach out along x; the markers sit as the file of the live run says.
    """
    bones = {m.params[0]: m.params[1:] for m in messages if m.address == "/VMC/Ext/Bone/Pos"}
    if not bones:
        return None
    trunk = ("Hips", "Spine", "Chest", "UpperChest")
    actual = []
    head, hand = LENGTHS
    for chain, site in (
        ((*trunk, "Neck", "Head"), (0.0, 0.7 * head, 0.1)),
        ((*trunk, *arm("Left")), (-0.6 * hand, 0.0, 0.02)),
        ((*trunk, *arm("Right")), (0.6 * hand, 0.0, 0.02)),
    ):
        place, turn = np.zeros(3), Rotation.identity()
        for bone in chain:
            numbers = bones[bone]
            place, turn = place + turn.apply(numbers[:3]), turn * Rotation.from_quat(numbers[3:])
        actual.append(place + turn.apply(site))
    return messages[-1].params[0], np.array(actual)


def arm(side: str) -> tuple[str, ...]:
    return tuple(f"{side}{bone}" for bone in ("Shoulder", "UpperArm", "LowerArm", "Hand"))


def check_order_and_content(
    received: np.ndarray, stamps: np.ndarray, sent_points: np.ndarray, sent: np.ndarray
) -> tuple[np.ndarray, dict[str, float]]:
    """Poses' times ascend, and each pose is where a sample of about its time was.

    The run counts seconds from its own beginning, as far from ours as most poses say that fit best.

    Returns:
        When the poses' samples were sent, and figures.
    """
    assert (np.diff(stamps) > 0).all(), "poses came out of order"
    calm = [i for i in range(0, len(received), 5) if not in_trouble(received[i])]
    sent_at, points = sent[:, 0], sent[:, 1:].reshape(-1, 3, 3)

    def best(i: int, begin: float, end: float) -> tuple[float, float]:
        """When a sample within these times was sent that fits a pose, and how far off it is."""
        first, last = np.searchsorted(sent_at, [begin, end])
        assert first < last, f"a pose came at {received[i]:.2f} s, when no marker was sent"
        apart = np.linalg.norm(points[first:last] - sent_points[i], axis=-1).max(-1)
        return sent_at[first + int(apart.argmin())], float(apart.min())

    fits = [best(i, received[i] - 1.0, received[i])[0] for i in calm]
    shift = float(np.median(np.array(fits) - stamps[calm]))
    times = stamps + shift
    offs = [best(i, times[i] - NEAR_S, times[i] + NEAR_S)[1] for i in calm]
    worst = float(np.percentile(offs, 99))
    assert worst < NEAR_M, f"head or hands are {100 * worst:.1f} cm off their markers"
    delay = float(np.median(received[calm] - times[calm]))
    return times, {"off_markers_cm_p99": 100 * worst, "sent_to_received_ms": 1e3 * delay}


def in_trouble(at: float) -> bool:
    return any(begin <= at < end + RECOVERY_S for begin, end in FAULTS.values())


def check_delivery(times: np.ndarray, sent: np.ndarray, begin: float, end: float) -> float:
    """Share of the samples that came out, outside of faults and a second after each.

    By when the poses' samples were sent: by when poses came, a latency that varies looks like loss.
    """
    edges = np.arange(begin, end, 0.25)
    calm = [e for e in edges if not in_trouble(e) and not in_trouble(e + 0.25)]
    counts = [
        [np.count_nonzero((each >= e) & (each < e + 0.25)) for e in calm] for each in (times, sent)
    ]
    return float(np.sum(counts[0]) / np.sum(counts[1]))


def check_recovery(received: np.ndarray, sent: np.ndarray) -> dict[str, float]:
    """Share of the samples that came out in the second that begins a second after each fault."""

    def within(times: np.ndarray, begin: float) -> int:
        return np.count_nonzero((times >= begin) & (times < begin + 1))

    after = {fault: end + RECOVERY_S for fault, (_, end) in FAULTS.items()}
    return {fault: float(within(received, at) / within(sent, at)) for fault, at in after.items()}


def check_messages(messages: list[dict]) -> None:
    """The run reported each fault and, where it has an end, that."""
    text = [entry["what"] for entry in messages]
    for sentence in (
        "malformed packets ignored",
        "markers: nothing comes in",
        "webcam: gone",
        "missing: RightController",
        "the sender's clock: was set",
    ):
        assert any(sentence in line for line in text), f"not reported: {sentence}"
    for sentence in ("markers: coming in", "webcam: on"):
        assert text.count(sentence) >= 2, f"not reported again: {sentence}"
    assert text[::-1].index("missing: none") < text[::-1].index("missing: RightController")


# The rehearsal -----------------------------------------------------------------------------------


def rehearse(recording: Path, smooth: bool) -> None:
    """Start everything, break it, and look at what came out."""
    folder = Path(tempfile.mkdtemp(prefix="rehearsal-"))
    markers, vmc, camera = free_ports(3)
    setup = folder / "live.toml"
    setup.write_text(
        LIVE.format(markers=markers, vmc=vmc, camera=camera, folder=recording.parent.resolve())
    )
    figures_file = folder / "figures.json"
    out = folder / "session"
    line = [sys.executable, "-m", "jaxmocap.cli", "live", setup, "--out", out]
    line += ["--json", figures_file, *(["--smooth"] if smooth else [])]
    live = subprocess.Popen([str(part) for part in line], stderr=subprocess.PIPE, text=True)
    assert live.stderr is not None
    for text_line in live.stderr:
        print("   ", text_line, end="")
        if "listening" in text_line:
            break
    forward = started_reader(live.stderr)
    got, logs = folder / "received.npz", [folder / "sent_0.txt", folder / "sent_1.txt"]
    taker = started("receive", vmc, got)
    # The ones that take over are started with the others, and wait.
    begins = (0.0, FAULTS["marker source killed"][1]), (0.0, FAULTS["camera unplugged"][1])
    players = [
        started("play", recording, markers, begin, log)
        for begin, log in zip(begins[0], logs, strict=True)
    ]
    quiet = {"stderr": subprocess.DEVNULL}
    lenses = [started("film", recording, camera, begin, **quiet) for begin in begins[1]]
    began = given_signal([taker, *players, *lenses])

    def wait(until: float) -> None:
        time.sleep(max(began + until - time.monotonic(), 0))

    wait(FAULTS["10,000 garbage packets"][0])
    garbage(markers)
    wait(FAULTS["marker source killed"][0])
    players[0].terminate()
    wait(FAULTS["camera unplugged"][0])
    lenses[0].kill()
    wait(SECONDS + 1)
    live.send_signal(signal.SIGINT)
    assert live.wait(20) == 0, "Ctrl-C did not end it cleanly"
    lenses[1].kill()
    assert players[1].wait(10) == 0
    assert taker.wait(10) == 0
    forward.join(5)
    check_run(json.loads(figures_file.read_text()), got, logs, out)


def given_signal(processes: list[subprocess.Popen]) -> float:
    """Wait until all are ready, and tell them when it begins."""
    for each in processes:
        assert each.stdout is not None and each.stdout.readline() == "ready\n"
    began = time.monotonic() + 0.5
    for each in processes:
        assert each.stdin is not None
        each.stdin.write(f"{began}\n")
        each.stdin.flush()
    return began


def started_reader(stream):
    """Print what the run tells, from a thread."""
    import threading

    def read() -> None:
        for text_line in stream:
            print("   ", text_line, end="", flush=True)

    thread = threading.Thread(target=read, daemon=True)
    thread.start()
    return thread


def check_run(figures: dict, got: Path, logs: list[Path], out: Path) -> None:
    """Assert what must hold, and print what was measured."""
    kept = np.load(got, allow_pickle=True)
    decoded = [(at, sent_markers(messages)) for at, messages in sent_frames(kept)]
    poses = [(at, *actual) for at, actual in decoded if actual is not None]
    received = np.array([at for at, *_ in poses])
    stamps, sent_points = (
        np.array([t for _, t, _ in poses]),
        np.array([points for *_, points in poses]),
    )
    rows = [line.split() for log in logs for line in log.read_text().splitlines()]
    sent = np.array([[float(cell) for cell in row] for row in rows if len(row) == 10])
    print(f"latency: {figures['latency_ms']}; dropped: {figures['dropped']}")
    print(f"packets: {figures['packets']}, ignored: {figures['ignored']}")
    times, figures_of_poses = check_order_and_content(received, stamps, sent_points, sent)
    share = check_delivery(times, sent[:, 0], 3.0, SECONDS - 1)
    shares = check_recovery(received, sent[:, 0])
    print(f"delivered {100 * share:.2f} %; a second after each fault:")
    for fault, value in shares.items():
        print(f"    {fault}: {100 * value:.0f} %")
    print(figures_of_poses)
    check_messages(figures["warnings"])
    assert len(received) >= figures["outputs"] * 0.999
    again = Recording.load(out / "recording.toml")
    frames = len(open_video(again.videos[0]))
    print(f"recorded: {len(again.times)} samples, {frames} frames; load {os.getloadavg()}")
    assert frames > 0.9 * FPS * (SECONDS - 6)
    assert share >= 0.99, f"{100 * share:.2f} % delivered, expected 99"
    assert min(shares.values()) >= 0.9, f"slow to recover: {shares}"
    print("passed")


def free_ports(count: int) -> list[int]:
    sockets = [socket.socket() for _ in range(count)]
    for each in sockets:
        each.bind(("127.0.0.1", 0))
    ports = [each.getsockname()[1] for each in sockets]
    for each in sockets:
        each.close()
    return ports


def lengths() -> tuple[float, float]:
    """Of head and hand of a person 1.75 m tall, metres."""
    from jaxmocap import Skeleton

    skeleton = Skeleton.human(1.75)
    head, hand = (skeleton.tree.bone(name) for name in ("head", "hand_l"))
    return float(skeleton.lengths[head]), float(skeleton.lengths[hand])


if __name__ == "__main__":
    roles = {
        "play": (play, (Path, int, float, Path)),
        "film": (film, (Path, int, float)),
        "receive": (receive, (int, Path)),
    }
    if len(sys.argv) > 1 and (role := sys.argv[1]) in roles:
        act, kinds = roles[role]
        act(*(kind(text) for kind, text in zip(kinds, sys.argv[2:], strict=True)))
        sys.exit()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording", nargs="?", type=Path, help="default: one is made")
    parser.add_argument("--smooth", action="store_true")
    options = parser.parse_args()
    LENGTHS = lengths()
    path = options.recording or write_table_tennis(tempfile.mkdtemp(prefix="rehearsal-"))
    rehearse(path, options.smooth)
