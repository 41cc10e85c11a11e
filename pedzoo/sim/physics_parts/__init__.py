"""Parts of physics backends."""
