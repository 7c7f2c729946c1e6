"""`python -m tvsysid.cli`."""

from tvsysid.cli.start import main

if __name__ == "__main__":
    main()
