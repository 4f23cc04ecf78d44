"""The gap between simulated and recorded: where it lies, which effect causes it, how far it shrinks."""
