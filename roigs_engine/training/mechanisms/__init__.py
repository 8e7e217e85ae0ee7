"""The mechanisms of training, one per file; a stage lists its own (`training.config`)."""
