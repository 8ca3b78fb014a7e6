"""stub"""

from collections.abc import Iterator


def messages() -> Iterator[str]:
    """x"""
    return iter(())
