"""`python -m tsa_ctrl` is `tsa`."""

from tsa_ctrl.cli import main
from tsa_ctrl.system.parent import follow

if __name__ == "__main__":
    follow()
    main()
