"""``python -m equimesh``: the command line."""

from equimesh.cli import main

if __name__ == "__main__":
    main()
