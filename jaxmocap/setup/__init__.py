"""Before tracking: what must be known of cameras, clocks and people."""
