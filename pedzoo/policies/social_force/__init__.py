"""The social force model, batched."""
