"""`python -m interloc`: the command line."""

from interloc.cli.main import main

if __name__ == "__main__":
    main()
