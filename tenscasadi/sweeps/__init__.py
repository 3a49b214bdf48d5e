"""Independent cases, on the cores of this machine or on a cluster; each result on disk at once."""
