"""One file per command: literals ``HELP`` and ``EXAMPLE``, read without importing, and ``run(argv)``."""
