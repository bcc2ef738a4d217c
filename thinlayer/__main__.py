"""python3 -m thinlayer"""

from thinlayer.startup import end_on_interrupt

end_on_interrupt()

from thinlayer.cli import main  # noqa: E402

raise SystemExit(main())
