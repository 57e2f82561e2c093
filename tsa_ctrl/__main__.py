"""`python -m tsa_ctrl` is `tsa`."""

import sys


def entry() -> None:
    """Run `tsa`; Ctrl-C while it is still being loaded is one line, as it is later."""
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
