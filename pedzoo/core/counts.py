"""Numbers of which there is at least one."""

from pedzoo.core.errors import UserError


def at_least_one(what: str, number: int) -> None:
    """Refuse a number below 1.

    Raises:
        UserError: It is; the message begins with ``what``.
    """
    if number < 1:
        raise UserError(f"{what} {number}: expected at least 1")
