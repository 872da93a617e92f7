"""Video files that appear complete or not at all.

INPUTS: a path; encoded packets. OUTPUTS: the file, gone through once more before it is moved into
place: what encodes may keep to itself that the disk is full.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import av
from av.container import OutputContainer
from av.error import FFmpegError
from av.packet import Packet

from jaxmocap.formats.files.errors import OutputError
from jaxmocap.formats.files.writing import replacing


class VideoFile:
    """A file of one video stream that is being written.

    Attributes:
        container: to add the stream to.
        packets: that were written.
    """

    def __init__(self, container: OutputContainer):
        self.container, self.packets = container, 0

    def write(self, packets: list[Packet]) -> None:
        """Write what an encoder gave out."""
        self.packets += sum(packet.size > 0 for packet in packets)
        self.container.mux(packets)

    def is_complete(self, path: Path) -> bool:
        """Whether every packet is found again in the file."""
        try:
            with av.open(str(path)) as container:
                packets = sum(packet.size > 0 for packet in container.demux(video=0))
        except (FFmpegError, IndexError):
            return False
        return packets == self.packets


@contextmanager
def replacing_video(path: str | Path, **options: Any) -> Iterator[VideoFile]:
    """Write a video beside ``path``, with ``av.open``'s options; see ``replacing``."""
    files: list[VideoFile] = []
    with replacing(path, lambda part: files[0].is_complete(part)) as temporary:
        try:
            with av.open(str(temporary), "w", **options) as container:
                files.append(VideoFile(container))
                yield files[0]
        except FFmpegError as error:
            if isinstance(error, OSError):
                raise
            raise OutputError(path, f"cannot be written ({error.strerror})") from error
