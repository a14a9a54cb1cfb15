"""Core: whether and how robot, frame and arm move."""
