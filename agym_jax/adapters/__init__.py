"""Bridges to other libraries' interfaces; nothing in the package depends on them."""
