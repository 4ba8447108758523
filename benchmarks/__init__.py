"""Measurements: every number in the README comes from a line in ``benchmarks/results``.

``benchmarks.throughput``, ``benchmarks.nan`` and ``benchmarks.cpu`` measure and write JSON lines;
``benchmarks.tables`` makes the README's tables from them and ``benchmarks.deviations`` makes
``docs/deviations.md`` from the notes in the code. They run from a checkout.
"""
