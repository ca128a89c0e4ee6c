"""Ways in which hardware differs from the ideal, each a frozen value; see `saltus.effects.effect`."""
