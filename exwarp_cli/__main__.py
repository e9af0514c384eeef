"""``python -m exwarp_cli`` is the command ``exwarp``."""

from exwarp_cli.cli import main

if __name__ == "__main__":
    main()
