"""The second paper's system: silhouettes from one to four cameras, no markers."""
