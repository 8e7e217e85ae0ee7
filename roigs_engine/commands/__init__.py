"""The command line: requests from command lines, and text from results."""
