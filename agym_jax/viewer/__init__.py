"""Viewer for the browser: watch, pause and control an episode, or save it as a web page.

``agym-jax view ScratchItchJaco-v0`` serves it (``command``). A ``Stage`` holds the environments and their drivers, a
``Picture`` draws them with viser, a ``Page`` has the controls, and ``replay`` writes an episode to a file.
mjviser is not used: it draws many instances of one model, whereas here every person is different.
"""
