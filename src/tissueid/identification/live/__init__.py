"""What is shown of an identification while a test runs, its precision, and the rule that stops the test."""
