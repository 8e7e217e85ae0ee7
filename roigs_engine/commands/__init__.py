"""The command line: turns words into requests, and prints the text of results."""
