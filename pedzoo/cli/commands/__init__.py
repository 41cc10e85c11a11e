"""One file per command: literals ``HELP`` and ``EXAMPLE``, and ``run``, whose arguments are the options."""
