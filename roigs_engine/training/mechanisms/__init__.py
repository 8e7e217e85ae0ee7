"""The mechanisms of training, one a file; a stage lists those that it uses (`training.config`)."""
