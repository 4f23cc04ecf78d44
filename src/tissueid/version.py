"""Version of the program, and the name that it writes into its files."""

__version__ = "0.1.0"
SOFTWARE = f"tissueid {__version__}"
