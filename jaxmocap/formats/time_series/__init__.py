"""Tables over time: markers (TRC, C3D, CSV) and joint angles (MOT).

Begin with ``markers``: it chooses the reader by the file's name.
"""
