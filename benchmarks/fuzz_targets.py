"""All parsers of outside bytes that are fuzzed."""

from __future__ import annotations

from collections.abc import Sequence

import fuzz_options
import fuzz_pictures
import fuzz_records
from fuzz_mutations import Target

TARGETS: Sequence[Target] = (*fuzz_options.TARGETS, *fuzz_records.TARGETS, *fuzz_pictures.TARGETS)
