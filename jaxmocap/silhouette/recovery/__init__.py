"""Finding a lost limb again: which limbs the images deny, and where they may be instead.

Begin with ``lost_limbs``.
"""
