"""Many recordings, tracked side by side by processes here or on a cluster.

Begin with ``batch``; ``corpus`` finds recordings and writes the tables, ``cluster`` runs the jobs.
"""
