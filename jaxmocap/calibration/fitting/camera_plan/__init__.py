"""Where cameras should stand: how sure a recording will be that has not been made.

Begin with ``expected``; ``placement`` moves a camera to where that is best. INPUTS: a Model, a
movement, a lens, walls. OUTPUTS: expected deviations, places.
"""
