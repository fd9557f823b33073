"""`python -m valvesim`: the command line."""

from valvesim.cli.main import main

if __name__ == "__main__":
    main()
