"""Ways in which hardware differs from the ideal, each a frozen value.

See `saltus.effects.effect`.
"""
