"""Parts that architectures are composed of."""
