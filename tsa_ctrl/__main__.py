"""Run `tsa` by `python -m tsa_ctrl`."""

import sys


def entry() -> None:
    """Run `tsa`. Print one line on Ctrl-C while `tsa` is still being loaded, as it does later."""
    try:
        from tsa_ctrl.cli import main

        main()
    except KeyboardInterrupt:
        print("tsa: interrupted", file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    from tsa_ctrl.system.process_supervisor import follow

    follow()
    entry()
