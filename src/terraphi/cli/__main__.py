"""``python -m terraphi.cli``, and what the script ``terraphi`` calls."""


def main() -> None:
    """Import the command line and run it."""
    from terraphi.cli.main import main as run

    run()


if __name__ == "__main__":
    main()
