# ruff: noqa: D103
"""What a command line makes of errors."""

from __future__ import annotations

import pytest

from train.errors import ConfigError, reports_errors


@pytest.mark.parametrize(("error", "status"), [(ConfigError, 2), (KeyboardInterrupt, 130)])
def test_known_errors_become_a_line_and_a_status(error, status: int, capsys):
    @reports_errors
    def main(arguments: list[str]) -> int:
        """What it does."""
        raise error(" ".join(arguments))

    assert main.__doc__ == "What it does."
    assert main(["no", "such", "flag"]) == status
    said = capsys.readouterr().err
    assert said == ("ConfigError: no such flag\n" if status == 2 else "")


def test_other_errors_and_results_pass_through():
    @reports_errors
    def main(share: float) -> int:
        return int(1 / share)

    assert main(0.5) == 2
    with pytest.raises(ZeroDivisionError):
        main(0.0)
