"""python3 -m thinlayer, and the command thinlayer"""

# PYTHON_ARGCOMPLETE_OK
from thinlayer.running.process import end_on_interrupt


def main() -> int:
    """Run the command line; returns the exit status."""
    end_on_interrupt()
    from thinlayer.running.cli import start

    return start()


if __name__ == "__main__":
    raise SystemExit(main())
