"""The first paper's system: markers and one camera."""
