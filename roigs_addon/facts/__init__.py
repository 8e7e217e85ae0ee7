"""What panels and buttons need to know, cached: a sidebar is drawn many times a second."""
