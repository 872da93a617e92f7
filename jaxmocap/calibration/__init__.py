"""What tracking rests on: cameras, clocks, devices and bodies, before it or by the recording.

Intrinsics from views of a board (``board``), a camera's place in the world, a video's offset from
the motion itself, where devices sit on bones, and bodies from static trials. Begin with
``calibrate`` (intrinsics), ``place_camera`` (extrinsics) and ``sync`` (clocks); ``fitting`` follows
from a smoothed recording.
"""
