"""What pedzoo does when all goes wrong, see `tools.reliability.__main__`."""
