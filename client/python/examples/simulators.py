"""Gleans failed demonstrations of a simulator's task, from the first recording to closed-loop success rates.

With a server that runs (gleaner-server serve), or one of its own (--server-bin). Every stage can be stopped and
started again: what is done is not done again. Everything is in OUT/TASK, the report in OUT/TASK/report.md.
"""

from simulator_example.run import main

if __name__ == "__main__":
    main(__doc__ or "")
