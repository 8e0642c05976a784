"""Hide what Windows has not in each Python that a test starts."""

import hidden_posix  # noqa: F401
