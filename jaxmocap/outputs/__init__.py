"""What people look at: viewer, overlay, report."""
