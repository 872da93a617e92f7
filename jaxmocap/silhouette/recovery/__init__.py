"""Finding a lost limb again.

Where no limb explains a visible person, or a limb explains nothing, a particle filter searches for
it; parts in front of which something else stands are hidden, and count for nothing. Begin with
``relocation``, which a frame goes through: ``lost_limbs`` decides, ``limb_particle_filter``
searches by ``limb_likelihood``.
"""
