"""Everything that turns a scene into velocities."""
