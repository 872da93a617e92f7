"""Before tracking: cameras, clocks, devices and bodies.

Begin with ``calibrate`` (intrinsics) and ``place_camera`` (extrinsics).
"""
