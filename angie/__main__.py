"""`python -m angie` is the `angie` command."""

from angie.cli import main

if __name__ == "__main__":
    main()
