"""What a run shows and sends: overlay videos, the rerun viewer, reports, poses over the network.

Begin with ``scene``, the body as all pictures draw it; ``viewer`` and ``overlay`` write files,
``live_view`` shows a live run, and ``vmc`` and ``vrchat`` make datagrams that ``osc`` sends.
"""
