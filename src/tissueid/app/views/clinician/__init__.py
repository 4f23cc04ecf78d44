"""What a clinician has on the page of the guided test: body map, contact light, repeats, comparison."""
