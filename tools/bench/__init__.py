"""Speed: pedzoo, a commit before it and other programs, timed in turns in one run."""
