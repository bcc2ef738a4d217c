"""python3 -m thinlayer"""

from thinlayer.cli import start

raise SystemExit(start())
