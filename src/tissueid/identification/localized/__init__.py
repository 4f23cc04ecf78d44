"""Linear tests about one level after another."""
