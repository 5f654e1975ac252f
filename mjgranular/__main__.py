"""`python -m mjgranular` is the command `mjgranular`."""

from mjgranular.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
