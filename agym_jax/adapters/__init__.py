"""Adapters to the interfaces of other libraries; nothing else in the package depends on them."""
