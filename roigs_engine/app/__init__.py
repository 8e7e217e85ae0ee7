"""The application: each piece of work as a function of a request and a context.

`train(Train(scene=..., roi=["auto"], run_dir=...))` does the same as the command `train`: it holds
the lock, writes manifest, provenance and log, resumes, and returns the paths of the results.
Events go to `Context.emit`. Without a context, nothing is shown.
"""
