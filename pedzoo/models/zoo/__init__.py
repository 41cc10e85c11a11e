"""Names, cards and files of weights: everything from a name to a model."""
