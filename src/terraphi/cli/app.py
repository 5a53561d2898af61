"""``terraphi app``: the report's pages, served on this machine."""

from __future__ import annotations

import click

from terraphi.cli.options import IntRange


@click.command()
@click.option(
    "--port",
    type=IntRange(min=1, max=65535),
    default=8321,
    show_default=True,
    help="Port on 127.0.0.1.",
)
def app(port: int) -> None:
    """Serve a page on this machine to drop a CSV of forces or a robot's log on.

    It answers with the report of the inversion or of the log. Ctrl-C ends it.

    Example: terraphi app
    """
    from terraphi.view.app.server import serve

    serve(port, ready=lambda at: click.echo(f"Open {at} in a browser; Ctrl-C ends it."))
