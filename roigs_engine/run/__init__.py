"""A whole run: settings, plan, folder, execution, results."""
