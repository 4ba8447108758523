"""Hooks of MkDocs, named in ``mkdocs.yml``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

from agym_jax.viewer import command
from benchmarks.site.environments import REPLAYS, replayed
from benchmarks.site.pages import DOCS, generated, navigation, relink


def on_config(config: Any) -> Any:
    """The navigation."""
    config.nav = navigation()
    return config


def on_files(files: Files, config: Any) -> Files:
    """The generated pages."""
    for path, content in generated().items():
        files.append(File.generated(config, path, content=content))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Links out of ``docs`` are links of the site, or text."""
    if page.file.generated_by:
        return markdown
    return relink(markdown, (DOCS / page.file.src_uri).parent)


def on_post_build(config: Any) -> None:
    """Replays of episodes, where they are asked for.

    Raises:
        PluginError: one was not written; why is on standard error.
    """
    for name in replayed():
        file = Path(config.site_dir) / REPLAYS / f"{name}.html"
        if command.main([name, "--export", str(file)]):
            raise PluginError(f"No replay of {name}.")
