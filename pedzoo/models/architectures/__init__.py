"""Drop-in folder: one file is one model."""
