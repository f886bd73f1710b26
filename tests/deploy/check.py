"""What is in deploy/, as the programs see it that read it; see `run` beside this file."""

import sys

import chart
import compose
import running
import units

CHECKS = {"chart": chart.check, "compose": compose.check, "units": units.check, "running": running.check}


def main() -> None:
    names = sys.argv[1:] or list(CHECKS)
    for name in names:
        if name not in CHECKS:
            sys.exit(f"found {name!r}, expected some of {', '.join(CHECKS)}")
    for name in names:
        print(f"{name}: {CHECKS[name]()}", flush=True)


if __name__ == "__main__":
    main()
