"""The sidebar tab and the preferences page. Layout only."""
