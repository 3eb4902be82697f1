"""The raw tier: recordings as arms give them, by a generator of its own.

Motions, friction, sensors, effects, controller and arms are written apart from those of the other tiers, so that what
these have in common with the product is no help here.
"""
