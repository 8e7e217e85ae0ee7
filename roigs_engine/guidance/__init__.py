"""What photos tell of a box, and which photo would tell most (docs/method.md, "Guidance")."""
