"""The commands: functions with `@command`, whose arguments are the options; see `pedzoo.cli.parsing`."""
