"""The application: each piece of work as a function of a request and a context.

`train(Train(scene=..., roi=["auto"], run_dir=...))` does all that the command of that name does: it
holds the lock, writes manifest, provenance and log, resumes, and returns where everything is.
Without a context, nothing is shown; events go to `Context.emit`.
"""
