"""Core: from distances to beams, their uncertainty, and what a consumer makes of them."""
