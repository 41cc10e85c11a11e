"""The stepping controller: people in another simulator."""
