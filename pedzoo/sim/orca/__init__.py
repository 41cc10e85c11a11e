"""ORCA: velocities that keep people apart from each other and from walls, for whole batches of scenes."""
