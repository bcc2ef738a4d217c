"""Entry point of the command `thinlayer` and of `python3 -m thinlayer`."""

# PYTHON_ARGCOMPLETE_OK
from thinlayer.running.process import end_on_interrupt


def main() -> int:
    """Run the command that the user gave on the command line, and return the exit status, 0 for success."""
    end_on_interrupt()
    from thinlayer.running.cli import start

    return start()


if __name__ == "__main__":
    raise SystemExit(main())
