"""``python -m agym_jax.observe ID``; apart, because importing agym_jax imports ``agym_jax.observe``."""

from __future__ import annotations

import sys

from agym_jax.observe import main

if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
