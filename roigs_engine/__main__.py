"""`python -m roigs_engine COMMAND`: the engine's command line."""

from .cli import entry

if __name__ == "__main__":
    entry()
