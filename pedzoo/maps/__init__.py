"""Floor plans: occupancy grids, distance fields and the bank that models and worlds share."""
