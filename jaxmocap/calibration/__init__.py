"""What is measured before tracking: cameras, clocks, devices and bodies.

Intrinsics from views of a board (``board``), a camera's place in the world, a video's offset from
the motion itself, where devices sit on bones, and bodies from static trials. Begin with
``calibrate`` (intrinsics), ``place_camera`` (extrinsics) and ``sync`` (clocks).
"""
