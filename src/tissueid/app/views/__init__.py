"""The pages of the window beside the guided test, a folder each; ``view`` says what each must be able to do."""
