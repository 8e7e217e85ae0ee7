"""The user's actions; one file for each step of the panel."""
