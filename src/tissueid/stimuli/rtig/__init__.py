"""Real-time input generation: force that follows the distribution of depths measured so far (Chen 2010, 6.3)."""
