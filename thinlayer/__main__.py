"""python3 -m thinlayer"""

from thinlayer.cli import main

raise SystemExit(main())
