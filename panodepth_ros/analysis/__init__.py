"""Core: what a rig can measure and how long it takes; what a scan was worth."""
