"""Numbers on model cards: measured, and measured again on request."""
