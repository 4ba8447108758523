"""Pictures and films of a scene, with OpenGL or without."""
