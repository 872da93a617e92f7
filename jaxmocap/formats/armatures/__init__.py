"""The body as animation programs have it: joints with a rest pose, names, and a skin.

Begin with ``armature``; ``body_armature`` makes one from a skeleton, and a motion from one.
"""
