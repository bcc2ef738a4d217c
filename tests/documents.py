"""The README and the pages of its guide, in the order in which they are read."""

from __future__ import annotations

import re
from pathlib import Path

CLONE = Path(__file__).parent.parent
GUIDE = ("time", "contact", "yield", "snaps", "loads", "joints", "results", "estimate", "scripts", "environments")
PAGES = {name: (CLONE / name).read_text() for name in ("README.md", *(f"thinlayer/guide/{page}.md" for page in GUIDE))}
DOCUMENT = "\n".join(PAGES.values())
OWN = "# In your own script"  # a page with scripts of its own, see test_own_scripts


def anchors(text: str) -> set[str]:
    """Names by which links refer to the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", re.sub(r"```.*?```", "", text, flags=re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}
