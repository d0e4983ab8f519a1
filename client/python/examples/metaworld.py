"""Gleans failed demonstrations of a Meta-World task, from the first recording to closed-loop success rates.

With a server that runs (gleaner-server serve), or one of its own (--server-bin). Every stage can be stopped and
started again: what is done is not done again. Everything is in OUT/TASK, the report in OUT/TASK/report.md.
"""

import sys

# A script's folder comes first where Python looks for packages, and this file has the simulator's name.
sys.path.append(sys.path.pop(0))

from metaworld_example.run import main

if __name__ == "__main__":
    main(__doc__ or "")
