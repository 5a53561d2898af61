"""``python -m terraphi.cli``: the command line without an installed script."""

from terraphi.cli.main import main

main()
