"""Per-image and per-pair work on other processes and machines, by Dask.distributed."""
