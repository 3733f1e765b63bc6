"""``python -m semloc_core`` is the command ``semloc``."""

from semloc_core.cli.shared import ending


def command() -> None:
    """The command, as a process of its own: it can be stopped from here to the process' end."""
    ending.install()
    from semloc_core.cli import main

    main()


if __name__ == "__main__":
    command()
