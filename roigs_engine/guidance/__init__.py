"""How well photos cover a box, and which photo to take next (docs/method.md, "Guidance")."""
