"""Poses over the network: what VMC, VRChat and Unity understand.

Begin with ``vmc``: a pose's datagram. ``osc`` packs and sends it; ``unity`` has its axes and bones.
"""
