"""Parts of the page Measure for clinicians: body map, contact light, repeats, comparison."""
