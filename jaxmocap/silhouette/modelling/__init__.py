"""Four photographs to a person's own body: bones, surface, texture (second paper, section 2).

Silhouettes are cut from the photographs (``pictures/``), separated into trunk and limbs and laid
around bones; what was measured moves a generic surface, and the photographs' colours are fused on
it (``texture/``). Begin with ``person.person_model``, then ``personal.personal_model``, which makes
of it what the trackers want.
"""
