"""`python -m tvsysid.cli`."""

from tvsysid.cli.app import main

if __name__ == "__main__":
    main()
