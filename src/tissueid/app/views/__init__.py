"""The pages of the window, a folder each; ``tissueid.app.context`` defines their interface."""
