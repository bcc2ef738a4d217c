"""python3 -m thinlayer"""

from thinlayer.running.process import end_on_interrupt

end_on_interrupt()

from thinlayer.running.cli import start  # noqa: E402

raise SystemExit(start())
