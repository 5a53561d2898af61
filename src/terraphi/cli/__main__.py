"""``python -m terraphi.cli``, as ``python -m terraphi``."""

from terraphi.cli.main import main

if __name__ == "__main__":
    main()
