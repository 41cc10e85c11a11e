"""Tables and pictures of models on data."""
