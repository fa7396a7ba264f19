"""The figure of the README, as the demonstration drew it: ``navfilter demo && python docs/figures.py``."""

import re
from pathlib import Path
from urllib.parse import unquote

PAGE = Path("navfilter-demo/comparison/report.html")
FIGURE = Path(__file__).with_name("demo.svg")

if __name__ == "__main__":
    section = PAGE.read_text(encoding="utf-8").split("<h2>Error against 1 sigma</h2>")[1]
    drawn = re.search(r"data:image/svg\+xml,([^\"]+)", section).group(1)
    FIGURE.write_text(unquote(drawn.replace("&amp;", "&")), encoding="utf-8")
    print(f"{FIGURE}: {FIGURE.stat().st_size} bytes")
