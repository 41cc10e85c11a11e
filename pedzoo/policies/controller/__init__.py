"""The controller, which is called step by step: people in another simulator."""
