"""What each command does from end to end, from files or devices to files or messages.

Begin with ``tracking.track``, the offline pipeline with markers, and ``writing``, which writes its
outputs; ``silhouettes``, ``live``, ``batch``, ``scaling`` and ``planning`` are rooms of their own.
``check``, ``demo``, ``retarget``, ``view`` and ``warmup`` are one command each. ``summary``,
``progress``, ``signals`` and ``kept_programs`` serve them all.
"""
