"""Everything that turns a scene into velocities: forecasters that walk, ORCA, social force, mixed crowds."""
