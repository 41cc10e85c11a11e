"""What a prediction or a walk is worth: pure functions and their torchmetrics classes."""
