"""2-D key points of a recording's videos, by detectors of others. Begin with ``detect``."""
