"""One file per command: ``HELP`` and ``EXAMPLE`` are literals, read without importing; ``run(argv)`` does it."""
