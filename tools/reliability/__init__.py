"""What pedzoo does when all goes wrong: hostile files, kills, full disks, long runs. See `command`."""
