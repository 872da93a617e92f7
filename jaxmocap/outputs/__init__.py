"""What a person looks at: the overlay video, the viewer's recording, the report."""
