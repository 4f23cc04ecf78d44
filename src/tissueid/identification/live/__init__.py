"""Live view of an identification during a test, precision of its parameters, and the rule that stops the test."""
