"""Floor plans that are drawn from a seed: rooms, corridors, doors and furniture."""
