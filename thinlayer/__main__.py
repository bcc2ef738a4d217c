"""python3 -m thinlayer"""

from thinlayer.startup import end_on_interrupt

end_on_interrupt()

from thinlayer.cli import start  # noqa: E402

raise SystemExit(start())
