"""Commands of trainings: Lightning runs them."""
