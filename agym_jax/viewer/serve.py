"""viser's server, dressed for an environment."""

from __future__ import annotations

import contextlib
import io

import viser

BRAND = (28, 126, 214)


def open_server(name: str, host: str, port: int) -> viser.ViserServer:
    """A server, without controls.

    Args:
        name: of the environment, for the title.
        host: address.
        port: 0 for any that is free.
    """
    with contextlib.redirect_stdout(io.StringIO()):  # it says so in a frame of its own
        server = viser.ViserServer(host=host, port=port, label=name, verbose=False)
    server.gui.configure_theme(
        control_width="medium", show_logo=False, show_share_button=False, brand_color=BRAND
    )
    server.gui.set_panel_label(name)
    return server


def close_server(server: viser.ViserServer) -> None:
    """Stop it."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()
