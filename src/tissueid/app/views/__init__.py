"""The pages of the window, a folder each; ``view`` defines their interface."""
