"""``python -m terraphi.cli``, and what the script ``terraphi`` calls."""

from terraphi.experiment.interrupts import interrupts_heard


def main() -> None:
    """Import the command line and run it; Ctrl-C is not lost meanwhile."""
    with interrupts_heard():
        from terraphi.cli.main import main as run

        run()


if __name__ == "__main__":
    main()
