"""What FFmpeg may open and decode; as a script the process that decodes a network stream.

A stranger's bytes may hang FFmpeg, take all memory, or worse. As a script it imports nothing of
this package.

INPUTS: an address, "grey" or "colour", the most pixels an image may have. OUTPUTS: on standard
output for each frame three little-endian 32-bit numbers (height, width, layout) and its pixels, as
grey, BGR, or Y, U and V in planes; at the end zeros, and a sentence if something went wrong.
"""

import faulthandler
import struct
import sys
from collections.abc import Iterator

import av
import numpy as np
from av.codec.context import Flags
from av.error import FFmpegError
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

# Files that hold their video themselves. Playlists and scripts, which FFmpeg reads as well, lead to
# other files, pipes and hosts.
FORMATS = (
    "mov,mp4,matroska,webm,avi,mpegts,mpeg,mpegvideo,flv,asf,ogg,mxf,nut,dv,ivf,gif,wav,"
    "h264,hevc,vvc,m4v,mjpeg,obu,av1,cine,ser,gxf,wtv,dhav,yuv4mpegpipe"
)
STREAM_FORMATS = f"{FORMATS},rtsp,rtp,sdp,mpjpeg,live_flv"
STREAM_PROTOCOLS = "rtsp,rtsps,rtp,srtp,udp,tcp,tls,http,https,httpproxy,rtmp,rtmps,srt"
# Decoders of what cameras and laboratories write; FFmpeg has hundreds.
CODECS = (
    "h264,hevc,vvc,av1,libdav1d,vp8,vp9,libvpx,libvpx-vp9,mpeg1video,mpeg2video,mpeg4,msmpeg4v2,"
    "msmpeg4,h263,flv,mjpeg,prores,dnxhd,cfhd,dvvideo,ffv1,huffyuv,ffvhuff,utvideo,rawvideo,png,"
    "qtrle,gif,theora,wmv1,wmv2,wmv3,vc1"
)
# What keeps FFmpeg from gathering frames before it gives the first.
LOW_LATENCY_OPTIONS = {
    "fflags": "nobuffer",
    "flags": "low_delay",
    "probesize": "32768",
    "analyzeduration": "0",
}
# A stream that says nothing for so many seconds is gone.
TIMEOUT_S = 2.0
# The process ends where a frame takes longer, seconds,
FRAME_LIMIT_S = 3 * TIMEOUT_S
# or more addresses, some 300 MB of them for Python itself.
MAX_MEMORY_BYTES = 2**31
# Each thread takes addresses.
THREADS = 2
HEADER = struct.Struct("<III")
# Layouts of an image, and rows of bytes for each of its rows, times channels. Planes are half of
# BGR: U and V have half the width and half the height, all full rows below Y's (I420).
GREY, PLANES, BGR = 1, 2, 3
SHAPES = {GREY: (1.0, ()), PLANES: (1.5, ()), BGR: (1.0, (3,))}
# What OpenCV takes planes for: ITU-R BT.601 of limited range, or not stated.
PLANE_COLOURS, PLANE_RANGES = (2, 5, 6), (0, 1)


def decoder_options(max_pixels: int) -> dict[str, str]:
    """Of a decoder, and of a container, which opens decoders too."""
    return {"codec_whitelist": CODECS, "max_pixels": str(max_pixels)}


def refused_codec(stream: VideoStream) -> str | None:
    """A sentence where nothing may decode a stream, else None."""
    if (context := stream.codec_context) is None:
        return "nothing decodes its video stream"
    if (name := context.codec.name) not in CODECS.split(","):
        return f"found video of the kind {name}, which is not decoded"
    return None


def image_of(frame: VideoFrame, luma: bool) -> np.ndarray:
    """A frame as BGR or grey array of its own, rotated upright as its file states."""
    return np.array(_shared_image(frame, luma), order="C")


def _shared_image(frame: VideoFrame, luma: bool) -> np.ndarray:
    """The same, perhaps in the frame's own memory."""
    if luma and frame.format.name in ("yuv420p", "yuvj420p", "nv12", "gray"):
        plane = frame.planes[0]
        # A plane is a buffer, which its type stubs do not say.
        rows = np.frombuffer(memoryview(plane), np.uint8)  # type: ignore[arg-type]
        image = rows.reshape(-1, plane.line_size)[: frame.height, : frame.width]
    else:
        image = frame.to_ndarray(format="gray" if luma else "bgr24")
    return np.rot90(image, round(frame.rotation / 90))


def piped_image(frame: VideoFrame, luma: bool) -> tuple[int, np.ndarray]:
    """A frame's layout and its array, in planes where it has them and OpenCV can convert them.

    While the frame lives.
    """
    has_planes = frame.format.name == "yuv420p" and frame.width % 2 == frame.height % 2 == 0
    is_plain = frame.colorspace in PLANE_COLOURS and frame.color_range in PLANE_RANGES
    if luma or not has_planes or not is_plain or frame.rotation:
        return (GREY if luma else BGR), np.ascontiguousarray(_shared_image(frame, luma))
    return PLANES, frame.to_ndarray()


def stream_images(url: str, luma: bool, max_pixels: int) -> Iterator[tuple[int, np.ndarray]]:
    """``piped_image`` of a network stream's frames of so many pixels at most, until it ends.

    ValueError where it has no video that is decoded, OSError where it cannot be had.
    """
    options = LOW_LATENCY_OPTIONS | decoder_options(max_pixels)
    options |= {"format_whitelist": STREAM_FORMATS, "protocol_whitelist": STREAM_PROTOCOLS}
    with av.open(url, options=options, timeout=TIMEOUT_S) as container:
        if not container.streams.video:
            raise ValueError("has no video stream")
        stream = container.streams.video[0]
        if problem := refused_codec(stream):
            raise ValueError(problem)
        context = stream.codec_context
        if context.width * context.height > max_pixels:
            problem = f"images of {context.width} × {context.height} pixels"
            raise ValueError(f"{problem}, far more than it was calibrated for")
        context.options = decoder_options(max_pixels)
        context.flags |= Flags.low_delay
        # Threads that share the frames would each hold one back.
        context.thread_type, context.thread_count = "SLICE", THREADS
        for packet in container.demux(stream):
            try:
                decoded = packet.decode()
            except FFmpegError:
                continue
            for frame in decoded:
                if not frame.is_corrupt and frame.width * frame.height <= max_pixels:
                    yield piped_image(frame, luma)


def write_images(images: Iterator[tuple[int, np.ndarray]]) -> None:
    """Hand them on; the process ends where one takes too long."""
    output, reason = sys.stdout.buffer, ""
    try:
        while True:
            faulthandler.dump_traceback_later(FRAME_LIMIT_S, exit=True)
            if (each := next(images, None)) is None:
                break
            faulthandler.cancel_dump_traceback_later()
            layout, image = each
            height = round(len(image) / SHAPES[layout][0])
            output.write(HEADER.pack(height, image.shape[1], layout))
            output.write(image.data)
            output.flush()
    except (FFmpegError, OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
    output.write(HEADER.pack(0, 0, 0) + reason.encode(errors="replace"))


def limit_memory(max_bytes: int) -> None:
    """Let this process have so many bytes, where the system can hold it to that."""
    try:
        import resource
    except ImportError:
        return
    resource.setrlimit(resource.RLIMIT_AS, (max_bytes, max_bytes))


if __name__ == "__main__":
    limit_memory(MAX_MEMORY_BYTES)
    address, kind, most = sys.argv[1:]
    write_images(stream_images(address, kind == "grey", int(most)))
