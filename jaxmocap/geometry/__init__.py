"""Mathematics of rotations, twists, cameras, lines and outlines, without body or image.

Begin with ``rotations`` (matrices, quaternions, hinges) and ``cameras``: all that depends on
intrinsics is asked of a ``Camera``, whose lens is a class of ``lenses``. ``outlines`` projects
limbs as sphere-swept cones; ``solids`` makes meshes of them; ``lines`` are pixels' rays; ``twists``
move rigid objects; ``euler`` and ``fourier`` serve files, curves and surfaces.
"""
