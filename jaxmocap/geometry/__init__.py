"""Mathematics of rotations, cameras and outlines; knows no body and no image."""
