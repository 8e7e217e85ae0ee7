"""A boxed object as a mesh with the photos' texture."""
