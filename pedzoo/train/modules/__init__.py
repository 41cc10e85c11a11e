"""Lightning modules of forecasters."""
