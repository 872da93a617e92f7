"""Where devices sit on the body and how they are held.

Begin with ``standing``, which measures it in two seconds of standing still; ``offsets`` does it by
turning devices about joints, more precisely.
"""
