"""The host loops."""
