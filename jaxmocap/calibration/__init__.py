"""Before tracking: cameras, clocks, devices and bodies.

Begin with ``estimate_intrinsics`` (intrinsics) and ``place_camera`` (extrinsics).
"""
