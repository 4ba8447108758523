"""An episode in the browser: watched, paused, driven by hand, and kept as a page.

``agym-jax view ScratchItchJaco-v0`` serves it (``command``). A ``Stage`` has the environments and who drives them, a
``Picture`` draws them with viser, a ``Page`` has the controls, and ``replay`` writes an episode into a file.
mjviser is not used: it draws many instances of one model, whereas here every person is another.
"""
