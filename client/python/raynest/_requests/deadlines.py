"""The deadline of a request that is made in items, whose options, or words of a command, say it."""
from __future__ import annotations

from typing import Any, Mapping

from .arguments import milliseconds

SHARE_SECONDS = 0.2         # that an item has at least: less is lost in what it costs to deal it out
SHARE_SECONDS_MIN = 0.01    # where there are more items than that allows, or it is late


def deadline_of(options: Mapping[str, Any]) -> float:
    """Seconds that the user has set; 0: none."""
    words = [str(word) for word in options.get("words", ())]
    for word, following in zip(words, [*words[1:], "0"]):
        if word.startswith("--deadline") and "deadline" not in options:
            return float(word.partition("=")[2] or following)
    return milliseconds(options.get("deadline")) / 1000


def share_of(seconds: float, threads: int, items: int) -> float:
    """The time that each of so many items may take if all of them may take so long: they are made by turns where there are
    fewer threads."""
    return max(SHARE_SECONDS_MIN, seconds * min(1.0, max(1, threads) / items))


def items_within(seconds: float, threads: int, least: float = SHARE_SECONDS) -> int:
    """As how many items a request is dealt out, so that the share of each is not less."""
    return max(1, int(seconds * max(1, threads) / least))
