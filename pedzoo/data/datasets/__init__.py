"""One file per dataset: a subclass of `pedzoo.data.recordings.Dataset`, found by its file name."""
